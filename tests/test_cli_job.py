"""Job files, and what machines and impatient people get from the command line."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from meshes import write_ring
from runs import printed, refused

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._plan import halves as _chunks
from jaxmorph.cli import _output, main
from jaxmorph.cli._entry import parser, request_of
from jaxmorph.cli._job import text_of


@pytest.fixture
def folder(tmp_path):
    write_ring(tmp_path / "ring.su2")
    (tmp_path / "shift.csv").write_text("".join(f"{k},0.125,-0.25\n" for k in range(24)))
    return tmp_path


JOB = """\
file = "ring.su2"
output = "from_job.su2"
fixed = ["far"]
method = "rbf"
steps = 2
max-aspect-ratio = 50

[[moving]]
patches = ["wall"]
rotate = -2.5e1
about = [0.5, -0.1]
mode = [["shift.csv", 0.5]]

[[moving]]
patches = ["wall"]
box = { low = [-2, -2], high = [2, 2], points = [2, 3], moved = [{ at = [1, 2], by = [0.1, 0] }] }
"""
BOX = (
    '{"low": [-2, -2], "high": [2, 2], "points": [2, 3], "moved": [{"at": [1, 2], "by": [0.1, 0]}]}'
)


@pytest.mark.nightly
def test_a_job_says_what_the_flags_say(here, capsys):
    (here / "job.toml").write_text(JOB)
    assert main(["deform", "--job", "job.toml"]) == 0
    flags = [
        "--moving",
        "wall",
        "--rotate",
        "-25",
        "--about",
        "0.5",
        "-0.1",
        "--mode",
        "shift.csv",
        "0.5",
    ]
    flags += ["--moving", "wall", "--box", BOX, "--fixed", "far", "--method", "rbf", "--steps", "2"]
    capsys.readouterr()
    flags += ["--max-aspect-ratio", "50", "--save-job", "saved.toml"]
    said = printed(capsys, ["deform", "ring.su2", "flags.su2", *flags])
    assert (here / "flags.su2").read_bytes() == (here / "from_job.su2").read_bytes()
    expected = tomllib.loads(JOB) | {"output": "flags.su2", "dtype": "float64"}
    expected["max_aspect_ratio"] = expected.pop("max-aspect-ratio")
    assert tomllib.loads((here / "saved.toml").read_text()) == expected
    (here / "flags.su2").unlink()
    again = printed(capsys, ["deform", "--job", "saved.toml"])
    assert (here / "flags.su2").read_bytes() == (here / "from_job.su2").read_bytes()
    assert again.split("wrote")[0] == said.split("job  ")[0]


def test_flags_beside_a_job_win(here):
    (here / "job.toml").write_text(JOB)
    assert (
        main(
            [
                "deform",
                "ring.su2",
                "other.su2",
                "--job",
                "job.toml",
                "--box",
                BOX.replace("0.1", "0.3"),
            ]
        )
        == 0
    )
    assert not (here / "from_job.su2").exists()
    assert main(["deform", "--job", "job.toml"]) == 0
    a, b = (np.asarray(io.read(here / name).points)[:24] for name in ("other.su2", "from_job.su2"))
    x = io.read("ring.su2").points[:24]
    turn = np.radians(-25)
    turned = (x + np.array([0.0625 - 0.5, -0.125 + 0.1])) @ np.array(
        [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    ) + np.array([0.5, -0.1])
    t = (turned + 2) / 4
    weight = t[:, :1] * t[:, 1:] ** 2  # the polynomials of control point (1, 2) of (2, 3)
    np.testing.assert_allclose(a - b, weight * [[0.2, 0]], atol=1e-13)


@pytest.mark.slow
def test_paths_in_a_job_are_relative_to_its_folder(here, monkeypatch):
    """From another folder the job reads and writes the same; one saved elsewhere names the files from there."""
    (here / "jobs").mkdir()
    text = JOB.replace('"ring.su2"', '"../ring.su2"').replace('"shift.csv"', '"../shift.csv"')
    (here / "jobs" / "job.toml").write_text(text)
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert main(["deform", "--job", "../jobs/job.toml", "--save-job", "../jobs/saved.toml"]) == 0
    assert not list((here / "elsewhere").iterdir())
    first = (here / "jobs" / "from_job.su2").read_bytes()
    (here / "jobs" / "from_job.su2").unlink()
    saved = tomllib.loads((here / "jobs" / "saved.toml").read_text())
    assert (saved["file"], saved["output"]) == ("../ring.su2", "from_job.su2")
    assert saved["moving"][0]["mode"] == [["../shift.csv", 0.5]]
    monkeypatch.chdir(here / "jobs")
    assert main(["deform", "--job", "saved.toml"]) == 0
    assert (here / "jobs" / "from_job.su2").read_bytes() == first


EVERY_FLAG = """
deform ring.su2 out.su2 --decomposed --picture p.png
  --displacement d.dat --displacement-is displacement --mode m.csv 0.5 --mode n.csv -2
  --moving wall far --onto t.stl --onto-scale 2 --onto-length 0.1 --onto-angle 40
  --onto-features [[[1,2],[3]]] --box b.toml
  --scale 2 3 --twist 1 --bend -2 --rotate 3 --translate 0 1e-3
  --about 1 2 --axis 0 1 --along 1 0 --length 4 --name first --moving wall --rotate 5 --box {"low":[0]}
  --fixed far a.* --symmetry s --sliding t --sliding u --periodic v w --free x --set first.rotate=2 y=1,2
  --method published --sources 7 --dtype float32 --steps 2 --chunk 8 --max-aspect-ratio 9 --max-non-orthogonality 70
  --max-skewness 0.9 --max-face-skewness 4 --max-face-aspect-ratio 8 --min-jacobian-ratio 0.1 --preset checkmesh
  --remesh --allow-inverted --no-dry-run --proven --zone 2 --tags facets.xdmf
