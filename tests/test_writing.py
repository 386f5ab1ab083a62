"""Writing beside judging: a file appears where it is wanted, and leaves nothing where it is not."""

import contextlib

import foam
import numpy as np
import pytest
from meshes import ring

from jaxmorph import io
from jaxmorph.cli._way import writing


@pytest.fixture(params=["1", "2"], ids=["one core", "two cores"])
def number_of_cores(request, monkeypatch):
    monkeypatch.setenv("JAXMORPH_CPUS", request.param)


@pytest.fixture
def meshes(tmp_path):
    """A file's mesh, and the mesh that is written over it or beside it."""
    mesh = ring()
    io.write(tmp_path / "there.su2", mesh)
    return mesh, mesh.moved(np.asarray(mesh.points) * 1.1)


def names(folder):
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.usefixtures("number_of_cores")
@pytest.mark.parametrize("name", ["there.su2", "new.su2"])
def test_a_file_appears_when_it_is_wanted(tmp_path, meshes, name):
    before = (tmp_path / "there.su2").read_bytes()
    with writing(io.write, tmp_path / name, meshes[1]) as finish:
        assert (tmp_path / "there.su2").read_bytes() == before
        assert not (tmp_path / "new.su2").exists()
        finish()
        np.testing.assert_array_equal(io.read(tmp_path / name).points, meshes[1].points)
    assert names(tmp_path) == sorted({"there.su2", name})


@pytest.mark.usefixtures("number_of_cores")
@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("name", ["there.su2", "new.su2"])
def test_an_unwanted_file_leaves_nothing(tmp_path, meshes, name, error):
    before = (tmp_path / "there.su2").read_bytes()
    ended = contextlib.nullcontext() if error is None else pytest.raises(error)
    with ended, writing(io.write, tmp_path / name, meshes[1]):
        if error is not None:
            raise error
    assert names(tmp_path) == ["there.su2"]
    assert (tmp_path / "there.su2").read_bytes() == before


@pytest.mark.usefixtures("number_of_cores")
def test_an_unwanted_time_of_a_case_leaves_the_case_as_it_is(tmp_path):
    case = tmp_path / "case"
    foam.write_case(case, *foam.mixed()[:2], [("all", "patch", lambda nodes: True)])
    (case / "1" / "polyMesh").mkdir(parents=True)
    (case / "1" / "polyMesh" / "points.gz").write_bytes(b"of another run")
    before = names(case)
    mesh = io.read(case)
    moved = mesh.moved(np.asarray(mesh.points) * 1.1)
    for time in ("1", "2"):
        with writing(io.write, case / time, moved):
            pass
    assert names(case) == before


@pytest.mark.usefixtures("number_of_cores")
def test_an_error_of_the_writer_is_raised_where_the_file_is_wanted(tmp_path, meshes):
    with pytest.raises(ValueError, match="1 of"), writing(io.write, tmp_path / "new.su2", broken(meshes[1])) as finish:
        finish()
    with writing(io.write, tmp_path / "new.su2", broken(meshes[1])):
        pass
    assert names(tmp_path) == ["there.su2"]


def broken(mesh):
    points = np.array(mesh.points)
    points[3] = np.nan
    return mesh.moved(points)
