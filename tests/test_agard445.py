"""The AGARD 445.6 wing against its published shape and counts, VTK's cell quality, and closed forms."""

import resource
import signal
import sys
from pathlib import Path

import gmsh
import numpy as np
import pytest
import pyvista as pv

from jaxmorph.cases import _agard445, agard445
from jaxmorph.cases import _agard445_mesh as gmsh_side
from jaxmorph.cases import _agard445_wing as wing

INCH = 0.0254


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def coarse(cache):
    return agard445(points=6_500, cache_directory=cache)


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
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2), "the boundary is not closed"
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
    half = wing.half_thickness(np.clip(xi, 0, 1)) * INCH * (21.96 + (14.496 - 21.96) * eta)
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
    assert areas(coarse.points, on_patch(coarse, faces, "symmetry")).sum() == pytest.approx(np.pi * 64, rel=0.01)
    assert areas(coarse.points, on_patch(coarse, faces, "farfield")).sum() == pytest.approx(2 * np.pi * 64, rel=0.03)
    a, b, c, d = coarse.points[coarse.cells["tetra"]].swapaxes(0, 1)
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
    assert volume == pytest.approx(2 / 3 * np.pi * 512, rel=0.05)


@pytest.mark.nightly
def test_same_bits_and_silence_inside_a_session_of_the_callers(coarse, capfd):
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        mine = {"General.Terminal": 0, "Mesh.Algorithm": 5, "Mesh.MeshSizeFactor": 0.5, "Mesh.RandomSeed": 7}
        for option, value in mine.items():
            gmsh.option.setNumber(option, value)
        gmsh.model.add("mine")
        gmsh.model.occ.addSphere(0, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        nodes = gmsh.model.mesh.getNodes()[1]
        again = gmsh_side.generate(gmsh, _agard445.RESOLUTIONS[6_500])
        assert gmsh.isInitialized()
        assert gmsh.model.getCurrent() == "mine"
        assert gmsh.model.list() == ["", "mine"]
        assert np.array_equal(gmsh.model.mesh.getNodes()[1], nodes)
        assert {option: gmsh.option.getNumber(option) for option in mine} == mine
    finally:
        gmsh.finalize()
    assert np.array_equal(again["points"], coarse.points)
    assert np.array_equal(again["tetra"], coarse.cells["tetra"])
    assert capfd.readouterr() == ("", "")


def check_options_and_fail(geo):
    for option, value in gmsh_side.OPTIONS.items():
        assert gmsh.option.getNumber(option) == pytest.approx(value), option
    raise RuntimeError("on purpose")


def test_a_session_of_its_own_leaves_nothing_behind(capfd, monkeypatch):
    handler, limit = signal.getsignal(signal.SIGINT), resource.getrlimit(resource.RLIMIT_STACK)
    monkeypatch.setattr(gmsh_side, "_wing", check_options_and_fail)
    with pytest.raises(RuntimeError, match="on purpose"):
        gmsh_side.generate(gmsh, _agard445.RESOLUTIONS[6_500])
    assert not gmsh.isInitialized()
    assert signal.getsignal(signal.SIGINT) is handler
    assert resource.getrlimit(resource.RLIMIT_STACK) == limit
    assert capfd.readouterr() == ("", "")


def no_meshing(*arguments):
    raise AssertionError("the mesh is in the cache and was made again")


def test_cache_is_used_and_bit_for_bit(coarse, cache, monkeypatch):
    monkeypatch.setattr(_agard445, "generate", no_meshing)
    cached = agard445(points=6_500, cache_directory=str(cache))
    assert np.array_equal(cached.points, coarse.points)
    assert np.array_equal(cached.cells["tetra"], coarse.cells["tetra"])
    assert all(np.array_equal(cached.patch(name), coarse.patch(name)) for name in coarse.patches)
    (file,) = cache.iterdir()
    assert gmsh.__version__ in file.name
    with pytest.raises(AssertionError, match="made again"):
        agard445(points=16_000, cache_directory=cache)
    monkeypatch.setattr(gmsh, "__version__", "0.0")
    with pytest.raises(AssertionError, match="made again"):
        agard445(points=6_500, cache_directory=cache)


def halve(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flip_a_byte(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)


def lose_an_array(file):
    np.savez(file, points=np.zeros((4, 3)))


def point_nowhere(file):
    with np.load(file) as stored:
        arrays = dict(stored)
    np.savez(file, **arrays | {"tetra": arrays["tetra"] + len(arrays["points"])})


def write_an_array(file):
    with file.open("wb") as stream:
        np.save(stream, np.zeros(3))


@pytest.mark.parametrize("damage", [halve, flip_a_byte, lose_an_array, point_nowhere, write_an_array, Path.unlink])
def test_a_damaged_cache_is_made_anew(coarse, tmp_path, monkeypatch, damage):
    arrays = {"points": coarse.points, "tetra": coarse.cells["tetra"], **coarse.patches}
    monkeypatch.setattr(_agard445, "generate", lambda *_: arrays)
    agard445(points=6_500, cache_directory=tmp_path / "new")
    (file,) = (tmp_path / "new").iterdir()
    damage(file)
    mesh = agard445(points=6_500, cache_directory=tmp_path / "new")
    assert np.array_equal(mesh.cells["tetra"], coarse.cells["tetra"])
    assert list((tmp_path / "new").iterdir()) == [file]
    monkeypatch.setattr(_agard445, "generate", no_meshing)
    assert np.array_equal(agard445(points=6_500, cache_directory=tmp_path / "new").points, coarse.points)


def test_a_cache_that_cannot_be_written_costs_a_warning(coarse, tmp_path, monkeypatch):
    arrays = {"points": coarse.points, "tetra": coarse.cells["tetra"], **coarse.patches}
    monkeypatch.setattr(_agard445, "generate", lambda *_: arrays)
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="could not be kept in .*file") as caught:
        mesh = agard445(points=6_500, cache_directory=tmp_path / "file" / "below")
    assert caught[0].filename != _agard445.__file__  # the caller's line, not the library's
    assert np.array_equal(mesh.points, coarse.points)


def test_what_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxmorph\[cases\]'"):
        agard445()
    (tmp_path / "gmsh.py").write_text("raise OSError('libGLU.so.1: cannot open shared object file')")
    monkeypatch.delitem(sys.modules, "gmsh")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match=r"libGLU\.so\.1.*apt-get install libglu1-mesa\."):
        agard445()
    monkeypatch.setitem(sys.modules, "platformdirs", None)
    with pytest.raises(ImportError, match=r"platformdirs.*cache_directory"):
        _agard445._user_cache()


def test_default_cache_is_the_users(tmp_path, monkeypatch):
    monkeypatch.setattr("platformdirs.user_cache_path", lambda name: tmp_path / name)
    assert _agard445._user_cache() == tmp_path / "jaxmorph"


def test_other_resolutions_are_refused():
    with pytest.raises(ValueError, match=r"`points` is 5000; .*64_943, 16_000, 6_500"):
        agard445(points=5_000)


@pytest.mark.nightly
@pytest.mark.parametrize("points", [64_943, 16_000])
def test_finer_meshes(points, tmp_path):
    mesh = agard445(points=points, cache_directory=tmp_path)
    assert len(mesh.points) == pytest.approx(points, rel=0.05)
    ratios = aspect_ratios(mesh)
    assert ratios.mean() == pytest.approx(1.53, abs=0.06 if points == 64_943 else 0.1)
    assert ratios.max() < (8 if points == 64_943 else 12)
    if points == 64_943:
        assert len(mesh.cells["tetra"]) == pytest.approx(334_861, rel=0.05)
        assert len(mesh.patch("wing")) == pytest.approx(16_285, rel=0.05)
        assert len(mesh.patch("farfield")) == pytest.approx(923, rel=0.05)