"""


def test_every_flag_of_deform_stands_in_a_job(here):
    """A saved job is read into the request that it was made of; what a job cannot say is how to speak, and of jobs."""
    words = EVERY_FLAG.split()
    request = request_of(words)
    (here / "job.toml").write_text(text_of(request, here))
    again = request_of(["deform", "--job", "job.toml"])
    assert again == dataclasses.replace(request, job=again.job)
    assert again.groups[1].box == {"low": [0]}
    known = set(parser()[1]["deform"].flags)
    assert known - set(words) == {
        "--help",
        "--help-all",
        "--job",
        "--save-job",
        "--json",
        "--verbose",
    }


TEXT_OF_PATCH = "[[moving]]\npatches = ['wall']\n"
BAD_JOBS = [
    ("file = ring.su2", "job.toml: not TOML"),
    (
        "fille = 'ring.su2'",
        r"job.toml: a job has no fille; did you mean file\? It may have tags, file, output",
    ),
    (
        f"{TEXT_OF_PATCH}rotat = 1",
        r"job.toml: \[\[moving\]\] has no rotat; did you mean rotate\? It may have",
    ),
    ("[[moving]]\nrotate = 1", r"job.toml: a \[\[moving\]\] without patches"),
    ("moving = 'wall'", r"job.toml: moving is a list of tables: begin each with \[\[moving\]\]"),
    (
        "steps = true",
        "job.toml: argument --steps: a whole number of 1 or more expected, found 'True'",
    ),
    (
        "steps = 2.5",
        "job.toml: argument --steps: a whole number of 1 or more expected, found '2.5'",
    ),
    ("rotate = 5", r"job.toml: a job has no rotate: it belongs to .* below a \[\[moving\]\]"),
    ("output = 'out.su2'", "job.toml: file is missing: the mesh that the job moves"),
    (
        "method = ['rbf', 'other.su2']",
        r"job.toml: method is one value, found \['rbf', 'other.su2'\]",
    ),
    ("method = '--json'", "job.toml: argument --method: there is no --json; there are default"),
    ("dtype = 'float16'", "job.toml: argument --dtype: there is no float16; did you mean float"),
    ("set = 5", "job.toml: set is a table of names and numbers, found 5"),
    ("set = {a = 'x'}", "job.toml: argument --set: 'a=x' is not NAME=NUMBER"),
    (
        f"{TEXT_OF_PATCH}mode = 5",
        r'job.toml: mode is a list of files with .*, \[\["FILE", 0.1\], ...\], found 5',
    ),
    (
        f"{TEXT_OF_PATCH}mode = ['shift.csv', 1]",
        r"job.toml: mode is a list of .*, found \['shift.csv', 1\]",
    ),
    (f"steps = 1\nfixed = {5000 * '['}", "job.toml: fixed is nested too deep"),
    (
        f"{TEXT_OF_PATCH}rotate = {200 * '['}{200 * ']'}",
        r"job.toml: rotate is one value, found \[\[\[.{,50}$",
    ),
    (
        f"{TEXT_OF_PATCH}box = {{ low = {9000 * '['}{9000 * ']'} }}",
        "job.toml: box is nested too deep",
    ),
    (f"steps = {5000 * '1'}", "job.toml: not TOML"),
    (
        'file = "ring\\u0000.su2"\noutput = "out.su2"',
        r"IN 'ring\\x00.su2': a name of a file holds no null byte",
    ),
    ("allow_inverted = 1", "job.toml: allow_inverted is true or false, found 1"),
]


@pytest.mark.parametrize(("text", "message"), BAD_JOBS, ids=range(len(BAD_JOBS)))
def test_a_bad_job_is_answered_in_one_line(here, capsys, text, message):
    (here / "job.toml").write_text(text)
    refused(capsys, ["deform", "--job", "job.toml"], f"^jaxmorph deform: {message}")


MOVE = ["--moving", "wall", "--fixed", "far", "--translate", "0.2", "0"]


def test_running_out_of_memory_is_one_line(here, capsys, monkeypatch):
    def greedy(*_, **__):
        raise MemoryError

    monkeypatch.setattr(_chunks, "plan_of", greedy)
    told = r"^jaxmorph deform: out of memory; fewer --sources and --dtype float32 need less\.$"
    refused(capsys, ["deform", "ring.su2", "out.su2", *MOVE], told)
    assert not (here / "out.su2").exists()


def test_json_is_one_object_and_says_what_the_text_says(here, capsys):
    assert main(["deform", "ring.su2", "out.su2", *MOVE, "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    found = json.loads(said.out)
    mesh = io.read("ring.su2")
    report = jm.quality(mesh, io.read("out.su2").points)
    assert (found["status"], found["output"], found["points"], found["moving"]) == (
        0,
        "out.su2",
        216,
        {"wall": 24},
    )
    assert found["after"]["max_skewness"] == pytest.approx(float(report.max_skewness), rel=1e-12)
    assert found["after"]["worst_skewness"]["cell"] == int(np.argmax(report.skewness))
    assert found["largest"] == pytest.approx(0.2)
    assert {"reading ring.su2", "preparing", "writing out.su2"} <= set(found["stages"])
    found = json.loads(printed(capsys, ["info", "ring.su2", "--json"]))
    assert (found["cells"], found["patches"]) == ({"quad": 192}, {"wall": 24, "far": 24})
    assert main(["quality", "none.su2", "--json"]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["problems"] == ["none.su2: No such file or directory"]
    assert said.err.count("\n") == 1


@pytest.mark.nightly
def test_verbose_tells_the_time_of_each_stage(here, capsys):
    said = printed(capsys, ["deform", "ring.su2", "out.su2", *MOVE, "--verbose"])
    stages = (
        "reading ring.su2",
        "preparing",
        "deforming in 1 step",
        "judging the cells",
        "writing out.su2",
        "all",
    )
    assert all(f"\n  {stage} " in said for stage in stages)
    assert max(map(len, said.split("\n"))) <= 80


@pytest.mark.slow
def test_single_precision_moves_to_its_precision_and_the_wall_exactly(here):
    for dtype in ("float64", "float32"):
        assert (
            main(["deform", "ring.su2", f"{dtype}.su2", *MOVE, "--rotate", "10", "--dtype", dtype])
            == 0
        )
    double, single = (
        np.asarray(io.read(f"{dtype}.su2").points) for dtype in ("float64", "float32")
    )
    np.testing.assert_allclose(single, double, atol=1e-5)
    assert np.abs(single - double).max() > 1e-12
    np.testing.assert_allclose(single[:24], double[:24], atol=1e-15)


def test_time_left_is_told_where_it_is_known():
    stage = _output.Stage("deforming")
    stage.began = time.monotonic() - 10
    assert str(stage) == "deforming ... 10 s"
    stage.done(0.25)
    assert str(stage) == "deforming ... 10 s, 25%, 30 s left"


@pytest.mark.slow
def test_an_interrupt_leaves_no_half_written_file(here):
    """A signal while the file is being written, in a process of its own."""
    code = f"""
