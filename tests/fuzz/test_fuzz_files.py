"""Damaged files and attacked writers of every format, in processes of their own.

Damaged files: the right mesh, or a ValueError that names the file, in bounded time and memory. What the right mesh is, `damage.py`
says. `python tests/fuzz/damage.py FORMAT SEED K K+1 FOLDER` does number K again. Writers: whatever ends them, the file is the old
one or the new one, whole; a kill alone leaves more. They are killed, run into limits and full devices, and meet folders without
permission and each other. `python tests/fuzz/writers.py 50 0 SU2` attacks one format. Links: `test_files.py`.

JAXMORPH_FUZZ is the number of damaged files a format (100 by default; `.ci/nightly` takes 2,000), and sets that of kills (50 or
more). JAXMORPH_FUZZ_SEED makes another series of them.
"""

import collections
import json
import os
import pathlib
import signal
import subprocess
import sys

import pytest
from runs import over

HERE = pathlib.Path(__file__).parent
FUZZ, SEED = int(os.environ.get("JAXMORPH_FUZZ", "0")), os.environ.get("JAXMORPH_FUZZ_SEED", "0")
COUNT, KILLS = FUZZ or 100, max(50, FUZZ // 40)
FORMATS = (
    "SU2",
    "VTK",
    "gmsh",
    "Fluent",
    "CGNS",
    "ADF",
    "Exodus",
    "MFEM",
    "MED",
    "PLOT3D",
    "Abaqus",
    "I-deas",
    "Medit",
    "Medit's text",
    "AFLR",
    "XDMF",
    "OpenFOAM",
)
FORMATS += ("tables", "surfaces", "plans", "boxes", "fields")


def run(script: str, *words: object) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    words = [sys.executable, str(HERE / script), *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, env=environment, check=False)


def can_reset_peak() -> bool:
    """Whether the peak of a process's memory can be reset; some sandboxes have the file and refuse the write."""
    try:
        pathlib.Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


@pytest.mark.skipif(not can_reset_peak(), reason="memory is read as Linux tells it")
@over("name", slow=[name for name in FORMATS if name != "VTK"], nightly=["VTK"])
def test_damaged_files_are_read_right_or_refused(tmp_path, name):
    at, faults, rounds = 0, [], 0
    while at < COUNT:
        folder = tmp_path / str(rounds)
        folder.mkdir()
        done = run("damage.py", name, SEED, at, COUNT, folder)
        lines = done.stdout.splitlines()
        faults += [line for line in lines if line.startswith("{")]
        if done.returncode == 0:
            break
        begun = [int(line[3:]) for line in lines if line.startswith("at ")]
        assert begun, done.stderr[-2000:]
        how = signal.Signals(-done.returncode).name if done.returncode < 0 else done.stderr[-500:]
        faults.append(json.dumps({"mutation": begun[-1], "fault": f"the process ended: {how}"}))
        at, rounds = begun[-1] + 1, rounds + 1
    assert not faults, f"{len(faults)} of {COUNT}\n" + "\n".join(faults[:40])


@pytest.mark.nightly
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="processes are forked, /dev/full is written to"
)
def test_no_attack_breaks_what_is_written():
    done, told = run("writers.py", KILLS, SEED), collections.defaultdict(list)
    assert done.returncode == 0, done.stderr[-3000:]
    for line in done.stdout.splitlines():
        row = json.loads(line)
        told[row["format"]].append(row)
    assert len(told) > 20
    for name, rows in told.items():
        faults = [f"{row['attack']}: {row['fault']}" for row in rows if "fault" in row]
        assert not faults, f"{name}: {len(faults)} faults\n" + "\n".join(faults[:20])
        (row,) = (row for row in rows if "kills" in row)
        assert row["kills"] == KILLS, (
            f"{name}: {row['kills']} of {row['tries']} kills fell inside the writing"
        )
        assert row["halves"], f"{name}: no kill left a file behind that was half written"
