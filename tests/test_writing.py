"""Files that appear where they are wanted, and leave nothing where they are not."""

import foam
import numpy as np
import pytest
from meshes import ring

from jaxmorph import io
from jaxmorph._host.package.files import UnwantedError
from jaxmorph.extend import appearing_if


def names(folder):
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.parametrize("is_wanted", [True, False])
@pytest.mark.parametrize("name", ["there.su2", "new.su2"])
def test_a_file_appears_when_it_is_wanted(tmp_path, name, is_wanted):
    mesh = ring()
    moved = mesh.moved(np.asarray(mesh.points) * 1.1)
    io.write(tmp_path / "there.su2", mesh)
    before = (tmp_path / "there.su2").read_bytes()
    with appearing_if(lambda: is_wanted):
        if is_wanted:
            io.write(tmp_path / name, moved)
            np.testing.assert_array_equal(io.read(tmp_path / name).points, moved.points)
        else:
            with pytest.raises(UnwantedError):
                io.write(tmp_path / name, moved)
            assert (tmp_path / "there.su2").read_bytes() == before
    assert names(tmp_path) == sorted({"there.su2", name} if is_wanted else {"there.su2"})


def test_an_unwanted_time_of_a_case_leaves_the_case_as_it_is(tmp_path):
    case = tmp_path / "case"
    foam.write_case(case, *foam.mixed()[:2], [("all", "patch", lambda nodes: True)])
    (case / "1" / "polyMesh").mkdir(parents=True)
    (case / "1" / "polyMesh" / "points.gz").write_bytes(b"of another run")
    before, mesh = names(case), io.read(case)
    for time in ("1", "2"):
        with pytest.raises(UnwantedError), appearing_if(lambda: False):
            io.write(case / time, mesh.moved(np.asarray(mesh.points) * 1.1))
    assert names(case) == before