import os, pathlib, signal, sys
from jaxmorph.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
replace = pathlib.Path.replace
def interrupted(self, target):
    assert self.exists()
    os.kill(os.getpid(), signal.SIGINT)
    return replace(self, target)
pathlib.Path.replace = interrupted
sys.exit(main(["deform", "ring.su2", "out.su2", *{MOVE!r}, "--method", "graph"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr == "jaxmorph deform: interrupted; no file is half written.\n"
    assert done.returncode == 128 + signal.SIGINT
    left = {path.name for path in here.iterdir()} - {"ring.su2", "shift.csv"}
    assert left <= {
        "out.su2"
    }  # on one core nothing; beside the signal a thread gives the whole file its name
    if left:
        assert main(["deform", "ring.su2", "again.su2", *MOVE, "--method", "graph"]) == 0
        assert (here / "out.su2").read_bytes() == (here / "again.su2").read_bytes()


INTERRUPTED = """
import os, runpy, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["jaxmorph", "info", "ring.su2"]
runpy.run_module("jaxmorph", run_name="__main__", alter_sys=False)
"""


@pytest.mark.parametrize(
    "module", ["jax", pytest.param("jaxmorph.cli._inspect", marks=pytest.mark.slow)]
)
def test_an_interrupt_while_a_module_is_imported_is_one_line(here, module):
    code = INTERRUPTED.format(module=module)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert re.fullmatch(r"jaxmorph info: interrupted(; no file is half written)?\.\n", done.stderr)
    assert (done.returncode, done.stdout) == (128 + signal.SIGINT, "")


@pytest.mark.slow
def test_text_is_utf_8_under_any_locale(here):
    """A patch with other letters, in a process whose locale knows ASCII alone: files are read and written, the name is shown."""
    mesh = (here / "ring.su2").read_text(encoding="utf-8").replace("wall", "flügel")
    (here / "ring.su2").write_text(mesh, encoding="utf-8")
    (here / "job.toml").write_text(JOB.replace("wall", "flügel"), encoding="utf-8")
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [
        sys.executable,
        "-m",
        "jaxmorph",
        "deform",
        "--job",
        "job.toml",
        "--save-job",
        "saved.toml",
    ]
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"moving   fl\xfcgel: 24 nodes" in done.stdout
    assert "flügel" in (here / "from_job.su2").read_text(encoding="utf-8")
    assert 'patches = ["flügel"]' in (here / "saved.toml").read_text(encoding="utf-8")
