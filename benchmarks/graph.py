"""Delaunay graph mapping and its transpose against the copy of memory, location against SciPy's, and the set-up of large meshes.

python benchmarks/graph.py [--large 10000000]
"""

import argparse
import resource

import agard445
import jax
import jax.numpy as jnp
import numpy as np
from _measure import about, cpu_seconds, once, table
from scipy.spatial import Delaunay

import jaxmorph as jm
from jaxmorph._host.package.rounding import morton_order
from jaxmorph._host.surface.graph import graph_of, locate


def within(mesh: jm.Mesh, count: int) -> np.ndarray:
    """`count` points inside of the mesh's tetrahedra, denser where these are smaller, in the order of a space-filling curve."""
    rng = np.random.default_rng(0)
    cells = mesh.cells["tetra"]
    extra = np.zeros((count, 3))
    chosen = cells[rng.integers(0, len(cells), count)]
    weights = rng.dirichlet(np.ones(4), count)
    for k in range(4):
        extra += weights[:, k, None] * mesh.points[chosen[:, k]]
    return extra[morton_order(extra)]


def sections(spanwise: int = 130, around: int = 130) -> np.ndarray:
    """A wing's surface in structured sections, (spanwise * around, 3): full of cospherical nodes."""
    y, t = np.meshgrid(
        np.linspace(0, 0.762, spanwise),
        np.linspace(0, 2 * np.pi, around, endpoint=False),
        indexing="ij",
    )
    chord = 0.558 - 0.19 * y / 0.762
    return np.stack(
        [1.06 * y + chord * (1 + np.cos(t)) / 2, y, 0.02 * chord * np.sin(t)], axis=-1
    ).reshape(-1, 3)


def mapping(mesh: jm.Mesh, count: int) -> list[tuple[str, str, str]]:
    points = np.concatenate([mesh.points, within(mesh, count)])
    plan = jm.prepare(points, mesh.patch("wing"), mesh.patch("farfield"), method=jm.DelaunayGraph())
    rng = np.random.default_rng(0)
    u, cotangent = (
        jnp.asarray(rng.normal(size=(plan.n_moving, 3))),
        jnp.asarray(rng.normal(size=points.shape)),
    )
    words = (
        4 / 2 + 4 + 3 + 3 + 1.5
    )  # read ids, weights, points and own row; write points: doubles a point
    block = jnp.asarray(rng.normal(size=(len(points), round(words / 2))))
    copy = jax.jit(lambda x: -x)
    times = cpu_seconds(
        {
            "map": lambda: jm.deform(plan, u),
            "transpose": lambda: jm.pullback(plan, u, cotangent),
            "copy": lambda: copy(block),
        }
    )
    bandwidth = words / times["map"] / (2 * block.shape[1] / times["copy"])
    each = {
        name: f"{seconds / len(points) * 1e9:.1f} ns a point" for name, seconds in times.items()
    }
    return [
        (
            f"graph mapping of {len(points):,} points, of the copy bandwidth",
            f"{bandwidth:.0%} ({each['map']})",
            "60 %",
        ),
        (
            "its transpose over itself",
            f"{times['transpose'] / times['map']:.1f} ({each['transpose']})",
            "2.6",
        ),
    ]


def location(count: int) -> list[tuple[str, str, str]]:
    wing = sections()
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(923, 3))
    surface = np.concatenate([wing, 8 * sphere / np.linalg.norm(sphere, axis=1)[:, None]])
    height = 10 ** rng.uniform(-5, 0, count)  # above and below the wing, as layers are
    start = wing[rng.integers(0, len(wing), count)]
    points = start + height[:, None] * np.stack(
        [0.2 * rng.normal(size=count), 0.2 * rng.normal(size=count), np.sign(start[:, 2] + 1e-9)],
        axis=1,
    )
    found, ours, _ = once(lambda: locate(graph_of(surface), points, np.arange(count)))
    build, ours_build = once(lambda: Delaunay(surface))[:2]
    few = points[morton_order(points)][:: max(count // 500, 1)]
    _, theirs, _ = once(lambda: build.find_simplex(few))
    corners = surface[found]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
    inner = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    least = np.minimum(inner.min(axis=1), 1 - inner.sum(axis=1)).min()
    per_point = max(ours - ours_build, 1e-9) / count, theirs / len(few)
    return [
        (
            f"location of {count:,} points, {len(surface):,} surface nodes in sections, over `find_simplex` unperturbed",
            f"{per_point[1] / per_point[0]:.0f} times ({per_point[0] * 1e6:.2f} against {per_point[1] * 1e6:.0f} us a point)",
            "100 times",
        ),
        (
            "every point located; smallest weight in the true simplex",
            f"{least:.1e} ({found.repaired} repaired)",
            ">= -1e-6",
        ),
    ]


def set_up(
    mesh: jm.Mesh, count: int, name: str, goals: tuple[str, str]
) -> list[tuple[str, str, str]]:
    points = (
        np.concatenate([mesh.points, within(mesh, count - len(mesh.points))])
        if count > len(mesh.points)
        else mesh.points
    )
    plan, first, _ = once(lambda: jm.prepare(points, mesh.patch("wing"), mesh.patch("farfield")))
    rows = [(f"set-up of {name}, compilation included", f"{first:.1f} s CPU", goals[0])]
    u = jnp.asarray(0.01 * np.random.default_rng(0).normal(size=(plan.n_moving, 3)))
    seconds = cpu_seconds({"deform": lambda: jm.deform(plan, u)}, 3)["deform"]
    sources = len(plan.sources)
    rows.append(
        (f"`deform` of {name}, {sources} sources, default method", f"{seconds:.2f} s CPU", goals[1])
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return [*rows, (f"peak memory of the process after {name}", f"{peak:.1f} GB", "8 GB")]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--large", type=int, default=10_000_000)
    arguments = parser.parse_args()
    wing = agard445.mesh()
    about(points=arguments.points, large=arguments.large, dtype="float64")
    rows = set_up(wing, 0, "the 65 thousand node wing", ("2.5 s CPU", "-"))
    rows += location(100_000)
    rows += mapping(wing, arguments.points)
    if arguments.large:
        rows += set_up(
            wing, arguments.large, f"{arguments.large:,} nodes around it", ("60 s CPU", "10 s CPU")
        )
    table(rows)
