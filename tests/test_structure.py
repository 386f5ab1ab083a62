"""The structure of the code: imports point one way, and importing it leaves no trace."""

import ast
import collections
import dataclasses
import functools
import graphlib
import pathlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = ROOT / "jaxmorph"
FILES = sorted(PACKAGE.rglob("*.py"))
OPTIONAL = (
    *("meshio", "h5py", "matplotlib", "pyvista", "vtk", "vtkmodules", "gmsh"),
    *("platformdirs", "openmdao", "pyamg", "mphys", "mpi4py", "OCP"),
)

TOP = {
    *("jaxmorph", "tests", "notebooks", "docs", "benchmarks", "pyproject.toml"),
    *("README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"),
}
"""What may stand at the top level, beside names that begin with a dot."""

FLOORS = (
    ("_host", "_kernels"),
    ("_mesh", "_methods"),
    ("_boundary",),
    ("_plan", "_quality"),
    ("_improve",),
    ("_advice",),
    ("", "extend"),
    ("shapes",),
    ("io", "native", "plot", "cases", "integrations"),
    ("_demo",),
    ("cli",),
    ("__main__",),
)
"""Rooms by floor: each may import from the floors below it, and from itself. "" is the package."""

FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
NEIGHBOURS = {("cases", "io"), ("integrations", "io")}
"""Pairs of rooms on one floor of which the first may import the second."""


@dataclasses.dataclass(frozen=True)
class Import:
    """One imported name: the file that imports it, and the module that it comes from, both absolute."""

    importer: str
    module: str
    name: str | None

    @property
    def rooms(self) -> tuple[str, str]:
        return room(self.importer), room(self.module)


def room(module: str) -> str:
    """Names the room of a module: `jaxmorph._plan.prepare` stands in `_plan`."""
    return ".".join(module.split(".")[1:2])


