"""How much faster one `deform` runs on all cores than on one: wall time, so only an otherwise idle machine tells.

python benchmarks/both_cores.py [--n 1000000] [--s 300]

Each line is a process of its own: one core; all cores as JAX uses them by itself; all cores as so many devices of the host, over
which `jaxmorph.shard` lays the points.
"""

import argparse
import os
import subprocess
import sys
import time


def measure(n: int, s: int, form: str, repeats: int = 7) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0))
    if form == "devices":
        jax.config.update("jax_num_cpu_devices", cores)
    from _cases import displacements, plan_of
    from _measure import about

    import jaxmorph as jm

    if form == "one core":
        about(n=n, s=s, dtype="float64")
        print("\n| form | wall s | CPU s | load |\n|---|---|---|---|", flush=True)
    plan = plan_of(n, s)
    u = displacements(plan)
    if form == "devices":
        plan = jm.shard(plan, jax.devices())
    times = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(jm.deform(plan, u))
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    wall, cpu = sorted(times[1:])[(repeats - 1) // 2]
    print(f"| {form} | {wall:.3f} | {cpu:.3f} | {os.getloadavg()[0]:.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=1_000_000)
    parser.add_argument("--s", type=int, default=300)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        return measure(arguments.n, arguments.s, arguments.child)
    cores = os.sched_getaffinity(0)
    for form, allowed in (("one core", {max(cores)}), ("all cores", cores), ("devices", cores)):
        os.sched_setaffinity(0, allowed)
        subprocess.run([sys.executable, *sys.argv, "--child", form], check=True)
        os.sched_setaffinity(0, cores)


if __name__ == "__main__":
    main()
