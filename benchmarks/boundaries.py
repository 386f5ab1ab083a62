"""Boundaries that slide or repeat, against held ones: blocks, blades, a wing's root on a round body and on a fuselage.

    python benchmarks/boundaries.py

Each line: inverted cells, smallest Jacobian ratio, and the first angle (for wings and the neighbour, the first hundredth of the
length) that inverts a cell, in one step. For the block, the size-skew of its cells, too: smallest and mean, in one step and in 20.
"""

from collections.abc import Callable

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)


def block(cells: int = 25) -> jm.Mesh:
    """Makes a square of unit quads with a hole of five by five in the middle, its origin there."""
    points = np.stack(np.meshgrid(*[np.arange(cells + 1.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2) - cells / 2
    ids = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(-1, 4)
    quads = quads[(np.abs(points[quads].mean(axis=1)) > 2.5).any(axis=1)]
    used, quads = np.unique(quads, return_inverse=True)
    points = points[used]
    patches = {"block": np.flatnonzero((np.abs(points) <= 2.5).all(axis=1))}
    for name, axis, side in (("left", 0, -1), ("right", 0, 1), ("bottom", 1, -1), ("top", 1, 1)):
        patches[name] = np.flatnonzero(points[:, axis] == side * cells / 2)
    return jm.Mesh(points, {"quad": quads.reshape(-1, 4)}, patches)


def size_skew(mesh: jm.Mesh, points: np.ndarray) -> tuple[float, float]:
    """Measures the smallest and the mean size-skew of quads: the root of the relative size, times the skew.

    Source: Knupp, Algebraic mesh quality metrics for unstructured initial meshes, Finite Elem. Anal. Des. 39, 2003; combined
    as in de Boer et al., Mesh deformation based on radial basis function interpolation, Comput. Struct. 85, 2007.
    """

    def parts(places):
        x = places[mesh.cells["quad"]]
        after, before = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
        areas = after[..., 0] * before[..., 1] - after[..., 1] * before[..., 0]
        lengths = np.linalg.norm(after, axis=2) * np.linalg.norm(before, axis=2)
        return areas, 4 / np.sum(lengths / np.maximum(areas, 1e-300), axis=1)

    (areas, skew), (first, _) = parts(np.asarray(points)), parts(np.asarray(mesh.points))
    ratio = np.maximum(areas[:, ::2].sum(axis=1) / first[:, ::2].sum(axis=1), 1e-300)
    values = np.sqrt(np.minimum(ratio, 1 / ratio)) * skew
    return float(values.min()), float(values.mean())


def judge(name: str, mesh: jm.Mesh, plan: jm.Plan, motion: Callable[[float], np.ndarray], angle: float, step: float):
    """Prints how the mesh fares at an angle, and from which angle on cells are inverted."""
    report = jm.quality(mesh, jm.deform(plan, motion(angle)))
    limit = angle
    inverted = int(report.inverted) > 0
    while (int(jm.quality(mesh, jm.deform(plan, motion(limit))).inverted) > 0) == inverted and 0 < limit < 180:
        limit += -step if inverted else step
    first = limit + step if inverted else limit
    print(
        f"{name:34} {angle:5.0f} deg: {int(report.inverted):4} inverted, smallest {float(report.min_jacobian_ratio):6.3f}; "
        f"first at {first:.0f} deg",
        flush=True,
    )


def main() -> None:
    mesh, sides = block(), ["left", "right", "bottom", "top"]
    base = mesh.points[mesh.patch("block")]

    def turned(degrees):
        return np.asarray(jm.shapes.rotate(base, np.radians(degrees), about=(0, 0))) + 2.5 * degrees / 60 - base

    held, slides = jm.prepare(mesh, "block", sides), jm.prepare(mesh, "block", sliding=sides)

    def shifted(degrees):
        return np.asarray(jm.shapes.rotate(base, np.radians(degrees), about=(0, 0))) + 5 - base

    for name, plan in (("held", held), ("slide", slides)):
        judge(f"block, sides {name}", mesh, plan, turned, 60, 2)
        judge(f"block, shifted by 5, sides {name}", mesh, plan, shifted, 60, 2)
        farther = np.stack([turned(3.0 * k) + 2.5 * k / 20 for k in range(1, 21)])
        for steps, path in ((1, farther[-1:]), (20, farther)):
            points = np.asarray(jm.march(plan, path)[1])
            least, mean = size_skew(mesh, points)
            count = int(jm.quality(mesh, points).inverted)
            print(
                f"    60 degrees and a shift of 5, {steps:2} steps: {count} inverted, size-skew {least:.3f} / {mean:.3f}"
            )

    passage = cases.cascade(around=160, layers=40, first_cell=1e-3, periodic=True)
    blade, ends = np.asarray(passage.points)[passage.patch("blade")], ("inlet", "outlet")

    def pitched(degrees):
        return np.asarray(jm.shapes.rotate(blade, np.radians(degrees), about=(0.5, 0))) - blade

    for kind, method in (("", None), (", Wendland C2", jm.RBF.classic(jm.WendlandC2(2.0), degree=None))):
        held = jm.prepare(passage, "blade", (*ends, "lower", "upper"), method=method)
        judge(f"cascade, sides held{kind}", passage, held, pitched, 15, 1)
        pair = jm.Periodic("lower", "upper")
        plan = jm.prepare(passage, "blade", ends, periodic=pair, method=method)
        judge(f"cascade, sides repeat{kind}", passage, plan, pitched, 15, 1)

    stage = cases.blade_tip()
    nodes = np.asarray(stage.points)[stage.patch("blade")]

    def twisted(degrees):
        share = (np.linalg.norm(nodes[:, 1:], axis=1) - 1)[:, None]
        angle = np.radians(degrees) * share[:, 0]
        bend = 0.05 * degrees / 10 * share * nodes[:, :1] ** 2 * np.array([[0, 1, 0]])
        tilted = np.asarray(jm.shapes.rotate(nodes, angle, about=(0, 0, 0), axis=(0, 0, 1))) + bend
        radius = np.linalg.norm(nodes[:, 1:], axis=1) / np.linalg.norm(tilted[:, 1:], axis=1)
        tilted[:, 1:] *= radius[:, None]  # the tip keeps its gap
        return tilted - nodes

    pair = jm.Periodic("left", "right", axis=(1, 0, 0))
    fixed = ("hub", *ends)
    held = jm.prepare(stage, "blade", (*fixed, "left", "right", "shroud"))
    judge("blade tip, all held", stage, held, twisted, 10, 1)
    slide = jm.Slide("shroud", jm.Revolution((1, 0, 0)))
    plan = jm.prepare(stage, "blade", fixed, sliding=slide, periodic=pair)
    judge("blade tip, shroud slides, sides repeat", stage, plan, twisted, 10, 1)
    moved = np.asarray(jm.deform(plan, twisted(10)))
    off = np.abs(np.linalg.norm(moved[stage.patch("shroud"), 1:], axis=1) - 2).max()
    print(f"off the shroud {off:.1e}")

    wing = cases.blade_tip(gap=0.4, layers=3)  # its hub is the fuselage
    nodes = wing.patch("blade")
    root = nodes[np.linalg.norm(np.asarray(wing.points)[nodes, 1:], axis=1) < 1 + 1e-9]
    body = jm.Mesh(wing.points, wing.cells, {**wing.patches, "root": root})
    outer = ("shroud", *ends, "left", "right")
    held = jm.prepare(body, "blade", (*outer, "hub"))
    slides = jm.prepare(body, "blade", outer, sliding=jm.Slide(("hub", "root"), jm.Revolution((1, 0, 0))))
    for axis, way in ((0, "along"), (1, "around")):

        def moved_by(hundredths, axis=axis):
            return np.tile(0.005 * hundredths * np.eye(3)[axis], (len(nodes), 1))

        for name, plan in (("held", held), ("slides", slides)):
            judge(f"wing moves {way} a body that {'is held' if name == 'held' else name}", body, plan, moved_by, 6, 2)

    body = fuselage(body)
    held = jm.prepare(body, "blade", (*outer, "hub"))
    slides = jm.prepare(body, "blade", outer, sliding=jm.Slide(("hub", "root")))
    for axis, way in ((0, "along"), (1, "around")):

        def moved_by(hundredths, axis=axis):
            return np.tile(0.005 * hundredths * np.eye(3)[axis], (len(nodes), 1))

        for name, plan in (("held", held), ("slides", slides)):
            judge(f"wing {way} a fuselage of faces, {name}", body, plan, moved_by, 6, 2)

    pair = above_an_airfoil()
    start = np.asarray(pair.points)[pair.patch("neighbour")]

    def passed(hundredths):
        x = start[:, 0] + hundredths / 100
        return np.stack([x - start[:, 0], 0.24 * (start[:, 0] ** 2 - x**2) / 4], axis=1)

    held = jm.prepare(pair, "neighbour", ("outer", "wall"))
    slides = jm.prepare(pair, "neighbour", "outer", sliding="wall")
    for name, plan in (("held", held), ("slides", slides)):
        judge(f"neighbour of an airfoil's wall, {name}", pair, plan, passed, 60, 5)


def fuselage(mesh: jm.Mesh) -> jm.Mesh:
    """Makes a body of a round one that is no surface of revolution: wider than high, and thinner towards its end."""
    x, y, z = np.asarray(mesh.points).T
    return mesh.moved(np.stack([x, 1.3 * (1 - 0.1 * x) * y, (1 - 0.1 * x - 0.05 * x**2) * z], axis=1))


def above_an_airfoil() -> jm.Mesh:
    """Makes a box of 0.5 by 0.25, a quarter above the upper side of an airfoil: an arc of 64 pieces."""
    mesh = cases.bodies({"neighbour": (-0.5, 0.0, 0.25, 0.5)}, box=(-2.0, 2.0, 0.0, 2.0), spacing=0.0625)
    x, y = np.asarray(mesh.points).T
    patches = {"wall": np.flatnonzero(y == 0), "outer": np.flatnonzero((y == 2) | (np.abs(x) == 2))}
    points = np.stack([x, y + 0.3 * (1 - x**2 / 4) * (1 - y / 2)], axis=1)
    return jm.Mesh(points, mesh.cells, {"neighbour": mesh.patch("neighbour"), **patches})


if __name__ == "__main__":
    main()
