"""How much faster calls run on all cores than on one: wall time, so only an otherwise idle machine tells.

python benchmarks/both_cores.py [--n 216000] [--s 300]

Each form is a process of its own: one core; all cores; for comparison all cores as so many devices of the host, over which
`jaxmorph.shard` lays the points, and two processes of one core each at the same time. On a busy machine the CPU time of the
busiest thread says what the wall time would be at least: it does not count waiting for a core. The threads of
`face_quality` end with the call, so an equal share of the CPU time counts as their busiest thread.
"""

import argparse
import os
import pathlib
import subprocess
import sys
import time
from collections.abc import Callable

FORMS = ("one core", "all cores", "devices", "two processes")


def of_threads() -> dict[str, float]:
    """CPU milliseconds of each thread of this process (Linux)."""
    spent = {}
    for task in pathlib.Path("/proc/self/task").glob("*/schedstat"):
        spent[task.parent.name] = int(task.read_text().split()[0]) / 1e6
    return spent


def measure(n: int, s: int, form: str, repeats: int = 15) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0))
    if form == "devices":
        jax.config.update("jax_num_cpu_devices", cores)
    import numpy as np
    from _cases import displacements, plan_of
    from _measure import about
    from files import box

    import jaxmorph as jm

    if form == FORMS[0]:
        about(n=n, s=s, dtype="float64")
        print(
            "\n| call | form | wall ms | CPU ms | busiest thread ms | load |\n|---|---|---|---|---|---|",
            flush=True,
        )
    plan, mesh = plan_of(n, s), box(round(n ** (1 / 3)))
    u, w = displacements(plan), np.random.default_rng(0).normal(size=(n, 3))
    if form == "devices":
        plan = jm.shard(plan, jax.devices())
    calls: dict[str, Callable[[], object]] = {
        "deform": lambda: jm.deform(plan, u),
        "pullback": lambda: jm.pullback(plan, u, w),
    }
    if form != "devices":
        calls["quality"] = lambda: jm.quality(mesh, np.asarray(mesh.points)).mean_skewness
        calls["face_quality"] = lambda: jm.face_quality(mesh, np.asarray(mesh.points)).skewness
    for name, call in calls.items():
        jax.block_until_ready(call())
        times = []
        for _ in range(repeats):
            before, wall, cpu = of_threads(), time.perf_counter(), time.process_time()
            jax.block_until_ready(call())
            wall, cpu, after = time.perf_counter() - wall, time.process_time() - cpu, of_threads()
            busiest = max(after[key] - before.get(key, 0) for key in after)
            if name == "face_quality":  # its threads end with the call
                busiest = max(busiest, 1e3 * cpu / cores)
            times.append((1e3 * wall, 1e3 * cpu, busiest))
        best = (min(column) for column in zip(*times, strict=True))
        print(
            f"| {name} | {form} | {' | '.join(f'{value:.1f}' for value in best)} | {os.getloadavg()[0]:.1f} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--n", type=int, default=216_000)
    parser.add_argument("--s", type=int, default=300)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        return measure(arguments.n, arguments.s, arguments.child)
    cores = sorted(os.sched_getaffinity(0))
    for form in FORMS:
        places = {"one core": [cores[:1]], "two processes": [cores[:1], cores[-1:]]}.get(
            form, [cores]
        )
        command = [sys.executable, *sys.argv, "--child", form]
        runs = [
            subprocess.Popen(["taskset", "-c", ",".join(map(str, place)), *command])
            for place in places
        ]
        for run in runs:
            run.wait()


if __name__ == "__main__":
    main()
