"""The default never loses: on generated meshes and motions it keeps what the best of three other methods keeps."""

import importlib
import pathlib
import re
import sys
import warnings

import numpy as np
import pytest

import jaxmorph as jm
from benchmarks import faults

ROOT = pathlib.Path(__file__).parents[1]

FLAT = (
    *(
        "C-grid 0015",
        "C-grid 4412, thin cells",
        "C-grid 0012, sharp",
        "C-grid 0006, sharp",
        "O-grid, sharp",
    ),
    *(
        "O-grid, circle",
        "three round bodies",
        "a round body beside a held one",
        "pins between walls",
    ),
    *(
        "rod in a sleeve",
        "channel",
        "cascade",
        "nozzle, axis held",
        "nozzle, axis slides",
        "flap on a wall",
    ),
    *("hinged tail", "thin plate", "triangles, sharp airfoil"),
)
SOLID = ("extruded circle, 3 over 1", "wing", "box, tetra", "sphere", "rod on a held floor")
SOLID += ("rod, inside moves", "vessel", "blade row")
KNOWN = {
    "O-grid, circle": ("lobes 6",),
    "O-grid, sharp": ("nose droop",),
    "rod in a sleeve": ("dent",),
    "vessel": ("widened",),
}
"""Large changes on a short length of the wall: right angles there cost more than 0.2 of the ratio."""

OFTEN = ("C-grid 0015", "deck, triangles", "box, tetra")
"""`.ci/run` has these, `.ci/nightly` all of them."""


@pytest.fixture(scope="module")
def rows():
    """The benchmark, with the modules beside it."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    before = set(sys.modules)
    yield importlib.import_module("rows")
    sys.path.remove(str(ROOT / "benchmarks"))
    for name in set(sys.modules) - before:
        if "benchmarks" in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def named(rows, name):
    return next(case for case in rows.all_cases() if case.name == name)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in OFTEN else pytest.mark.nightly)
        for name in (*FLAT, *SOLID)
    ],
)
def test_the_default_never_loses(rows, name):
    """It inverts no cell where one of the others inverts none, and keeps 0.8 of their best smallest Jacobian ratio."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = list(rows.rows_of(named(rows, name), np.random.default_rng([0, *name.encode()])))
    assert not any(row.ratios["default"] <= 0 < row.best for row in found)
    short = {(row.case, row.motion): row.ratios for row in found if row.is_short}
    assert all(motion in KNOWN.get(case, ()) for case, motion in short), short


@pytest.mark.nightly
def test_cells_beside_a_symmetry_plane_follow_the_wall(rows):
    """Nodes of parallel planes are guided by the same layer at the wall: one layer of cells between planes lost 2 of them."""
    case = named(rows, "extruded circle, 3 over 1")
    for whole in (True, False):
        plan = case.prepared(None, whole)
        ratio = rows.ratio(case, plan, case.motions["lobes 6"], 1.5)
        assert ratio > 0.6, whole


def test_points_alone_are_interpolated():
    """Points show neither thin edges nor who is whose neighbour: the sharp edge of a section lost cells to the fit."""
    mesh = faults.sharp_o_grid(around=96, layers=32, first_cell=1e-5)
    wall = mesh.patch("airfoil")
    plan = jm.prepare(mesh.points, wall, mesh.patch("farfield"))
    x = mesh.points[wall, 0]
    report = jm.quality(mesh, jm.deform(plan, np.stack([0 * x, 0.4 * x * (1 - x)], axis=1)))
    assert int(report.inverted) == 0
    assert float(report.min_jacobian_ratio) > 0.8


@pytest.mark.nightly
def test_too_few_sources_are_told_with_a_number_that_is_enough(rows):
    case = named(rows, "extruded circle, 3 over 1")
    u = case.motions["lobes 6"](case.base, 1.0)
    few = case.prepared(
        jm.SurfaceReconstruction(jm.FittedRBF(jm.RBF(reduction=jm.KDTree(4)))), True
    )
    seen = jm.inspect(few, u)
    assert seen.missed > 1 / 3
    leaves = int(re.search(r"KDTree\((\d+), extremes=True\)", str(seen))[1])
    enough = jm.SurfaceReconstruction(
        jm.FittedRBF(jm.RBF(reduction=jm.KDTree(leaves, extremes=True)))
    )
    again = jm.inspect(case.prepared(enough, True), u)
    assert again.missed < 1 / 3
    assert "do not resolve" not in str(again)
    assert "do not resolve" not in str(jm.inspect(case.prepared(None, True), u))
