"""Writers under attack: whatever ends them, the file is the old one or the new one, whole; a kill alone leaves more.

They are killed, run into limits and full devices, and meet folders without permission and each other. Links: `test_files.py`.
JAXMORPH_FUZZ sets the number of kills a format, 50 by default and in `.ci/nightly`, JAXMORPH_FUZZ_SEED their moments.
`python tests/fuzz/writers.py 50 0 SU2` attacks one format.
"""

import collections
import json
import os
import pathlib
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent
KILLS = max(50, int(os.environ.get("JAXMORPH_FUZZ", "0")) // 40)
SEED = os.environ.get("JAXMORPH_FUZZ_SEED", "0")
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are forked, /dev/full is written to"),
]


@pytest.fixture(scope="module")
def told():
    """What one process tells of all formats: rows by format."""
    words = [sys.executable, str(HERE / "writers.py"), str(KILLS), SEED]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    rows = collections.defaultdict(list)
    for line in done.stdout.splitlines():
        row = json.loads(line)
        rows[row["format"]].append(row)
    return rows


def test_no_attack_breaks_what_is_written(told):
    assert len(told) > 20
    for name, rows in told.items():
        faults = [f"{row['attack']}: {row['fault']}" for row in rows if "fault" in row]
        assert not faults, f"{name}: {len(faults)} faults\n" + "\n".join(faults[:20])
        (row,) = (row for row in rows if "kills" in row)
        assert row["kills"] == KILLS, f"{name}: {row['kills']} of {row['tries']} kills fell inside the writing"
        assert row["halves"], f"{name}: no kill left a file behind that was half written"
