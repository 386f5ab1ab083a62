"""The championship's door for other tools: the script of the benchmarks' page moves a case by its file alone, and its points are judged."""

import importlib
import pathlib
import re
import sys

import numpy as np
import pytest

import jaxmorph as jm

ROOT = pathlib.Path(__file__).parents[1]


@pytest.fixture
def championship(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    before = set(sys.modules)
    yield importlib.import_module("championship")
    for name in set(sys.modules) - before:
        if "benchmarks" in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.slow
def test_a_tool_enters_by_a_file_of_moved_points(championship, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arena = importlib.import_module("_arena")
    case = arena.brick("hexahedron", {"dent": arena.dent})
    championship.write(tmp_path / "given", case)
    page = (ROOT / "benchmarks" / "README.md").read_text()
    (code,) = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    exec(code, {})
    (row,) = championship.entered("splines", tmp_path / "moved", case)
    (file,) = (tmp_path / "moved").glob("*/*.npz")
    report = jm.quality(case.mesh, np.load(file)["points"])
    assert (row["case"], row["motion"], row["method"], row["error"]) == (
        case.name,
        "dent",
        "splines",
        None,
    )
    assert row["inverted"] == 0
    assert row["max_skewness"] == pytest.approx(float(report.max_skewness))
    assert set(championship.NUMBERS) < set(row)
    np.savez(file, points=case.mesh.points)
    (row,) = championship.entered("still", tmp_path / "moved", case)
    assert row["inverted"] is None
    assert row["error"] == "the wall misses its motion by 1 of it"
