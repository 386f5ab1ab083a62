"""The AGARD 445.6 wing and its modes against published shape, tables and counts, VTK's cell quality, closed forms, another fit."""

import resource
from pathlib import Path

import gmsh
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import pyvista as pv

from benchmarks import agard445

INCH = 0.0254
TIP_TRAILING_EDGE = np.array([[(31.866 + 14.496) * INCH, 30 * INCH, 0.0]])
SHARED = [parent / "shared/cases/agard445-modes" for parent in Path(__file__).resolve().parents]
PUBLISHED = next((folder for folder in SHARED if folder.is_dir()), None)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def coarse(cache):
    return agard445.mesh(6_500, cache)


def boundary_faces(tetra):
    """The (k, 3) faces that belong to one tetrahedron only, and are not shared by three."""
    faces = np.sort(tetra[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    unique, counts = np.unique(faces, axis=0, return_counts=True)
    assert counts.max() == 2
    return unique[counts == 1]


def areas(points, faces):
    a, b, c = points[faces].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def aspect_ratios(mesh):
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells["tetra"]}, mesh.points)
    return grid.cell_quality("aspect_ratio")["aspect_ratio"]


def on_patch(mesh, faces, name):
    return faces[np.isin(faces, mesh.patch(name)).all(axis=1)]


def test_coarse_counts_and_quality(coarse):
    assert len(coarse.points) == pytest.approx(6_500, rel=0.05)
    assert len(coarse.patch("wing")) == pytest.approx(1_966, rel=0.05)
    ratios = aspect_ratios(coarse)
    assert ratios.mean() < 1.7
    assert ratios.max() < 12
    a, b, c, d = coarse.points[coarse.cells["tetra"]].swapaxes(0, 1)
    assert np.all(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) > 0)


def test_patches_are_the_boundary(coarse):
    faces = boundary_faces(coarse.cells["tetra"])
    named = {name: on_patch(coarse, faces, name) for name in ("wing", "symmetry", "farfield")}
    assert sum(map(len, named.values())) == len(faces)
    assert all(np.array_equal(np.unique(named[name]), coarse.patch(name)) for name in named)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2), (
        "the boundary is not closed"
    )
    assert np.unique(coarse.cells["tetra"]).size == len(coarse.points)
    for pair, least in ((("wing", "symmetry"), 40), (("farfield", "symmetry"), 20)):
        assert np.intersect1d(*(coarse.patch(name) for name in pair)).size > least
    assert np.intersect1d(coarse.patch("wing"), coarse.patch("farfield")).size == 0


def test_boundaries_are_where_they_should_be(coarse):
    at = {name: coarse.points[coarse.patch(name)] for name in coarse.patches}
    assert np.all(at["symmetry"][:, 1] == 0)
    assert np.all(coarse.points[:, 1] >= 0)
    distance = np.linalg.norm(at["farfield"] - [21.96 * INCH / 2, 0, 0], axis=1)
    assert distance == pytest.approx(8, abs=1e-12)
    x, y, z = at["wing"].T
    eta = y / (30 * INCH)
    xi = (x - 31.866 * INCH * eta) / (INCH * (21.96 + (14.496 - 21.96) * eta))
    assert eta.min() == 0
    assert eta.max() == pytest.approx(1, abs=1e-12)
    assert min(xi.min(), 1 - xi.max()) > -1e-9
    side = eta < 1 - 1e-9
    half = agard445.half_thickness(np.clip(xi, 0, 1)) * INCH * (21.96 + (14.496 - 21.96) * eta)
    assert np.abs(z)[side] == pytest.approx(half[side], abs=2e-5)
    assert np.all(np.abs(z)[~side] <= half[~side] + 2e-5)
    corners = [[0, 0, 0], [21.96, 0, 0], [31.866, 30, 0], [46.362, 30, 0]]
    for corner in np.array(corners) * INCH:
        assert np.linalg.norm(at["wing"] - corner, axis=1).min() < 1e-12


def test_areas_and_volume_agree_with_closed_forms(coarse):
    faces = boundary_faces(coarse.cells["tetra"])
    planform = 30 * (21.96 + 14.496) / 2 * INCH**2
    wetted = areas(coarse.points, on_patch(coarse, faces, "wing")).sum()
    assert 2 * planform < wetted < 2 * planform * 1.03
    assert areas(coarse.points, on_patch(coarse, faces, "symmetry")).sum() == pytest.approx(
        np.pi * 64, rel=0.01
    )
    assert areas(coarse.points, on_patch(coarse, faces, "farfield")).sum() == pytest.approx(
        2 * np.pi * 64, rel=0.03
    )
    a, b, c, d = coarse.points[coarse.cells["tetra"]].swapaxes(0, 1)
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
    assert volume == pytest.approx(2 / 3 * np.pi * 512, rel=0.05)


