"""Time of `jmplan.h` over `jm.deform` and `jm.pullback` on one core, its size, and how far both differ.

taskset -c 0 python benchmarks/native.py [compiler flags: -O3]
"""

import ctypes
import pathlib
import subprocess
import sys
import tempfile
import time

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, native

CASES = {
    "2-D, 50,000 points": lambda: jm.prepare(cases.naca0015(points=50000), "airfoil", "farfield"),
    "wing, 27,000 points": lambda: jm.prepare(
        cases.wing(), "wing", "farfield", free=("root", "tip")
    ),
    "wing, fixed ends": lambda: jm.prepare(cases.wing(), "wing", ["farfield", "root", "tip"]),
}


def least(function, repeats: int = 9) -> float:
    """CPU time in ms of the fastest of several calls."""
    function()
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        taken.append(time.process_time() - start)
    return 1e3 * min(taken)


def library(folder: pathlib.Path, flags: list[str]) -> ctypes.CDLL:
    source, target = folder / "plan.c", folder / "plan.so"
    source.write_text('#define JMPLAN_IMPLEMENTATION\n#include "jmplan.h"\n')
    subprocess.run(
        ["cc", *flags, "-fPIC", "-shared", f"-I{native.folder}", source, "-o", target, "-lm"],
        check=True,
    )
    loaded = ctypes.CDLL(str(target))
    loaded.jm_open.restype, loaded.jm_error.restype = ctypes.c_void_p, ctypes.c_char_p
    return loaded


def row(c: ctypes.CDLL, name: str, plan: jm.Plan, file: pathlib.Path) -> str:
    jm.export(plan, file)
    opened = ctypes.c_void_p(c.jm_open(str(file).encode()))
    assert c.jm_error(opened) is None
    wall, base = np.asarray(plan.moving_points), np.asarray(plan.points)
    u = 0.05 * np.ptp(wall) * np.sin(3 * wall / np.ptp(wall))
    bar = np.random.default_rng(0).normal(size=base.shape)
    points, back = np.empty_like(base), np.empty_like(u)
    given = [ctypes.c_void_p(array.ctypes.data) for array in (u, points, bar, back)]
    ours = (
        least(lambda: c.jm_deform(opened, *given[:2])),
        least(lambda: c.jm_pullback(opened, *given[2:])),
    )
    jax_ = (
        least(lambda: jm.deform(plan, u).block_until_ready()),
        least(lambda: jm.pullback(plan, u, bar).block_until_ready()),
    )
    moved, wanted = np.asarray(jm.deform(plan, u)), np.asarray(jm.pullback(plan, u, bar))
    nodes = np.append(np.asarray(plan.moving), np.asarray(plan.fixed))
    c.jm_close(opened)
    times = "".join(f"{a:8.1f} / {b:<5.1f} {a / b:.2f}" for a, b in zip(ours, jax_, strict=True))
    walls = "equal" if np.array_equal(points[nodes], moved[nodes]) else "differ"
    return (
        f"{name:20} {file.stat().st_size / 1e6:6.1f}{times} {np.abs(points - moved).max() / np.ptp(moved):9.1e} {walls:>6} "
        f"{np.abs(back - wanted).max() / np.abs(wanted).max():9.1e}"
    )


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    folder = pathlib.Path(tempfile.mkdtemp())
    c = library(folder, sys.argv[1:] or ["-O3"])
    print(
        f"{'':20} {'MB':>6}{'deform, ms':>21}{'pullback, ms':>21} {'points':>9} {'walls':>6} {'pullback':>9}"
    )
    for name, make in CASES.items():
        print(row(c, name, make(), folder / "case.plan"))


if __name__ == "__main__":
    main()
