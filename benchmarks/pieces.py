"""A mesh in pieces that no process holds: each part is generated, attached, moved and dropped. Cells are not judged.

python benchmarks/pieces.py --parts 100 --size 1000000
"""

import argparse
import resource
import time

import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm

FAR = 20.0
"""Radius of the far field; the body is an ellipsoid with half axes of 1, 0.3 and 2."""


def ellipsoid(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Points (n, 3) on the body."""
    return np.stack(
        [np.sin(theta) * np.cos(phi), 0.3 * np.sin(theta) * np.sin(phi), 2 * np.cos(theta)], axis=1
    )


def surface(wall: int, far: int) -> tuple[np.ndarray, int]:
    """Nodes of the wall, then of the far field: about `wall` and `far` of them, on lines of constant angle; the first count."""
    parts = []
    for count in (wall, far):
        rows = int(np.sqrt(count / 2))
        theta = np.repeat((np.arange(rows) + 0.5) / rows * np.pi, 2 * rows)
        parts.append(ellipsoid(theta, np.tile(np.arange(2 * rows) / rows * np.pi, rows)))
    parts[1] *= FAR / np.linalg.norm(parts[1], axis=1, keepdims=True)
    poles = [[0, 0, FAR], [0, 0, -FAR]]
    return np.concatenate([parts[0], parts[1] * 1.02, np.multiply(poles, 1.02)]), len(parts[0])


def part(k: int, parts: int, size: int, layers: int = 200) -> np.ndarray:
    """Points of part `k`: columns over a strip of the body, first cell 1e-4, growing to the far field."""
    columns = size // layers
    rng = np.random.default_rng(k)
    theta = (k + rng.random(columns)) / parts * np.pi
    base = ellipsoid(theta, 2 * np.pi * rng.random(columns))
    share = np.geomspace(1e-4, 1, layers + 1)[:-1] * 0.98
    out = FAR * base / np.linalg.norm(base, axis=1, keepdims=True)
    return (base[:, None] + share[None, :, None] * (out - base)[:, None]).reshape(-1, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", type=int, default=100)
    parser.add_argument(
        "--size", type=int, default=1_000_000, help="nodes of a part (default 1,000,000)"
    )
    parser.add_argument(
        "--wall", type=int, default=100_000, help="nodes of the moving wall (default 100,000)"
    )
    parser.add_argument(
        "--far", type=int, default=10_000, help="nodes of the far field (default 10,000)"
    )
    parser.add_argument("--only", type=int, help="how many of the parts are moved (default all)")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about(parts=arguments.parts, size=arguments.size, wall=arguments.wall, far=arguments.far)
    points, count = surface(arguments.wall, arguments.far)
    began = time.process_time()
    half = jm.prepare_surface(
        jm.Boundary(points, np.arange(count), np.arange(count, len(points))), is_open=False
    )
    preparing = time.process_time() - began
    span = points[:count, 2]
    u = np.stack([0 * span, 0.05 * span**2, 0 * span], axis=1)
    seconds: dict[str, list[float]] = {"generate": [], "attach": [], "deform": []}
    for k in np.linspace(0, arguments.parts - 1, arguments.only or arguments.parts).astype(int):
        times = [time.process_time()]
        made = part(k, arguments.parts, arguments.size)
        times.append(time.process_time())
        plan = half.attach(made, np.full(len(made), -1))
        times.append(time.process_time())
        jax.block_until_ready(jm.deform(plan, u))
        times.append(time.process_time())
        for name, taken in zip(seconds, np.diff(times), strict=True):
            seconds[name].append(float(taken))
        del made, plan
    rows = [["prepare_surface", "", f"{preparing:.1f}"]]
    rows += [
        [name, f"{each[0]:.2f}", f"{np.mean(each[1:] or each):.2f}"]
        for name, each in seconds.items()
    ]
    table(rows, ("CPU seconds", "first part", "each further part"))
    each = sum(
        np.mean(values[1:] or values) for name, values in seconds.items() if name != "generate"
    )
    total = (
        preparing
        + sum(values[0] for name, values in seconds.items() if name != "generate")
        + (arguments.parts - 1) * each
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"\n{arguments.parts} parts of {arguments.size:,} nodes: {total / 60:.1f} CPU minutes, peak memory {peak:.2f} GB"
    )


if __name__ == "__main__":
    main()
