"""CPU seconds of `quality` called directly, the first time and again, and under `jit`; of its gradient, and of `inverted`.

python benchmarks/quality.py [--hexahedra 100000] [--quads 8000]
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np
from _measure import about, cpu_seconds, once

import jaxmorph as jm


def grid(side: int, dimension: int) -> jm.Mesh:
    """Makes a cube or a square of so many cells along each edge."""
    corners = np.arange((side + 1) ** dimension).reshape([side + 1] * dimension)
    low, high = slice(None, -1), slice(1, None)
    square = ((low, low), (high, low), (high, high), (low, high))
    places = square if dimension == 2 else [(*each, end) for end in (low, high) for each in square]
    cells = np.stack([corners[each].ravel() for each in places], axis=1)
    points = np.stack(
        np.meshgrid(*[np.linspace(0, 1, side + 1)] * dimension, indexing="ij"), axis=-1
    )
    return jm.Mesh(
        points.reshape(-1, dimension), {"quad" if dimension == 2 else "hexahedron": cells}
    )


def measure(name: str, mesh: jm.Mesh) -> None:
    points = np.asarray(mesh.points)
    moved = points + 0.1 / len(points) ** (1 / points.shape[1]) * np.sin(7 * points[:, ::-1])

    def direct():
        return jm.quality(mesh, moved)

    traced = jax.jit(lambda points: jm.quality(mesh, points))
    placed = jnp.asarray(moved)
    _, first, _ = once(direct)
    _, compiled, _ = once(lambda: traced(placed))
    gradient = jax.jit(jax.grad(lambda points: jnp.sum(jm.quality(mesh, points).skewness)))
    flags = jax.jit(lambda points: jm.inverted(mesh, points))
    once(lambda: gradient(placed))
    once(lambda: flags(placed))
    calls = {
        "direct": direct,
        "jit": lambda: traced(placed),
        "gradient": lambda: gradient(placed),
        "inverted": lambda: flags(placed),
    }
    again = cpu_seconds(calls, repeats=5)
    row = (first, again["direct"], compiled, again["jit"], again["gradient"], again["inverted"])
    ratio = f"{compiled / first:.1f} | {again['jit'] / again['direct']:.2f}"
    print(
        f"| {next(iter(mesh.cells.values())).shape[0]} {name} | "
        + " | ".join(f"{each:.3f}" for each in row)
        + f" | {ratio} |"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hexahedra", type=int, default=100_000)
    parser.add_argument("--quads", type=int, default=8_000)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about(hexahedra=arguments.hexahedra, quads=arguments.quads)
    print(
        "| cells | direct, first | again | jit, first | again | gradient | inverted | jit over direct, first | again |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    measure("quads", grid(round(arguments.quads ** (1 / 2)), 2))
    measure("hexahedra", grid(round(arguments.hexahedra ** (1 / 3)), 3))
