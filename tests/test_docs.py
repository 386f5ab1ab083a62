"""The documentation: its code runs and prints what it says, its parts from elsewhere are there, its reference is complete."""

import ast
import importlib
import os
import pathlib
import re
import runpy
import subprocess
import sys
import types

import foam
import jax
import pytest
from documents import ROOT, blocks, blocks_and_output
from memory import drop_compiled
from runs import over

import jaxmorph as jm
from jaxmorph.cli._requests import COMMANDS

PAGES = ROOT / "docs" / "pages"
WITH_CODE = sorted(
    str(page.relative_to(ROOT)) for page in PAGES.rglob("*.md") if "```python" in page.read_text()
)
LONG = [page for page in WITH_CODE if pathlib.Path(page).stem not in ("openmdao", "mach", "jax")]
EXAMPLES = sorted(path.stem for path in (ROOT / "docs" / "examples").glob("*.py"))
NEEDED = {"remeshing": "gmsh", "formats": "vtk", "pictures": "pyvista"}
"""Packages without which an example is left out."""
NUMBER = r"(?<![\w.])[+-]?\d+\.?\d*(?:e[+-]?\d+)?"


@over(
    "page",
    slow=[page for page in WITH_CODE if page not in LONG],
    nightly=LONG,
    ids=lambda page: pathlib.Path(page).stem,
)
def test_code_runs_and_prints_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for code, output in blocks_and_output(page):
        for package in ("openmdao", "mpi4py", "skfem", "ngsolve", "OCP", "gmsh"):
            if package in code:
                pytest.importorskip(package)
        with jax.numpy_rank_promotion("allow"):  # as users have it
            exec(code, names)
        drop_compiled()
        said = capsys.readouterr().out
        if output is not None:
            assert re.sub(NUMBER, "#", said).split() == re.sub(NUMBER, "#", output).split()
            numbers = [
                [float(number) for number in re.findall(NUMBER, text)] for text in (said, output)
            ]
            assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=1e-6)  # below: rounding


@over(
    "name",
    slow=["judge", "pysu2_driver"],
    nightly=[name for name in EXAMPLES if name not in ("judge", "pysu2_driver", "tesseract_api")],
)
def test_examples_run(name, tmp_path, monkeypatch):
    """Each of docs/examples but that of Tesseract, which has tests of its own."""
    monkeypatch.chdir(tmp_path)
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    if name == "openfoam_case":
        foam.need_openfoam()
        monkeypatch.setenv("WM_PROJECT_DIR", foam.ENVIRONMENT["WM_PROJECT_DIR"])
        monkeypatch.setenv("FOAM_TUTORIALS", str(foam.EXAMPLES))
    monkeypatch.syspath_prepend(ROOT)
    with jax.numpy_rank_promotion("allow"):
        runpy.run_path(str(ROOT / "docs" / "examples" / f"{name}.py"), run_name="__main__")
    drop_compiled()


