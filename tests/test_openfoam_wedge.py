"""OpenFOAM's axisymmetric cases: a mesh in (x, r), written back to both planes."""

import re
import shutil

import foam
import numpy as np
import pytest
from foam import around, pipe_of
from formats import rewritten
from runs import printed
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import io


@pytest.fixture
def pipe(tmp_path):
    points, cells, patches, x, r = pipe_of()
    foam.write_case(tmp_path / "pipe", points, cells, patches)
    return tmp_path / "pipe", x, r


def test_sides_of_a_cut_through_a_wedge_stay_apart(tmp_path):
    """Both sides have nodes at the same places: each node's partner is across its own cells."""
    mesh = io.read(foam.write_case(tmp_path / "cut", *pipe_of(is_cut=True)[:3]))
    points = np.asarray(mesh.points)
    assert len(points) == 12
    io.write(
        tmp_path / "moved", mesh.moved(points + (np.arange(12) > 8)[:, None] * np.array([0, 0.05]))
    )
    moved = np.asarray(io.read(tmp_path / "moved").points)
    np.testing.assert_allclose(moved[:9], points[:9], rtol=0, atol=1e-15)
    np.testing.assert_allclose(moved[9:, 1], 0.45, rtol=0, atol=1e-12)


def test_a_wedge_is_a_plane_mesh(pipe, tmp_path):
    case, x, r = pipe
    mesh = io.read(case)
    np.testing.assert_allclose(
        mesh.points, np.stack([x.ravel(), r.ravel()], axis=1), rtol=0, atol=1e-15
    )
    assert {name: len(nodes) for name, nodes in mesh.patches.items()} == {
        "wall": 3,
        "ends": 6,
        "axis": 3,
    }
    area = np.asarray(jm.quality(mesh).area)
    assert area.min() > 0
    np.testing.assert_allclose(area.sum(), 2, rtol=1e-14)
    moved = np.stack([x + 0.1 * np.sin(x), 1.2 * r], axis=-1).reshape(-1, 2)
    again = rewritten(tmp_path / "moved", mesh.moved(moved))
    np.testing.assert_allclose(again.points, moved, rtol=0, atol=1e-14)
    both = [around(x + 0.1 * np.sin(x), 1.2 * r, side).reshape(-1, 3) for side in (1, -1)]
    expected = np.concatenate([both[0], both[1].reshape(3, 3, 3)[:, 1:].reshape(-1, 3)])
    np.testing.assert_allclose(again.source.content.points, expected, rtol=0, atol=1e-14)
    io.write(tmp_path / "rounded", mesh.moved(np.where(moved == 0, 1e-14, moved)))
    np.testing.assert_allclose(
        io.read(tmp_path / "rounded").source.content.points, expected, rtol=0, atol=1e-13
    )
    assert (np.asarray(io.read(tmp_path / "rounded").source.content.points)[::3][:3, 1:] == 0).all()
    with pytest.raises(
        ValueError, match="3 nodes of the axis have left it, first node 0: name it, symmetry='axis'"
    ):
        io.write(tmp_path / "off", mesh.moved(moved + 0.1))
    w = np.random.default_rng(0).normal(size=expected.shape)
    plane = mesh.source.content.plane
    h = np.random.default_rng(1).normal(size=moved.shape) * (r.ravel() > 0)[:, None]
    spread = plane.in_space(expected, moved + h) - plane.in_space(expected, moved)
    np.testing.assert_allclose(np.vdot(w, spread), np.vdot(plane.added(w), h), rtol=1e-12)


