"""Large and awkward motions: how far each method takes them before a cell inverts, in one step, in many, and improved.

    python benchmarks/awkward.py [--points 1200] [--motion store ...] [--method default ...]

Shares of the motion, to 1 %, or the smallest Jacobian ratio at its end where all of it is reached. `improve` is `jm.improve` of
the last step's mesh. Walls that nearly touch, a valve that closes among them, are those of gaps.py.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence

import jax
import numpy as np
from _measure import about, table
from _walls import flap, pitch

import jaxmorph as jm
from jaxmorph import cases

METHODS: dict[str, Callable[[], jm.AbstractMethod]] = {
    "default": lambda: jm.SurfaceReconstruction(),
    "classic RBF": lambda: jm.RBF.classic(),
    "elasticity": lambda: jm.LinearElasticity(),
    "torsional": lambda: jm.TorsionalSprings(),
}
IMPROVED = ("default",)
"""Methods whose last mesh is improved too."""
Motion = Callable[[float], np.ndarray]
"""Displacements of the moving nodes at a share of the motion."""
Case = tuple[jm.Mesh, str, tuple[str, ...], Motion, int]
"""Mesh, moving patch, fixed ones, motion and number of steps."""


def ice(base: np.ndarray, height: float) -> np.ndarray:
    """Two horns of ice at the leading edge, each 2 % of the chord wide, along the wall's normal there."""
    x, y = base.T
    s = np.sign(y) * np.sqrt(np.maximum(x, 0))
    horn = np.exp(-(((s - 0.12) / 0.03) ** 2)) + 0.6 * np.exp(-(((s + 0.1) / 0.04) ** 2))
    return height * horn[:, None] * np.array([-0.8, 0.0]) + height * horn[:, None] * np.sign(y)[
        :, None
    ] * [0, 0.6]


def airfoil(points: int, motion: Callable[[np.ndarray, float], np.ndarray], steps: int) -> Case:
    mesh = cases.naca0015(points=points)
    base = mesh.points[mesh.patch("airfoil")]
    return mesh, "airfoil", ("farfield",), lambda share: motion(base, share), steps


def boxed(
    boxes: Mapping[str, tuple[float, ...]], moving: str, way: tuple[float, float], steps: int
) -> Case:
    mesh = cases.bodies(boxes)
    shape = mesh.points[mesh.patch(moving)].shape
    still = tuple(name for name in mesh.patches if name != moving)
    return mesh, moving, still, lambda share: np.broadcast_to(share * np.array(way), shape), steps


STORE = {"wing": (-2.0, 2.0, 1.0, 1.5), "store": (-0.5, 0.5, 0.0, 0.5)}
PASSING = {"upper": (-4.0, -3.0, 0.5, 1.5), "lower": (-0.5, 0.5, -1.5, -0.5)}


def motions(points: int) -> dict[str, Callable[[], Case]]:
    return {
        "flap 90, blended over 0.4": lambda: airfoil(
            points, lambda x, t: flap(x, 90 * t, 0.4)[0], 9
        ),
        "pitch 180": lambda: airfoil(points, lambda x, t: pitch(x, 180 * t)[0], 9),
        "ice, 5 % of the chord": lambda: airfoil(points, lambda x, t: ice(x, 0.05 * t), 5),
        "two bodies pass, 6 lengths": lambda: boxed(PASSING, "upper", (6.0, 0.0), 30),
        "store, 4 to the far side": lambda: boxed(STORE, "store", (0.0, -4.0), 20),
    }


def share(case: Case, plan: jm.Plan, steps: int, mend: bool) -> tuple[float, float]:
    """Largest share of the motion that leaves no cell inverted, to 1 %, and the smallest Jacobian ratio there."""
    mesh, _, _, motion, _ = case

    def ratio(share: float) -> float:
        path = np.stack([motion(share * (j + 1) / steps) for j in range(steps)])
        points = jm.march(plan, path)[1]
        report = jm.quality(mesh, jm.improve(mesh, points).points if mend else points)
        return -1.0 if int(report.inverted) else float(report.min_jacobian_ratio)

    low, high, best = 0.0, 0.999, 1.0
    if (whole := ratio(high)) > 0:
        return 1.0, whole
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high, best = (
            (middle, high, here) if (here := ratio(middle)) > 0 else (low, middle, best)
        )
    return low, best


def rows(
    points: int = 1200, begins: tuple[str, ...] = ("",), methods: Sequence[str] = tuple(METHODS)[:3]
) -> Iterator[list[str]]:
    """Makes the table, its heads first; of the motions whose names begin with one of some words."""
    yield ["motion", "method", "one step", "several", "several, improved"]
    for name, make in motions(points).items():
        if not name.startswith(begins):
            continue
        case = make()
        mesh, moving, fixed, _, steps = case
        for method in methods:
            line = [f"{name}; {steps} steps" if method == methods[0] else "", method]
            try:
                plan = jm.prepare(mesh, moving, fixed, method=METHODS[method]())
            except ValueError as error:
                yield [*line, str(error)[:60], "", ""]
                continue
            for count, mend in ((1, False), (steps, False), (steps, True)):
                if mend and method not in IMPROVED:
                    line.append("")
                    continue
                reached, ratio = share(case, plan, count, mend)
                line.append(f"all, {ratio:.2f}" if reached == 1 else f"{100 * reached:.0f} %")
            yield line
        jax.clear_caches()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=1200)
    parser.add_argument(
        "--motion", nargs="+", default=[""], help="words that begin a motion's name"
    )
    parser.add_argument("--method", nargs="+", choices=METHODS, default=list(METHODS))
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about(points=asked.points)
    lines = rows(asked.points, tuple(asked.motion), asked.method)
    table(lines, next(lines))


if __name__ == "__main__":
    main()
