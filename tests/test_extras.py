"""The core stands alone, and each extra that is missing is named with its remedy."""

import pathlib
import re
import subprocess
import sys
import tomllib

import pytest
from meshes import bricks

import jaxmorph
from jaxmorph import io, shapes

CODE = """
import sys
missing = ("meshio", "h5py", "matplotlib", "pyvista", "vtkmodules", "gmsh", "platformdirs", "openmdao", "OCP")
sys.modules.update(dict.fromkeys((*missing, "openmdao.api", "mphys.core", "mpi4py")))
import importlib, pathlib, numpy, jaxmorph
from jaxmorph import cases, io, shapes
mesh = cases.naca0015(points=300)
plan = jaxmorph.prepare(mesh.points.astype("f4"), mesh.patch("airfoil"), mesh.patch("farfield"), method=jaxmorph.DelaunayGraph())
assert numpy.isfinite(plan.points).all()
io.write("a.su2", mesh)
assert io.read("a.su2").points.shape == mesh.points.shape
io.write("a.msh", mesh)
assert io.read("a.msh").points.shape == mesh.points.shape
corners = numpy.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
cell = numpy.array([[0, 1, 3, 2, 4, 5, 7, 6]])
bricks = jaxmorph.Mesh(corners, {"hexahedron": cell}, {"outer": numpy.arange(8)})
for name in ("a.vtu", "a.cgns", "a.step"):
    pathlib.Path(name).write_text("")
calls = {
    "vtu": lambda: io.write("b.vtu", mesh),
    "cgns": lambda: io.read("a.cgns"),
    "step": lambda: io.read_facets("a.step"),
    "cad": lambda: shapes.CAD(lambda x: None, [1.0], bricks, "outer"),
    "meshio": mesh.to_meshio,
    "pyvista": mesh.to_pyvista,
    "plot": lambda: importlib.import_module("jaxmorph.plot"),
    "openmdao": lambda: importlib.import_module("jaxmorph.integrations.openmdao"),
    "mphys": lambda: importlib.import_module("jaxmorph.integrations.mphys"),
    "mpi": lambda: importlib.import_module("jaxmorph.integrations.mpi"),
    "idwarp": lambda: importlib.import_module("jaxmorph.integrations.idwarp"),
}
for name, call in calls.items():
    try:
        call()
    except ImportError as error:
        print(name, error)
"""


@pytest.mark.slow
def test_each_missing_extra_is_named(tmp_path):
    root = str(pathlib.Path(jaxmorph.__file__).parents[1])
    code = f"import sys; sys.path.insert(0, {root!r})\n{CODE}"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    remedies = dict(
        re.match(r"(\w+) .*pip install 'jaxmorph\[(\w+)\]'", line).groups()
        for line in done.stdout.splitlines()
    )
    assert remedies == {
        "vtu": "io", "cgns": "io", "meshio": "io", "pyvista": "plot", "plot": "plot",
        "step": "cad", "cad": "cad", "openmdao": "openmdao", "mphys": "mphys", "mpi": "mpi", "idwarp": "mpi",
    }  # fmt: skip
    project = tomllib.loads((pathlib.Path(root) / "pyproject.toml").read_text())["project"]
    assert set(remedies.values()) <= set(project["optional-dependencies"])


def test_types_ship():
    assert (pathlib.Path(jaxmorph.__file__).parent / "py.typed").is_file()


def test_a_cad_model_names_its_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "OCP.Bnd", None)
    for name in ("cad", "cad_kernel"):
        monkeypatch.delitem(sys.modules, f"jaxmorph._host.surface.{name}", raising=False)
    (tmp_path / "a.step").write_text("")
    with pytest.raises(ImportError, match=r"pip install 'jaxmorph\[cad\]'"):
        io.read_facets(tmp_path / "a.step")
    with pytest.raises(ImportError, match=r"pip install 'jaxmorph\[cad\]'"):
        shapes.CAD(lambda x: None, [1.0], bricks(1), "floor")