def test_every_public_name_is_in_an_example():
    """In a page's code or in docs/examples, which the tests run."""
    pages = [ROOT / "README.md", *PAGES.rglob("*.md")]
    code = [text for page in pages for text in blocks(str(page.relative_to(ROOT)))]
    code += [path.read_text() for path in (ROOT / "docs" / "examples").glob("*.py")]
    words = set(re.findall(r"\w+", "\n".join(code)))
    for name in ("jaxmorph", "shapes", "io", "plot", "cases", "extend"):
        module = jm if name == "jaxmorph" else importlib.import_module(f"jaxmorph.{name}")
        public = [key for key in dir(module) if callable(getattr(module, key)) and key[0] != "_"]
        own = [key for key in public if getattr(module, key).__module__.startswith("jaxmorph")]
        assert own
        assert not sorted(set(own) - words), name


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["SU2", "OpenFOAM"])
def test_what_one_types_first_prints_what_the_page_says(tool, tmp_path):
    """Each line of the page is printed, in this order; times differ, and numbers little."""
    page = (PAGES / f"{tool.lower()}.md").read_text()
    text = page.partition("\n## First commands\n")[2].partition("\n## ")[0]
    commands = re.findall(r"```sh\n(.*?)```\n\n```text\n(.*?)```", text, flags=re.DOTALL)
    assert commands
    environment = dict(os.environ)
    if tool == "OpenFOAM":
        foam.need_openfoam()
        environment = foam.ENVIRONMENT | {"FOAM_TUTORIALS": str(foam.EXAMPLES)}
    own = 'jaxmorph() { "$PYTHON" -m jaxmorph "$@"; }; python() { "$PYTHON" "$@"; }\n'
    environment |= {"PYTHON": sys.executable, "PYTHONPATH": str(ROOT)}
    for typed, seen in commands:
        arguments = ["bash", "-ec", own + typed]
        said = subprocess.run(
            arguments, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        left = iter([re.sub(r" \(\S+ s\)$", "", line).split() for line in said.stdout.splitlines()])
        for line in seen.splitlines():
            words = re.sub(r" \(\S+ s\)$", "", line).split()
            if words != ["..."]:
                assert any(alike(words, each) for each in left), f"{line}\n\n{said.stdout}"


def alike(words, others):
    """Tells whether two lines have the same words, and numbers within a hundredth."""
    if re.sub(NUMBER, "#", " ".join(words)) != re.sub(NUMBER, "#", " ".join(others)):
        return False
    numbers = [
        [float(number) for number in re.findall(NUMBER, " ".join(line))] for line in (words, others)
    ]
    return numbers[0] == pytest.approx(numbers[1], rel=0.01)


@pytest.mark.parametrize("name", ["jaxmorph", "shapes", "io", "plot", "cases", "extend"])
def test_the_reference_names_all_that_is_public(name):
    page = "\n".join(page.read_text() for page in sorted((PAGES / "reference").glob("*.md")))
    module = jm if name == "jaxmorph" else importlib.import_module(f"jaxmorph.{name}")
    assert (
        module.__all__ if hasattr(module, "__all__") else module
    )  # names are loaded when they are first used
    names = [key for key in dir(module) if not key.startswith("_")]
    public = {
        key: getattr(module, key)
        for key in names
        if not isinstance(getattr(module, key), types.ModuleType)
    }
    functions = [
        key
        for key, value in public.items()
        if callable(value) and value.__module__.startswith("jaxmorph")
    ]
    assert sorted(
        re.findall(rf"^::: {module.__name__}\.(\w+)$", page, flags=re.MULTILINE)
    ) == sorted(functions)
    for constant in set(public) - set(functions):
        assert f"`{name}.{constant}`" in page


def test_links_of_pages_lead_to_files():
    """On a code host as well as on the site: each relative link is a file of the project."""
    documents = [
        "README.md",
        "CONTRIBUTING.md",
        "benchmarks/README.md",
        *(ROOT / "docs" / "pages").rglob("*.md"),
    ]
    for document in documents:
        file = ROOT / document
        for address in re.findall(r"\[[^\]]*\]\(([^)\s]+)\)", file.read_text()):
            path = address.partition("#")[0]
            if path and not re.match(r"\w+:", address):
                assert (file.parent / path).exists(), f"{document}: {address}"


def test_pages_are_narrow():
    """Prose of at most 100 characters a line, tables of at most 120 and six columns."""
    wide = []
    for page in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "benchmarks" / "README.md",
        *PAGES.glob("*.md"),
    ):
        text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        for line in text.splitlines():
            is_row = line.startswith("|")
            if not line.startswith("![") and (
                len(line) > (120 if is_row else 100) or (is_row and line.count("|") > 7)
            ):
                wide.append(f"{page.name}: {line[:70]}")
    assert not wide, "\n".join(wide)


def test_tables_of_figures_have_a_script_and_a_tolerance(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    tables = importlib.import_module("benchmarks.tables")
    marks = [
        name
        for page in PAGES.glob("*.md")
        for name in re.findall(r"<!-- table (.*) -->", page.read_text())
    ]
    assert sorted(marks) == sorted(tables.TABLES)
    for name, place in tables.TABLES.items():
        module, _, function = place.partition(".")
        (page,) = [
            page for page in PAGES.glob("*.md") if tables.marked(name).search(page.read_text())
        ]
        assert f"def {function}(" in (ROOT / "benchmarks" / f"{module}.py").read_text(), page
    same = [
        ("0, 0.412", "0, 0.414"),
        ("134", "136"),
        ("1.55 / 7.42", "1.57 / 7.50"),
        ("180+", "180+"),
    ]
    moved = [
        ("0, 0.412", "1, 0.412"),
        ("0.016", "-0.003"),
        ("0.412", "0.430"),
        ("180+", "180"),
        ("all, 0.5", "38 %"),
    ]
    assert not any(tables.has_moved(*cells) for cells in same)
    assert all(tables.has_moved(*cells) for cells in moved)


def test_each_command_has_a_row():
    rows = (PAGES / "commands.md").read_text()
    for name in COMMANDS:
        assert f"\n| `jaxmorph {name}` |" in rows


def messages() -> list[str]:
    """All strings of the package; what is put into them is three dots."""
    found = []
    for file in (ROOT / "jaxmorph").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = [getattr(part, "value", None) for part in node.values]
                found.append("".join(part if isinstance(part, str) else "..." for part in parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return [" ".join(text.split()) for text in found]


def test_messages_of_the_page_are_those_of_the_program():
    quoted = re.findall(r"^> (.*)$", (PAGES / "faq.md").read_text(), re.MULTILINE)
    assert len(quoted) > 10
    said = messages()
    for message in quoted:
        words = [re.escape(part.strip()) for part in message.split("...") if part.strip()]
        pattern = re.compile(".*".join(words))
        assert any(map(pattern.search, said)), message
