"""Boundaries that slide or repeat, against held ones: blocks, blades, a wing's root on a round body and on a fuselage.

    python benchmarks/boundaries.py

Each line: inverted cells, smallest Jacobian ratio, and the first angle (for wings and the neighbour, the first hundredth of the
length) that inverts a cell, in one step. For the block, the size-skew of its cells, too: smallest and mean, in one step and in 20.
"""

import itertools
from collections.abc import Callable, Iterator

import faults
import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm
from jaxmorph import cases


def block(cells: int = 25) -> jm.Mesh:
    """Makes a square of unit quads with a hole of five by five in the middle, its origin there."""
    points = (
        np.stack(np.meshgrid(*[np.arange(cells + 1.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
        - cells / 2
    )
    ids = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(
        -1, 4
    )
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


def judge(
    case: str,
    boundary: str,
    mesh: jm.Mesh,
    plan: jm.Plan,
    motion: Callable[[float], np.ndarray],
    angle: float,
    step: float,
) -> list[str]:
    """Measures how the mesh fares at an angle, and from which angle on cells are inverted; nothing follows a `case` of no name."""
    report = jm.quality(mesh, jm.deform(plan, motion(angle)))
    limit = angle
    inverted = int(report.inverted) > 0
    while (
        int(jm.quality(mesh, jm.deform(plan, motion(limit))).inverted) > 0
    ) == inverted and 0 < limit < 180:
        limit += -step if inverted else step
    first = limit + step if inverted else limit
    count, smallest = int(report.inverted), float(report.min_jacobian_ratio)
    return [case, boundary, str(count), f"{smallest:.3f}", f"{first:.0f}"]


def rows(is_page: bool = True) -> Iterator[list[str]]:
    """Makes the table, its heads first; for the page the first two rows of four meshes."""
    yield ["case", "boundary", "inverted", "smallest Jacobian ratio", "first"]
    for lines in (blocks, cascades, tips, wings):
        yield from itertools.islice(lines(), 2 if is_page else None)
    if not is_page:
        yield from neighbours()


def blocks() -> Iterator[list[str]]:
    mesh, sides = block(), ["left", "right", "bottom", "top"]
    base = mesh.points[mesh.patch("block")]

    def turned(degrees):
        return (
            np.asarray(jm.shapes.rotate(base, np.radians(degrees), about=(0, 0)))
            + 2.5 * degrees / 60
            - base
        )

    def shifted(degrees):
        return np.asarray(jm.shapes.rotate(base, np.radians(degrees), about=(0, 0))) + 5 - base

    plans = {
        "held": jm.prepare(mesh, "block", sides),
        "four sides slide": jm.prepare(mesh, "block", sliding=sides),
    }
    for case, motion in (
        ("block in a box of 25 by 25 cells, turned by 60 degrees and shifted", turned),
        ("the same block shifted by its side, 5, and turned by 60 degrees", shifted),
    ):
        for name, plan in plans.items():
            yield judge(case if name == "held" else "", name, mesh, plan, motion, 60, 2)


def skews() -> None:
    """Prints the size-skew of the block that is turned by 60 degrees and shifted by its side."""
    mesh, sides = block(), ["left", "right", "bottom", "top"]
    base = mesh.points[mesh.patch("block")]
    turns = [
        np.asarray(jm.shapes.rotate(base, np.radians(3.0 * k), about=(0, 0))) for k in range(1, 21)
    ]
    path = np.stack([turn - base + 5 * (k + 1) / 20 for k, turn in enumerate(turns)])
    for name, plan in (
        ("held", jm.prepare(mesh, "block", sides)),
        ("slide", jm.prepare(mesh, "block", sliding=sides)),
    ):
        for steps, part in ((1, path[-1:]), (20, path)):
            points = np.asarray(jm.march(plan, part)[1])
            least, mean = size_skew(mesh, points)
            count = int(jm.quality(mesh, points).inverted)
            print(
                f"sides {name}, {steps:2} steps: {count} inverted, size-skew {least:.3f} / {mean:.3f}"
            )


def cascades() -> Iterator[list[str]]:
    passage = faults.cascade(around=160, layers=40, first_cell=1e-3, periodic=True)
    blade, ends = np.asarray(passage.points)[passage.patch("blade")], ("inlet", "outlet")

    def pitched(degrees):
        return np.asarray(jm.shapes.rotate(blade, np.radians(degrees), about=(0.5, 0))) - blade

    for case, method in (
        ("blade of a cascade, pitched by 15 degrees", None),
        (
            "the blade by the classic RBF, Wendland C2 of two chords",
            jm.RBF.classic(jm.WendlandC2(2.0), degree=None),
        ),
    ):
        held = jm.prepare(passage, "blade", (*ends, "lower", "upper"), method=method)
        yield judge(case, "held", passage, held, pitched, 15, 1)
        plan = jm.prepare(
            passage, "blade", ends, periodic=jm.Periodic("lower", "upper"), method=method
        )
        yield judge("", "sides repeat", passage, plan, pitched, 15, 1)


def tips() -> Iterator[list[str]]:
    stage, ends = faults.blade_tip(), ("inlet", "outlet")
    nodes = np.asarray(stage.points)[stage.patch("blade")]

    def twisted(degrees):
        share = (np.linalg.norm(nodes[:, 1:], axis=1) - 1)[:, None]
        angle = np.radians(degrees) * share[:, 0]
        bend = 0.05 * degrees / 10 * share * nodes[:, :1] ** 2 * np.array([[0, 1, 0]])
        tilted = np.asarray(jm.shapes.rotate(nodes, angle, about=(0, 0, 0), axis=(0, 0, 1))) + bend
        radius = np.linalg.norm(nodes[:, 1:], axis=1) / np.linalg.norm(tilted[:, 1:], axis=1)
        tilted[:, 1:] *= radius[:, None]  # the tip keeps its gap
        return tilted - nodes

    case = "blade tip, five cells of a gap of 1 % below a shroud, leaned by 10 degrees and bent"
    held = jm.prepare(stage, "blade", ("hub", *ends, "left", "right", "shroud"))
    yield judge(case, "held", stage, held, twisted, 10, 1)
    slide, pair = (
        jm.Slide("shroud", jm.Revolution((1, 0, 0))),
        jm.Periodic("left", "right", axis=(1, 0, 0)),
    )
    plan = jm.prepare(stage, "blade", ("hub", *ends), sliding=slide, periodic=pair)
    yield judge("", "shroud slides, sides repeat", stage, plan, twisted, 10, 1)


def wings() -> Iterator[list[str]]:
    wing = faults.blade_tip(gap=0.4, layers=3)  # its hub is the fuselage
    nodes = wing.patch("blade")
    root = nodes[np.linalg.norm(np.asarray(wing.points)[nodes, 1:], axis=1) < 1 + 1e-9]
    outer = ("shroud", "inlet", "outlet", "left", "right")
    round_body = jm.Mesh(wing.points, wing.cells, {**wing.patches, "root": root})
    for body, surface, along, around, slides in (
        (
            round_body,
            jm.Revolution((1, 0, 0)),
            "wing whose root moves along its round body by 6 % of its chord",
            "the wing around the body",
            "body slides",
        ),
        (
            fuselage(round_body),
            None,
            "wing along a fuselage of faces that is no surface of revolution, by 6 %",
            "the wing around the fuselage",
            "faces slide",
        ),
    ):
        slide = jm.Slide(("hub", "root"), surface) if surface else jm.Slide(("hub", "root"))
        plans = {
            "held": jm.prepare(body, "blade", (*outer, "hub")),
            slides: jm.prepare(body, "blade", outer, sliding=slide),
        }
        for axis, case in ((0, along), (1, around)):

            def moved_by(hundredths, axis=axis):
                return np.tile(0.005 * hundredths * np.eye(3)[axis], (len(nodes), 1))

            for name, plan in plans.items():
                *line, first = judge(
                    case if name == "held" else "", name, body, plan, moved_by, 6, 2
                )
                yield [*line, f"{first} %"]


def neighbours() -> Iterator[list[str]]:
    pair = above_an_airfoil()
    start = np.asarray(pair.points)[pair.patch("neighbour")]

    def passed(hundredths):
        x = start[:, 0] + hundredths / 100
        return np.stack([x - start[:, 0], 0.24 * (start[:, 0] ** 2 - x**2) / 4], axis=1)

    for case, name, plan in (
        (
            "neighbour that passes along an airfoil's wall, a quarter above it, by 0.6",
            "held",
            jm.prepare(pair, "neighbour", ("outer", "wall")),
        ),
        (
            "",
            "the wall's nodes slide on its polyline",
            jm.prepare(pair, "neighbour", "outer", sliding="wall"),
        ),
    ):
        *line, first = judge(case, name, pair, plan, passed, 60, 5)
        yield [*line, f"{int(first) / 100:.2f}"]


def fuselage(mesh: jm.Mesh) -> jm.Mesh:
    """Makes a body of a round one that is no surface of revolution: wider than high, and thinner towards its end."""
    x, y, z = np.asarray(mesh.points).T
    return mesh.moved(
        np.stack([x, 1.3 * (1 - 0.1 * x) * y, (1 - 0.1 * x - 0.05 * x**2) * z], axis=1)
    )


def above_an_airfoil() -> jm.Mesh:
    """Makes a box of 0.5 by 0.25, a quarter above the upper side of an airfoil: an arc of 64 pieces."""
    mesh = cases.bodies(
        {"neighbour": (-0.5, 0.0, 0.25, 0.5)}, box=(-2.0, 2.0, 0.0, 2.0), spacing=0.0625
    )
    x, y = np.asarray(mesh.points).T
    patches = {"wall": np.flatnonzero(y == 0), "outer": np.flatnonzero((y == 2) | (np.abs(x) == 2))}
    points = np.stack([x, y + 0.3 * (1 - x**2 / 4) * (1 - y / 2)], axis=1)
    return jm.Mesh(points, mesh.cells, {"neighbour": mesh.patch("neighbour"), **patches})


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    about()
    lines = rows(is_page=False)
    table(lines, next(lines))
    skews()
