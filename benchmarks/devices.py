"""One plan over 1, 2, 4 and 8 devices of the host: total CPU time should stay flat, results equal.

python benchmarks/devices.py [--n 1000000] [--s 300]

The devices are forced (`--xla_force_host_platform_device_count=8`): they share the machine's cores, so nothing gets faster, but
work that each repeats would show as CPU time. Differences are the largest of all components, relative to the largest component.
"""

import argparse
import functools
import os

os.environ["XLA_FLAGS"] = (
    os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"
)

import jax
import numpy as np
from _cases import displacements, plan_of
from _measure import about, cpu_seconds, table

import jaxmorph as jm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--n", type=int, default=1_000_000)
    parser.add_argument("--s", type=int, default=300)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about(n=arguments.n, s=arguments.s, dtype="float64")
    plan = plan_of(arguments.n, arguments.s)
    u = displacements(plan)
    cotangent = np.random.default_rng(0).normal(size=plan.points.shape)
    plans = {1: plan} | {count: jm.shard(plan, jax.devices()[:count]) for count in (2, 4, 8)}
    first: dict[str, tuple[np.ndarray, float]] = {}
    rows = []
    for name, function in (
        ("deform", jm.deform),
        ("pullback", lambda plan, u: jm.pullback(plan, u, cotangent)),
    ):
        calls = {str(count): functools.partial(function, laid, u) for count, laid in plans.items()}
        times = cpu_seconds(calls, 3)
        for count, laid in plans.items():
            found = np.asarray(function(laid, u))
            exact, alone = first.setdefault(name, (found, times[str(count)]))
            difference = np.abs(found - exact).max() / np.abs(exact).max()
            seconds = times[str(count)]
            rows.append(
                (name, str(count), f"{seconds:.2f}", f"{seconds / alone:.2f}", f"{difference:.0e}")
            )
    table(rows, ("what", "devices", "CPU, s", "over one", "difference"))


if __name__ == "__main__":
    main()