def module_of(file: pathlib.Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def tree_of(file: pathlib.Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


@functools.cache
def imports(file: pathlib.Path, types: bool = True) -> list[Import]:
    """Lists what a file imports; without `types`, not what it imports for type checkers alone."""
    package = file.relative_to(ROOT).with_suffix("").parts[:-1]
    tree, listed, hidden = tree_of(file), [], set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.If)
            and ast.unparse(node.test).endswith("TYPE_CHECKING")
            and not types
        ):
            hidden |= {id(inner) for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            listed += [Import(module_of(file), alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = PACKAGE.parent / module.replace(".", "/") / alias.name
                is_module = inner.is_dir() or inner.with_suffix(".py").exists()
                listed.append(
                    Import(
                        module_of(file),
                        f"{module}.{alias.name}" if is_module else module,
                        alias.name,
                    )
                )
    return listed


def own_imports() -> list[Import]:
    return [
        each for file in FILES for each in imports(file) if each.module.split(".")[0] == "jaxmorph"
    ]


def imports_between_rooms() -> list[Import]:
    return [
        each
        for each in own_imports()
        if each.rooms[0] != each.rooms[1] and each.importer != "jaxmorph"
    ]


@pytest.mark.skipif(
    not (ROOT / ".git").exists() or shutil.which("git") is None, reason="no checkout of git"
)
def test_the_top_level_holds_what_it_is_meant_to():
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    top = {
        name.partition("/")[0] for name in listed.split("\0") if name and not name.startswith(".")
    }
    assert top == TOP


def test_every_room_has_a_floor():
    assert {room(module_of(file)) for file in FILES} <= set(FLOOR)


def test_imports_point_down():
    """No arrow up or across, so that no circle of rooms can be."""
    up = [each for each in imports_between_rooms() if FLOOR[each.rooms[1]] >= FLOOR[each.rooms[0]]]
    wrong = [each for each in up if each.rooms not in NEIGHBOURS]
    assert not wrong


OUTER = ("cases", "cli", "integrations", "plot", "shapes")
BORDER = {
    # TOML and mistyped names, and endings of files: told before NumPy and JAX are there
    ("cli", "_host.package.text"),
    ("cli", "io.kinds"),
    # names and sizes of a CGNS file's zones, by which IDWarp tells grids that overlap; a mesh has none
    ("integrations", "io.cgns.file"),
}
"""Rooms at the border, which import public names alone, and the private modules that one still imports."""


def test_outer_rooms_import_public_names_alone():
    outer = [
        each
        for each in imports_between_rooms()
        if each.rooms[0] in OUTER and each.rooms[1] != "_demo"
    ]
    inner = {(each.rooms[0], each.module.removeprefix("jaxmorph.")) for each in outer}
    assert {(importer, module) for importer, module in inner if is_private(module)} == BORDER


def is_private(module: str) -> bool:
    """Names of a room are imported from the room; `integrations` has modules for each other program."""
    return module.startswith("_") or ("." in module and not module.startswith("integrations."))


PROTOCOL = {"read": 17, "check": 8, "write": 3, "new": 3, "NAME": 16}
"""What modules of `io` define under one name, since each is a format, and how many of them do."""

SEVERAL = {
    "functions": "beside number prepare pullback read_sensitivity whole write_gradient",
    "constants": "",
}
"""Names with more than one home. None is added; one that has a single home by now is taken out."""


def defined(file: pathlib.Path) -> Iterator[tuple[str, str]]:
    """Yields kind and name, without underscores before it, of what a file defines by itself."""
    yield from (
        ("classes", node.name) for node in ast.walk(tree_of(file)) if isinstance(node, ast.ClassDef)
    )
    for node in tree_of(file).body:
        if isinstance(node, ast.FunctionDef) and node.name != "_":  # of `singledispatch`
            yield "functions", node.name.lstrip("_")
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            name = target.id.lstrip("_") if isinstance(target, ast.Name) else ""
            if name.isupper() and not ast.unparse(node).startswith("T = TypeVar("):
                yield "constants", name


def test_a_name_has_one_home():
    homes = collections.defaultdict(set)
    formats = collections.Counter()
    for file in FILES:
        for kind, name in defined(file):
            is_of_format = name in PROTOCOL and room(module_of(file)) == "io"
            formats[name] += is_of_format
            homes[kind, name].add("io" if is_of_format else file)
    assert +formats == PROTOCOL
    several = {kind: set() for kind in ("classes", *SEVERAL)}
    for (kind, name), files in homes.items():
        if len(files) > 1:
            several[kind].add(name)
    assert not several["classes"]
    for kind, names in SEVERAL.items():
        assert not several[kind] - {*names.split()}, kind


def test_no_room_uses_private_names_of_another():
    for each in imports_between_rooms():
        private = [
            name for name in (*each.module.split(".")[2:], each.name or "") if name.startswith("_")
        ]
        assert {*private} <= {*FLOOR}, each


def test_no_circle_of_files():
    graph: dict[str, set[str]] = {module_of(file): set() for file in FILES}
    for file in FILES:
        for each in imports(file, types=False):
            if each.module in graph and each.module != each.importer and each.module != "jaxmorph":
                graph[each.importer].add(each.module)
    graph["jaxmorph"] = set()
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


def test_the_host_knows_neither_jax_nor_the_rest():
    files = [file for file in FILES if room(module_of(file)) == "_host"]
    assert len(files) > 3
    for file in files:
        foreign = {
            each.module.split(".")[0] for each in imports(file) if room(each.module) != "_host"
        }
        assert not foreign & {
            "jaxmorph",
            "jax",
            "jaxlib",
            "equinox",
            "jaxtyping",
            "lineax",
            "optimistix",
        }, file


def test_the_driver_knows_no_method_but_the_abstract_one():
    """`prepare` also asks for the default one, and for the one that guides nodes along boundaries; `export` records any."""
    known = {each.module for each in own_imports() if each.rooms == ("_plan", "_methods")}
    assert known <= {
        f"jaxmorph._methods.{name}"
        for name in ("base", "blocks", "multiscale", "reconstruction", "surface", "tape")
    }


def test_nobody_outside_the_driver_unpacks_a_plan():
    halves = {"plan.surface", "plan.volume", "self.plan.surface", "self.plan.volume"}
    for file in FILES:
        if room(module_of(file)) != "_plan":
            nodes = ast.walk(tree_of(file))
            assert not halves & {
                ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)
            }, file


def test_options_of_jax_belong_to_the_user():
    for file in FILES:
        if room(module_of(file)) in ("cli", "__main__"):
            continue  # their own processes
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.Attribute) and node.attr == "update":
                assert not ast.unparse(node.value).endswith("config"), file


def test_trees_of_points_are_those_that_end_in_callbacks():
    for file in FILES:
        trees = [
            each
            for each in imports(file)
            if each.module.startswith("scipy")
            and (each.name in ("KDTree", "cKDTree", "spatial") or each.module == "scipy.spatial")
        ]
        trees = [
            each for each in trees if each.name not in ("ConvexHull", "Delaunay", "QhullError")
        ]
        assert len(trees) == (module_of(file) == "jaxmorph._host.package.rounding"), file


def test_no_test_imports_a_test():
    """What several need stands in `meshes`, `oracles`, `cases` and the writers of formats."""
    tests = [file for folder in ("tests", "benchmarks") for file in (ROOT / folder).rglob("*.py")]
    wrong = [
        file.name
        for file in tests
        if re.search(r"^\s*(from|import) test_", file.read_text(), re.MULTILINE)
    ]
    assert len(tests) > 100
    assert not wrong


LONGEST = 30
"""Words in a sentence of a docstring."""


def sentences(text: str) -> list[str]:
    """Lists the sentences of a docstring: no code, formulas or tables; each entry of a list is a paragraph."""
    text = re.sub(r"```.*?```|\$\$.*?\$\$|\\\[.*?\\\]", "\n\n", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "Code", text)
    lines = [
        "" if line.startswith((">>>", "...", "|")) else line
        for line in map(str.strip, text.split("\n"))
    ]
    lines = [f"\n\n{line}" if re.match(r"[-*+] |\d+\. ", line) else line for line in lines]
    found = []
    for paragraph in re.split(r"\n\s*\n", "\n".join(lines)):
        found += re.split(r"(?<=[.!?])[)\"']*\s+(?=[A-Z`(\"*])", " ".join(paragraph.split()))
    return found


def docstrings(file: pathlib.Path) -> list[ast.Constant]:
    """Lists the docstrings of a file, also those below constants."""
    nodes = [node.value for node in ast.walk(tree_of(file)) if isinstance(node, ast.Expr)]
    return [
        node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]


def test_sentences_of_docstrings_are_short():
    wrong = []
    for file in FILES:
        for node in docstrings(file):
            for sentence in sentences(node.value):
                count = sum(bool(re.search(r"[A-Za-z]", word)) for word in sentence.split())
                if count > LONGEST:
                    wrong.append(
                        f"{file.relative_to(ROOT)}:{node.lineno}: {count} words: {sentence}"
                    )
    assert not wrong, "\n".join(wrong)


def test_prose_is_narrow():
    """Lines of docstrings and comments have at most 100 characters; lines of code may have more."""
    wide = []
    for file in FILES:
        lines = file.read_text(encoding="utf-8").splitlines()
        prose = {at for at, line in enumerate(lines, start=1) if line.lstrip().startswith("#")}
        for node in docstrings(file):
            prose |= set(range(node.lineno, node.end_lineno + 1))
        wide += [
            f"{file.relative_to(ROOT)}:{at}" for at in sorted(prose) if len(lines[at - 1]) > 100
        ]
    assert not wide, "\n".join(wide)


def run_silently(code: str) -> None:
    """Runs code in a process of its own, which prints nothing and does not fail."""
    words = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
def test_importing_leaves_no_trace():
    """Nothing printed or warned of, no option changed, no optional package, no array made, no logger; JAX where it is used."""
    code = f"""
import sys
import jaxmorph.cli
from jaxmorph.cli import _entry
assert not {{"jax", "numpy", "scipy"}} & set(sys.modules)
import jax, logging
before = dict(jax.config.values)
jaxmorph.prepare
changed = {{key for key, value in jax.config.values.items() if before.get(key) != value}}
assert not changed, changed
assert not jax.config.jax_enable_x64
loaded = set(sys.modules) & set({OPTIONAL!r})
assert not loaded, loaded
assert not [name for name in logging.root.manager.loggerDict if name.startswith("jaxmorph")]
assert not jax.live_arrays()
from jaxmorph import Mesh, io
assert jaxmorph.prepare and jaxmorph.shapes.rotate and io.read and "jax" in sys.modules
assert {{"prepare", "io", "__version__"}} <= set(dir(jaxmorph))
star = {{}}
exec("from jaxmorph import *", star)
assert {{"prepare", "Mesh", "shapes"}} <= set(star)
try:
    jaxmorph.nothing
except AttributeError as error:
    assert str(error) == "module 'jaxmorph' has no attribute 'nothing'"
else:
    raise AssertionError
"""
    run_silently(code)


def test_completion_offers_public_names_alone():
    import jaxmorph as jm

    for room in (jm, jm.io, jm.shapes, jm.cases, jm.integrations, jm.extend):
        private = [name for name in dir(room) if name.startswith("_")]
        assert set(private) <= {"__version__"}, room
    folder = pathlib.Path(jm.integrations.__path__[0])
    modules = {path.stem for path in folder.iterdir() if not path.name.startswith("_")}
    assert set(dir(jm.integrations)) == modules


def test_every_public_name_is_documented():
    import jaxmorph as jm

    public = [name for name in dir(jm) if not name.startswith("_")]
    assert {"prepare", "deform", "Mesh", "RBF"} <= set(public)
    for name in public:
        assert getattr(jm, name).__doc__, name