def test_the_cache_is_bit_for_bit_and_gmsh_leaves_nothing_behind(coarse, cache, monkeypatch, capfd):
    limit = resource.getrlimit(resource.RLIMIT_STACK)

    def check_options_and_fail(geo):
        for option, value in agard445.OPTIONS.items():
            assert gmsh.option.getNumber(option) == pytest.approx(value), option
        raise RuntimeError("made again")

    monkeypatch.setattr(agard445, "_wing", check_options_and_fail)
    cached = agard445.mesh(6_500, cache)
    assert np.array_equal(cached.points, coarse.points)
    assert np.array_equal(cached.cells["tetra"], coarse.cells["tetra"])
    assert all(np.array_equal(cached.patch(name), coarse.patch(name)) for name in coarse.patches)
    (file,) = cache.iterdir()
    assert gmsh.__version__ in file.name
    with pytest.raises(RuntimeError, match="made again"):
        agard445.mesh(16_000, cache)
    assert not gmsh.isInitialized()
    assert resource.getrlimit(resource.RLIMIT_STACK) == limit
    assert capfd.readouterr() == ("", "")


@pytest.mark.nightly
@pytest.mark.parametrize("points", [64_943, 16_000])
def test_finer_meshes(points, tmp_path):
    mesh = agard445.mesh(points, tmp_path)
    assert len(mesh.points) == pytest.approx(points, rel=0.05)
    ratios = aspect_ratios(mesh)
    assert ratios.mean() == pytest.approx(1.53, abs=0.06 if points == 64_943 else 0.1)
    assert ratios.max() < (8 if points == 64_943 else 12)
    if points == 64_943:
        assert len(mesh.cells["tetra"]) == pytest.approx(334_861, rel=0.05)
        assert len(mesh.patch("wing")) == pytest.approx(16_285, rel=0.05)
        assert len(mesh.patch("farfield")) == pytest.approx(923, rel=0.05)


def test_section_is_the_published_one():
    x = np.linspace(0, 1, 2001)
    z = agard445.half_thickness(x)
    table = np.array(agard445.STATIONS) / 100, np.array(agard445.HALF_THICKNESS) / 100
    np.testing.assert_allclose(agard445.half_thickness(table[0]), table[1], rtol=0, atol=1e-15)
    assert z.max() == pytest.approx(0.02, abs=2e-5)
    assert 0.40 < x[z.argmax()] < 0.45
    nose = np.array([1e-8])
    assert agard445.half_thickness(nose) ** 2 / (2 * nose) == pytest.approx(0.00102, rel=1e-3)
    slope = np.diff(z) / np.diff(x)
    assert np.sum(np.diff(np.sign(slope)) != 0) == 1, "more than one maximum"
    assert slope[1600:] == pytest.approx(np.full(400, -0.0482), abs=3e-3), (
        "the aft fifth is nearly straight"
    )


def test_section_belongs_to_its_family():
    """Half thickness over thickness is nearly linear in thickness: from the 65A008 and 65A006 of NASA's program.

    Ordinates at 20, 30 .. 90 % of the chord, in percent (public domain program naca456, after NASA TM 4741).
    """
    eight = np.array([3.3022, 3.7910, 3.9942, 3.8946, 3.4545, 2.7623, 1.8997, 0.9627]) / 8
    six = np.array([2.4754, 2.8415, 2.9949, 2.9247, 2.6014, 2.0859, 1.4389, 0.7307]) / 6
    four = 4 * (2 * six - eight)
    assert 100 * agard445.half_thickness(np.arange(0.2, 0.95, 0.1)) == pytest.approx(
        four, abs=0.006
    )


@pytest.mark.skipif(PUBLISHED is None, reason="the published table is not here")
@pytest.mark.parametrize("mode", [1, 2])
def test_table_is_the_published_one(mode):
    assert PUBLISHED is not None
    vertices = np.loadtxt(PUBLISHED / "yates_vertices.txt")[:, 1:] * INCH
    assert agard445.structural_nodes() == pytest.approx(vertices, abs=1e-4 * INCH)
    normal = np.loadtxt(PUBLISHED / f"yates_mode{mode}.txt")[:, 3]
    assert np.array_equal(np.ravel(agard445.DEFLECTIONS[mode]), normal)


@pytest.mark.parametrize(
    ("mode", "root_mean_square", "largest"), [(1, 0.0008, 0.003), (2, 0.005, 0.033)]
)
def test_modes_fit_the_table(mode, root_mean_square, largest):
    nodes = agard445.structural_nodes()
    table = np.ravel(agard445.DEFLECTIONS[mode])
    rest = (agard445.mode(nodes, mode)[:, 2] / (30 * INCH) - table / table[-1])[11:]
    assert np.sqrt(np.mean(rest**2)) < root_mean_square
    assert np.abs(rest).max() < largest


@pytest.mark.parametrize("mode", [1, 2])
def test_root_is_clamped_and_tip_is_one(mode):
    x = np.linspace(0, 21.96 * INCH, 20)
    root = np.column_stack([x, np.zeros(20), np.zeros(20)])
    assert np.all(agard445.mode(root, mode) == 0)
    slope = jax.vmap(jax.jacfwd(lambda p: agard445.mode(p[None], mode)[0]))(jnp.asarray(root))
    assert np.all(np.asarray(slope) == 0)
    moved = agard445.mode(TIP_TRAILING_EDGE, mode, amplitude=0.25)
    assert moved == pytest.approx(np.array([[0, 0, 0.25 * 0.762]]), abs=1e-12)
