"""What a tree of boxes would save of the kernel sum, by counting: far sources by interpolation, near ones directly.

python benchmarks/tree.py [--n 1000000] [--order 6]

Points lie in layers that grow geometrically from an ellipsoid like a wing to 20 spans, as in a mesh, or evenly in a cube round
a sphere. Boxes are halved until `leaf` points are left. Sources farther than 4 half widths from a box are summed at its order^3
Chebyshev nodes, unless its parent has them already; nodes pass values on to the children's. The rest is summed at the points.
Every pair costs the same. A point's interpolation costs `--point` pairs: order^3 weights and three sums over them. This favours
the tree, for boxes are ragged and the sources of a box are gathered.
"""

import argparse
import dataclasses

import numpy as np
from _cases import sphere

NEAR = 4.0


@dataclasses.dataclass
class Count:
    """Pairs of sources with Chebyshev nodes and with points, and passes from a box's nodes to a child's."""

    nodes: int = 0
    points: int = 0
    passes: int = 0


def layers(n: int) -> tuple[np.ndarray, np.ndarray]:
    axes = np.array([0.5, 0.05, 1.5])
    wall = sphere(n // 50) * axes
    grow = np.geomspace(1e-4, 30, 50)
    return np.concatenate([wall + step * sphere(len(wall)) for step in grow]), axes


def cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.random.default_rng(0).uniform(-1, 1, (n, 3)), np.full(3, 0.5)


def visit(points, sources, centre, half, order: int, leaf: int, count: Count) -> None:
    """Adds what a box costs for the sources that no larger box around it has summed."""
    is_far = (np.abs(sources - centre) > NEAR * half).any(axis=1)
    near = sources[~is_far]
    few = len(points) <= order**3  # then the points themselves are fewer than the nodes
    if few:
        count.points += len(points) * len(sources)
        return
    count.nodes += order**3 * int(is_far.sum())
    if len(points) <= leaf or len(near) == 0:
        count.points += len(points) * len(near)
        return
    side = points > centre
    for corner in np.ndindex(2, 2, 2):
        inside = (side == np.array(corner, bool)).all(axis=1)
        if inside.any():
            count.passes += 1
            shift = (np.array(corner) - 0.5) * half
            visit(points[inside], near, centre + shift, half / 2, order, leaf, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--n", type=int, default=1_000_000)
    parser.add_argument("--order", type=int, default=6)
    parser.add_argument("--point", type=float, default=200)
    arguments = parser.parse_args()
    order = arguments.order
    print(
        "| points | sources | leaf | pairs at nodes | at points | interpolation | times fewer |\n|---|---|---|---|---|---|---|"
    )
    for name, make in (("layers", layers), ("cube", cube)):
        points, axes = make(arguments.n)
        half = np.abs(points).max()
        for s in (1000, 3000, 17_000):
            best = None
            for leaf in (500, 2000, 8000):
                count = Count()
                visit(points, sphere(s) * axes, np.zeros(3), half, order, leaf, count)
                passing = arguments.point * len(points) + count.passes * 3 * order**4
                cost = count.nodes + count.points + passing
                direct = s * len(points)
                row = (
                    direct / cost,
                    leaf,
                    count.nodes / direct,
                    count.points / direct,
                    passing / direct,
                )
                best = row if best is None else max(best, row)
            gain, leaf, *shares = best
            print(
                f"| {name} | {s:,} | {leaf} | "
                + " | ".join(f"{x:.0%}" for x in shares)
                + f" | {gain:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
