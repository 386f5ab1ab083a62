"""How the code hangs together: imports point one way, and importing it leaves no trace."""

import ast
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = ROOT / "jaxmorph"
FILES = sorted(PACKAGE.rglob("*.py"))
OPTIONAL = ("meshio", "h5py", "matplotlib", "pyvista", "vtk", "k3d", "gmsh", "rich", "platformdirs", "openmdao")
OUTER = ("io", "plot", "cases", "cli", "integrations", "_demo", "__main__")
"""What stands on the public names, and is imported by no part of the core."""


def imports(file):
    """(module, name) of each import in a file, the module absolute; (module, None) for a plain import."""
    package = file.relative_to(ROOT).with_suffix("").parts[:-1]
    found = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found += [(module, alias.name) for alias in node.names]
    return found


def own(file):
    """The parts of the package that a file imports, by their path inside it: `_host.graph`, `_plan`; '' is the package itself."""
    found = set()
    for module, name in imports(file):
        if module == "jaxmorph":
            found.add(name if name and ((PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").exists()) else "")
        elif module.startswith("jaxmorph."):
            found.add(module.removeprefix("jaxmorph."))
    return found


def part(file):
    return file.relative_to(PACKAGE).with_suffix("").parts[0]


def named(file):
    return str(file.relative_to(PACKAGE))


CORE = [file for file in FILES if part(file) not in OUTER and part(file) != "__init__"]


def test_the_host_knows_neither_jax_nor_the_rest():
    files = [file for file in FILES if part(file) == "_host"]
    assert len(files) > 3
    for file in files:
        assert all(name.startswith("_host") for name in own(file)), named(file)
        foreign = {module.split(".")[0] for module, _ in imports(file)} - {"jaxmorph"}
        assert not foreign & {"jax", "jaxlib", "equinox", "jaxtyping", "lineax", "optimistix"}, named(file)


@pytest.mark.parametrize("file", CORE, ids=named)
def test_imports_point_one_way(file):
    """The lower a part stands, the fewer others it may know."""
    rank = {"_host": 0, "_methods": 1, "_plan": 2, "_prepare": 3, "_steps": 4}
    mine = rank.get(part(file))
    used = own(file)
    assert "" not in used, "the core imports the files it needs, not the package"
    assert not {name.split(".")[0] for name in used} & set(OUTER)
    if mine is not None:
        higher = {name for name in used if rank.get(name.split(".")[0], 0) > mine}
        assert not higher


def test_the_driver_knows_no_method_but_the_abstract_one():
    """What a method is, and the sparse operator that several are made of; `prepare` also asks for the default one."""
    allowed = {"_methods.base", "_methods.sparse"}
    assert {name for name in own(PACKAGE / "_plan.py") if name.startswith("_methods")} <= allowed
    assert {name for name in own(PACKAGE / "_prepare.py") if name.startswith("_methods")} <= allowed | {"_methods"}


@pytest.mark.parametrize("file", [file for file in FILES if part(file) in OUTER], ids=named)
def test_the_outer_parts_use_public_names(file):
    """Through `import jaxmorph as jm`, or other outer parts; of the core's files only cell types and files that appear whole."""
    private = {name for name in own(file) if name.split(".")[0].startswith("_") and name.split(".")[0] not in OUTER}
    assert private <= {"_host.topology", "_host.files"}


@pytest.mark.parametrize("file", FILES, ids=named)
def test_files_are_small_and_set_nothing(file):
    text = file.read_text()
    assert len(text.splitlines()) <= 250
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            documented = ast.get_docstring(node) is not None
            start = node.body[0].end_lineno if documented else node.lineno
            assert node.end_lineno - start <= 40, node.name
        if isinstance(node, ast.Attribute) and node.attr == "update":
            # distributed.py sets the options of processes that it starts itself
            own_process = part(file) in ("cli", "__main__") or file.name == "distributed.py"
            sets_config = ast.unparse(node.value).endswith("config") and not own_process
            assert not sets_config, "options of JAX belong to the user"


def test_importing_leaves_no_trace():
    """Nothing printed, nothing warned of, no option changed, no optional package, no array made, no logger."""
    code = f"""
import jax, logging, sys
before = dict(jax.config.values)
import jaxmorph
changed = {{key for key, value in jax.config.values.items() if before.get(key) != value}}
assert not changed, changed
assert not jax.config.jax_enable_x64
loaded = set(sys.modules) & set({OPTIONAL!r})
assert not loaded, loaded
assert not [name for name in logging.root.manager.loggerDict if name.startswith("jaxmorph")]
assert not jax.live_arrays()
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_every_public_name_is_documented():
    import jaxmorph as jm

    public = [name for name in dir(jm) if not name.startswith("_")]
    assert {
        "prepare",
        "deform",
        "pullback",
        "refit",
        "march",
        "replay",
        "save",
        "load",
        "Plan",
        "Mesh",
        "Plane",
        "RBF",
        "KDTree",
    } <= set(public)
    for name in public:
        assert getattr(jm, name).__doc__, name
