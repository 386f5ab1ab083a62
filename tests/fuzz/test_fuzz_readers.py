"""Damaged files of every format: the right mesh, or a ValueError that names the file, in bounded time and memory.

What the right mesh is after one damaged byte, `damage.py` says.

JAXMORPH_FUZZ is the number of damaged files a format (100 by default; `.ci/nightly` takes 2,000), JAXMORPH_FUZZ_SEED another
series of them. `python tests/fuzz/damage.py FORMAT SEED K K+1 FOLDER` does number K again.
"""

import json
import os
import pathlib
import signal
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent
COUNT, SEED = int(os.environ.get("JAXMORPH_FUZZ", "100")), int(os.environ.get("JAXMORPH_FUZZ_SEED", "0"))
FORMATS = ("SU2", "VTK", "gmsh", "Fluent", "CGNS", "ADF", "Exodus", "MFEM", "MED", "PLOT3D", "OpenFOAM")
FORMATS += ("tables", "surfaces", "plans", "boxes", "fields")


def can_reset_peak() -> bool:
    """Whether the peak of a process's memory can be reset; some sandboxes have the file and refuse the write."""
    try:
        pathlib.Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


pytestmark = [pytest.mark.slow, pytest.mark.skipif(not can_reset_peak(), reason="memory is read as Linux tells it")]


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_read_right_or_refused(tmp_path, name):
    at, faults, rounds = 0, [], 0
    while at < COUNT:
        folder = tmp_path / str(rounds)
        folder.mkdir()
        words = [sys.executable, str(HERE / "damage.py"), name, str(SEED), str(at), str(COUNT), str(folder)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
        done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
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
