"""The documentation: its code runs and prints what it says, its parts from elsewhere are there, its reference is complete."""

import pathlib
import re
import types

import pytest
from documents import ROOT, blocks_and_output

import jaxmorph as jm

PAGES = ROOT / "docs" / "pages"
WITH_CODE = sorted(str(page.relative_to(ROOT)) for page in PAGES.rglob("*.md") if "```python" in page.read_text())
NUMBER = r"(?<![\w.])[+-]?\d+\.?\d*(?:e[+-]?\d+)?"


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: pathlib.Path(page).stem)
def test_code_runs_and_prints_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for code, output in blocks_and_output(page):
        exec(code, names)
        said = capsys.readouterr().out
        if output is not None:
            assert re.sub(NUMBER, "#", said).split() == re.sub(NUMBER, "#", output).split()
            numbers = [[float(number) for number in re.findall(NUMBER, text)] for text in (said, output)]
            assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=1e-6)  # below: rounding


def test_the_reference_names_all_that_is_public():
    reference = re.findall(r"\{\{ api (.*) \}\}", (PAGES / "reference" / "jaxmorph.md").read_text())
    named = [name for names in reference for name in names.split()]
    public = [
        name for name, value in vars(jm).items() if not name.startswith("_") and not isinstance(value, types.ModuleType)
    ]
    assert sorted(named) == sorted(public)
    for module in ("shapes", "io", "plot", "cases"):
        assert f"{{{{ api {module} }}}}" in (PAGES / "reference" / f"{module}.md").read_text()