def test_a_patch_named_axis_is_joined_or_refused(pipe):
    case = pipe[0]
    boundary = case / "constant" / "polyMesh" / "boundary"
    text = boundary.read_text()
    end = text.rindex(")")
    count, entry = (
        re.search(r"^(\d+)\s*\(", text, re.MULTILINE),
        "axis { type patch; nFaces 0; startFace 0; }\n",
    )
    boundary.write_text(
        text[: count.start(1)]
        + str(int(count[1]) + 1)
        + text[count.end(1) : end]
        + entry
        + text[end:]
    )
    assert len(io.read(case).patch("axis")) == 3
    boundary.write_text(re.sub(r"\bwall\b", "axis", text, count=1))
    with pytest.raises(ValueError, match="pipe: the patch axis has faces"):
        io.read(case)


@pytest.mark.slow
def test_the_axis_needs_no_flag(pipe, tmp_path, capsys):
    """Nodes on the axis move along it alone, and a mesh of which no patch is left to stay needs no fixed one."""
    mesh = io.read(pipe[0])
    assert io.symmetry(mesh) == ("axis",)
    flags = ["--moving", "wall", "--translate", "0.1", "0.05", "--method", "rbf"]
    argv = ["deform", str(pipe[0]), str(tmp_path / "moved"), *flags]
    said = printed(capsys, [*argv, "--fixed", "ends"])
    assert "symmetry axis: 3 nodes" in said
    moved = np.asarray(io.read(tmp_path / "moved").points) - mesh.points
    axis = mesh.patch("axis")
    assert np.all(moved[axis, 1] == 0)
    assert np.abs(moved[axis, 0]).max() > 1e-3
    argv[2:5] = [str(tmp_path / "all"), "--moving", "wall", "ends"]
    assert "fixed    no patch: 0 nodes" in printed(capsys, argv)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the case is decomposed")
def test_parts_of_a_wedge_about_any_axis(tmp_path):
    """Each part finds the axis anew, so its places differ from the others' by rounding."""
    points, cells, patches, _, _ = pipe_of()
    tilted = points @ Rotation.from_rotvec([0.3, 0.7, -0.4]).as_matrix().T + [0.3, -2, 5]
    foam.write_case(tmp_path / "pipe", tilted, cells, patches)
    foam.write_parts(tmp_path / "pipe", tilted, cells, patches, [0, 1, 0, 1])
    whole, case = io.read(tmp_path / "pipe"), io.Decomposed(tmp_path / "pipe")
    surface = case.surface()
    kept = {"symmetry": "axis", "method": jm.RBF.classic(jm.ThinPlateSpline())}
    boundary = jm.Boundary(surface, "wall", "ends", symmetry="axis")
    known = {"nodes": io.global_nodes(surface), "faces": surface.cells}
    half = jm.prepare_surface(boundary, method=kept["method"], **known)
    u = np.zeros((3, 2))
    u[1, 1] = 0.2
    moved = whole.moved(jm.deform(jm.prepare(whole, "wall", "ends", **kept), u))
    expected = rewritten(tmp_path / "whole", moved).source.content.points
    with case.writing(tmp_path / "parts") as writer:
        for k in range(2):
            part = case.read(k)
            writer.add(k, part.moved(jm.deform(half.attach(part.points, io.global_nodes(part)), u)))
    for k in range(2):
        content = io.read(tmp_path / "parts" / f"processor{k}").source.content
        np.testing.assert_allclose(content.points, expected[content.point_ids], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["compressible/rhoCentralFoam/LadenburgJet60psi", "combustion/coldEngineFoam/freePiston"],
)
def test_wedges_of_tutorials(name, tmp_path):
    foam.need_openfoam()
    case = shutil.copytree(foam.EXAMPLES / name, tmp_path / "case")
    foam.run(case, "blockMesh")
    mesh = io.read(case)
    assert int(jm.quality(mesh).inverted) == 0
    points, size = np.asarray(mesh.points), np.ptp(mesh.points, axis=0)
    moved = (points + [[0.05, 0]] * size * np.sin(3 * points / size)) * [1, 1.1]
    io.write(tmp_path / "moved", mesh.moved(moved))
    assert foam.verdict(tmp_path / "moved") == foam.verdict(case) == ["Mesh OK."]
