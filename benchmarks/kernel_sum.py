"""The kernel sum of `deform` against SciPy and a C++ kernel, its gradient, many fields at once: nanoseconds a pair on one core.

python benchmarks/kernel_sum.py [--n 100000] [--s 300] [--cores 1]

Runs twice, each time in a process of its own: with XLA's default flags and with vectors of 512 bits. Set-up, compilation and the
C++ peer's preparation are not counted. `--cores 1` keeps the process, peers included, to one core.
"""

import argparse
import os
import subprocess
import sys
import time

WIDE = "--xla_cpu_prefer_vector_width=512"


def measure(n: int, s: int) -> None:
    import jax
    import numpy as np
    from _cases import BASES, Cpp, displacements, plan_of
    from _measure import about, cpu_seconds

    import jaxmorph as jm

    jax.config.update("jax_enable_x64", True)
    cpp = Cpp() if Cpp.available() else None
    peers = f"g++ {cpp.version} {' '.join(cpp.flags)}" if cpp else "no g++ here"
    about(n=n, s=s, dtype="float64", cores=len(os.sched_getaffinity(0)), peer=peers)

    def per_pair(functions, repeats=7):
        return {
            name: 1e9 * seconds / (n * s)
            for name, seconds in cpu_seconds(functions, repeats).items()
        }

    print("\n| basis | jaxmorph | C++ | speed of C++ | first call, s |\n|---|---|---|---|---|")
    for basis in BASES:
        plan = plan_of(n, s, basis)
        u = displacements(plan)
        began = time.perf_counter()
        moved = jax.block_until_ready(jm.deform(plan, u))
        first = time.perf_counter() - began
        functions = {"jaxmorph": lambda plan=plan, u=u: jm.deform(plan, u)}
        if cpp:
            functions["C++"], result = cpp.prepared(plan, u, basis)
            functions["C++"]()
            np.testing.assert_allclose(result.T[s:], (moved - plan.points)[s:], rtol=0, atol=1e-9)
        times = per_pair(functions)
        peer = times.get("C++", float("nan"))
        share = f"{peer / times['jaxmorph']:.0%}"
        print(
            f"| {basis} | {times['jaxmorph']:.2f} | {peer:.2f} | {share} | {first:.1f} |",
            flush=True,
        )

    plan = plan_of(n, s)
    u = displacements(plan)
    against_peers(plan, u, per_pair)
    derivatives_and_many(plan, u, per_pair)


def against_peers(plan, u, per_pair) -> None:
    import numpy as np
    from _peers import evaluations

    import jaxmorph as jm

    points = np.asarray(plan.points)
    peers = dict(evaluations(points[plan.moving], np.asarray(u), points))
    exact = peers["SciPy"]()
    print(
        "\n| evaluation | ns a pair | times jaxmorph | largest difference from SciPy |\n|---|---|---|---|"
    )
    differences = {
        name: np.abs(np.asarray(function()) - exact).max() for name, function in peers.items()
    }
    differences["jaxmorph"] = np.abs(np.asarray(jm.deform(plan, u)) - points - exact).max()
    for name, peer in peers.items():
        times = per_pair({"jaxmorph": lambda: jm.deform(plan, u), name: peer}, 5)
        factor = times[name] / times["jaxmorph"]
        print(
            f"| {name} | {times[name]:.2f} | {factor:.1f} | {differences[name]:.0e} |", flush=True
        )
    print(
        f"| jaxmorph | {times['jaxmorph']:.2f} | 1.0 | {differences['jaxmorph']:.0e} |", flush=True
    )


def derivatives_and_many(plan, u, per_pair) -> None:
    import jax
    import jax.numpy as jnp
    import numpy as np
    from _cases import displacements

    import jaxmorph as jm

    w = jnp.asarray(np.random.default_rng(2).normal(size=plan.points.shape))
    gradient = jax.jit(jax.grad(lambda u, plan: jnp.sum(w * jm.deform(plan, u) ** 2)))
    by_points = jax.jit(jax.grad(lambda x, plan: jnp.vdot(w, jm.deform(jm.refit(plan, x), u))))
    tangent = jax.jit(lambda u, plan: jax.jvp(lambda u: jm.deform(plan, u), (u,), (u,)))
    several = jax.jit(jax.vmap(jm.deform, (None, 0)))
    eight, hundred = displacements(plan, 8), displacements(plan, 100)
    groups = (
        {
            "pullback": lambda: jm.pullback(plan, u, w),
            "jvp, value included": lambda: tangent(u, plan),
            "jax.grad of a nonlinear scalar, by u": lambda: gradient(u, plan),
            "jax.grad by the base points (through refit)": lambda: by_points(plan.points, plan),
        },
        {"deform, 8 fields by vmap": lambda: several(plan, eight)},
        {"deform, 100 fields by vmap": lambda: several(plan, hundred)},
    )
    one = per_pair({"deform": lambda: jm.deform(plan, u)})[
        "deform"
    ]  # alone: after 240 MB of fields it is slower
    print(
        f"\n| thin plate spline | ns a pair | times deform |\n|---|---|---|\n| deform | {one:.2f} | 1.00 |"
    )
    for group in groups:
        for name, value in per_pair(group, 5).items():
            print(f"| {name} | {value:.2f} | {value / one:.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=100_000)
    parser.add_argument("--s", type=int, default=300)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        return measure(arguments.n, arguments.s)
    cores = sorted(os.sched_getaffinity(0))[-arguments.cores :]
    os.sched_setaffinity(0, cores)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
        os.environ[name] = str(len(cores))
    given = os.environ.get("XLA_FLAGS", "")
    for flags in ("", WIDE):
        environment = {**os.environ, "XLA_FLAGS": f"{given} {flags}".strip()}
        subprocess.run([sys.executable, *sys.argv, "--child"], env=environment, check=True)
        print()


if __name__ == "__main__":
    main()
