"""CPU microseconds a cell of `proof` and `proven_margin`, and how many cells of valid meshes stay unknown.

python -m benchmarks.proof [--cells 40000]
"""

import argparse
import itertools
from collections.abc import Callable

import faults
import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.topology import EDGES

from ._measure import about, cpu_seconds, table

SHAPES = ("triangle", "quad", "tetra", "pyramid", "wedge", "hexahedron")


def copies(kind: str, count: int, shift: float) -> tuple[jm.Mesh, np.ndarray]:
    """Makes cells of one type side by side that share no node, and shakes them by so much of the distance of nodes."""
    cell = lagrange_types()[kind]
    d, nodes = cell.dimension, len(cell.lattice)
    side = int(np.ceil(count ** (1 / d)))
    origins = np.array(
        list(itertools.islice(itertools.product(range(side), repeat=d), count)), float
    )
    points = (2 * origins[:, None] + cell.reference).reshape(-1, d)
    mesh = jm.Mesh(points, {kind: np.arange(count * nodes).reshape(count, nodes)})
    return mesh, points + shift / cell.order * np.random.default_rng(0).normal(size=points.shape)


def bent_cylinder(count: int) -> jm.Mesh:
    """Makes a bent, twisted tube of hexahedra whose layers at the outer wall are a thousandth of it."""
    heights = np.concatenate([0.3 + 0.7 * np.linspace(0, 1, count), 1 + 1e-3 * np.arange(1, 4)])
    angles, along = np.linspace(0, 2 * np.pi, 4 * count + 1)[:-1], np.linspace(0, 1, 3 * count)
    r, a, s = np.meshgrid(heights, angles, along, indexing="ij")
    a, turn = a + 0.8 * s, 1.2 * s
    from_axis = 4 / 1.2 + r * np.cos(a)
    x, y, z = from_axis * np.sin(turn), r * np.sin(a), -from_axis * np.cos(turn)
    ids = np.arange(r.size).reshape(r.shape)
    ids = np.concatenate([ids, ids[:, :1]], axis=1)
    low, high = slice(None, -1), slice(1, None)
    square = ((low, low), (high, low), (high, high), (low, high))
    cells = np.stack([ids[i, j, k].ravel() for k in (low, high) for i, j in square], axis=1)
    return jm.Mesh(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), {"hexahedron": cells})


def stator(count: int) -> jm.Mesh:
    """Makes a passage of a stator with thin layers at hub and shroud, its blade leant and twisted.

    The cascade's quads lie on cylinders about the x axis, 2 to 3 chords from it; `count` is that of
    the cells from hub to shroud.
    """
    flat = faults.cascade(around=120, layers=30, periodic=True)
    x, y = np.asarray(flat.points).T
    half = 0.5 * np.geomspace(1e-4, 1, count // 2)
    heights = np.concatenate([[0], half, 1 - half[-2::-1], [1]])
    stagger, lean = 0.3 * heights[:, None], 0.1 * np.sin(np.pi * heights[:, None])
    along, turn = x + 0 * stagger, y / 2.5 + stagger * x / 2.5 + lean
    r = 2 + heights[:, None]
    quads, n = flat.cells["quad"], len(x)
    cells = np.concatenate(
        [np.hstack([quads + i * n, quads + (i + 1) * n]) for i in range(len(heights) - 1)]
    )
    points = np.stack([along, r * np.sin(turn), r * np.cos(turn)], axis=-1).reshape(-1, 3)
    return jm.Mesh(points, {"hexahedron": cells})


def shaken(mesh: jm.Mesh) -> np.ndarray:
    """Moves the nodes by a tenth of the smallest edge of their cells at most."""
    x, cells = np.asarray(mesh.points), mesh.cells["hexahedron"]
    smallest = np.full(len(x), np.inf)
    for first, second in EDGES["hexahedron"]:
        length = np.linalg.norm(x[cells[:, first]] - x[cells[:, second]], axis=1)
        for corner in (first, second):
            np.minimum.at(smallest, cells[:, corner], length)
    return x + 0.1 * smallest[:, None] * np.random.default_rng(0).uniform(-1, 1, size=x.shape)


def speed(count: int) -> None:
    rows = []
    for shape, order in itertools.product(SHAPES, (1, 2, 3, 4)):
        name = next(
            c.name
            for c in lagrange_types().values()
            if (c.shape, c.order, c.is_complete) == (shape, order, True)
        )
        number = max(64, count // len(lagrange_types()[name].lattice) ** 2 * 25)
        mesh, points = copies(name, min(number, count), 0.02)
        calls: dict[str, Callable[[], object]] = {"end": lambda: jm.proof(mesh, points)}  # noqa: B023
        if order < 3:
            calls["motion"] = lambda: jm.proof(mesh, points, base=mesh.points)  # noqa: B023
        if order == 1:
            margin = jax.jit(lambda x: jm.proven_margin(mesh, x))  # noqa: B023
            gradient = jax.jit(
                jax.grad(lambda x: jnp.sum(jm.proven_margin(mesh, x, sharpness=50.0)))  # noqa: B023
            )
            calls |= {"traced": lambda: margin(points), "gradient": lambda: gradient(points)}  # noqa: B023
        took = cpu_seconds(calls, repeats=3)
        columns = ("end", "motion", "traced", "gradient")
        each = [
            f"{1e6 * took[call] / min(number, count):.3g}" if call in took else ""
            for call in columns
        ]
        rows.append([name, str(min(number, count)), *each])
    table(rows, ("type", "cells", "`proof`", "with `base`", "`proven_margin`, jit", "its gradient"))


def valid_meshes() -> None:
    meshes = {
        "bent cylinder": bent_cylinder(20),
        "wing": cases.wing(),
        "valve": faults.valve(),
        "blade tip": faults.blade_tip(),
        "cascade": faults.cascade(),
        "stator": stator(24),
    }
    rows = []
    for name, mesh in meshes.items():
        ends = {"": mesh.points} | ({"shaken": shaken(mesh)} if "hexahedron" in mesh.cells else {})
        for how, points in ends.items():
            report = jm.proof(mesh, points)
            inverted = int(jm.quality(mesh.moved(points)).inverted)
            counts = [
                str(each) for each in (report.count, report.valid, report.invalid, report.unknown)
            ]
            rows.append(
                [f"{name} {how}".strip(), *counts, f"{report.min_margin:.3g}", str(inverted)]
            )
    table(
        rows,
        ("mesh", "cells", "valid", "invalid", "unknown", "least margin", "inverted by `quality`"),
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=40_000)
    jax.config.update("jax_enable_x64", True)
    cells = parser.parse_args().cells
    about(cells=cells)
    speed(cells)
    valid_meshes()
