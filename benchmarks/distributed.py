"""A mesh moved and differentiated by several processes, compared with one: a template for many machines.

    python benchmarks/distributed.py [--processes 2] [--points 200000]

Starts the processes on this machine, joined by `jax.distributed` over the loopback interface. On a cluster each process
runs what `work` does, with the address of the first one; nothing else changes.
"""

import argparse
import socket
import subprocess
import sys
import time

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases


def work(points: int) -> str:
    """Deforms and differentiates over all devices of all processes; says how it compares with this process alone."""
    mesh = cases.naca0015(points=points)
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"))
    shared = jm.shard(plan, jax.devices())
    rng = np.random.default_rng(0)
    u, cotangent = 0.01 * rng.normal(size=(plan.n_moving, 2)), rng.normal(size=mesh.points.shape)
    alone, together = (_timed(which, u, cotangent) for which in (plan, shared))
    lines = [
        f"process {jax.process_index()} of {jax.process_count()}, {len(mesh.points)} points, {len(jax.devices())} devices"
    ]
    for k, name in enumerate(("deform", "gradient")):
        here = [np.asarray(part.data) for part in together[k][0].addressable_shards]
        there = [np.asarray(alone[k][0])[part.index] for part in together[k][0].addressable_shards]
        error = max(float(np.abs(a - b).max()) for a, b in zip(here, there, strict=True))
        scale = float(np.abs(np.asarray(alone[k][0])).max())
        lines.append(
            f"  {name}: largest difference {error / scale:.1e} of the largest value, "
            f"CPU {together[k][1] / alone[k][1]:.2f} of one process ({together[k][1]:.3f} s)"
        )
    return "\n".join(lines)


def _timed(plan: jm.Plan, u: np.ndarray, cotangent: np.ndarray) -> list[tuple[jax.Array, float]]:
    """Computes the points and the gradient, each with the least CPU time of five runs."""
    results = []
    for function in (lambda: jm.deform(plan, u), lambda: jm.pullback(plan, u, cotangent)):
        result, times = jax.block_until_ready(function()), []
        for _ in range(5):
            began = time.process_time()
            jax.block_until_ready(function())
            times.append(time.process_time() - began)
        results.append((result, min(times)))
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--rank", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--address", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.rank is not None:
        jax.config.update("jax_enable_x64", True)
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(arguments.address, arguments.processes, arguments.rank)
        print(work(arguments.points), flush=True)
        return 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, __file__, "--address", address]
    command += ["--processes", str(arguments.processes), "--points", str(arguments.points)]
    started = [
        subprocess.Popen([*command, "--rank", str(rank)]) for rank in range(arguments.processes)
    ]
    return max(process.wait() for process in started)


if __name__ == "__main__":
    sys.exit(main())
