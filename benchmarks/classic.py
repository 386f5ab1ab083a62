"""The classic RBF by iterations against the dense solve: CPU seconds, peak memory and difference, each in a process of its own.

python benchmarks/classic.py [--counts 4000 10600] [--iterative 17147 100000]

The body is an ellipsoid like a wing (1 x 0.1 x 3), bent and twisted; a tenth as many nodes of a far field are fixed. The last rows
are solved by iterations alone. `deform` and `pullback` move the sources and 1,000 points more, so that they are the solve.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

SOLVERS = ("direct", "iterative")


def body(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, moving and fixed nodes, and displacements of the moving ones."""
    from _cases import sphere

    far = count // 11
    wall = sphere(count - far) * [0.5, 0.05, 1.5]
    inner = sphere(1000) * [1.0, 0.5, 2.0]
    angle = 0.1 * wall[:, 2]
    bent = 0.05 * wall[:, 2] ** 2 + 0.01 * np.sin(5 * wall[:, 0])
    u = np.stack([-angle * wall[:, 1], angle * wall[:, 0] + bent, 0 * bent], axis=1)
    return (
        np.concatenate([wall, 20 * sphere(far), inner]),
        np.arange(len(wall)),
        len(wall) + np.arange(far),
        u,
    )


def measure(count: int, solver: str, path: str) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    import jaxmorph as jm

    points, moving, fixed, u = body(count)
    weights = np.random.default_rng(0).normal(size=points.shape)
    kind = jm.Direct() if solver == "direct" else jm.Iterative()
    method = jm.RBF(reduction=jm.AllPoints(), fixed_reduction=jm.AllPoints(), solver=kind)
    began = [time.process_time()]
    plan = jax.block_until_ready(jm.prepare(points, moving, fixed, method=method))
    began.append(time.process_time())
    moved = np.asarray(jm.deform(plan, u))
    began.append(time.process_time())
    pulled = np.asarray(jm.pullback(plan, u, weights))
    began.append(time.process_time())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    np.savez(
        path, moved=moved, pulled=pulled, seconds=np.diff(began), peak=peak, size=np.abs(u).max()
    )


def row(count: int, solver: str, folder: str) -> dict[str, np.ndarray]:
    path = f"{folder}/{count}-{solver}.npz"
    subprocess.run([sys.executable, __file__, "--child", str(count), solver, path], check=True)
    with np.load(path) as file:
        return dict(file)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--counts", type=int, nargs="*", default=[4000, 10_600])
    parser.add_argument("--iterative", type=int, nargs="*", default=[17_147, 100_000])
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        count, solver, path = arguments.child
        return measure(int(count), solver, path)
    from _measure import about

    about(dtype="float64")
    print(
        "\n| sources | solver | prepare, s | first deform, s | first pullback, s | peak, GB | difference: points, pullback |"
    )
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for count in (*arguments.counts, *arguments.iterative):
            exact = None
            for solver in SOLVERS if count in arguments.counts else SOLVERS[1:]:
                found = row(count, solver, folder)
                exact = found if solver == "direct" else exact
                difference = "-"
                if exact is not None and solver != "direct":
                    points = np.abs(found["moved"] - exact["moved"]).max() / found["size"]
                    pulled = np.linalg.norm(found["pulled"] - exact["pulled"]) / np.linalg.norm(
                        exact["pulled"]
                    )
                    difference = f"{points:.0e}, {pulled:.0e}"
                seconds = " | ".join(f"{each:.1f}" for each in found["seconds"])
                print(
                    f"| {count:,} | {solver} | {seconds} | {found['peak']:.2f} | {difference} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
