"""Shapes on large walls: a box of 300 control points on 100,000 nodes, smoothing of 10,000 nodes; CPU time, median of 15.

python benchmarks/shapes.py
"""

import time

import jax
import numpy as np
from _measure import about, table

from jaxmorph import shapes


def cpu(function, *arguments) -> float:
    """Measures milliseconds of CPU time, all threads together."""
    jax.block_until_ready(function(*arguments))
    times = []
    for _ in range(15):
        start = time.process_time()
        jax.block_until_ready(function(*arguments))
        times.append(time.process_time() - start)
    return 1e3 * float(np.median(times))


def boxes():
    rng = np.random.default_rng(0)
    x, control = rng.uniform(size=(100_000, 3)), rng.normal(size=(10, 6, 5, 3))
    for name, degree in (
        ("B-splines of degree 2", 2),
        ("B-splines of degree 3", 3),
        ("Bernstein polynomials", None),
    ):
        operator = shapes.FreeForm.around(x, (10, 6, 5), degree=degree).at(x)
        back = jax.jit(lambda u, operator=operator: jax.linear_transpose(operator, control)(u)[0])
        yield name, f"{cpu(jax.jit(operator), control):.1f}", f"{cpu(back, x):.1f}"


def smoothing():
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, 100, endpoint=False), np.linspace(0, 1, 100), indexing="ij"
    )
    points = np.stack([np.cos(u), np.sin(u), v], axis=-1).reshape(-1, 3)
    ids = np.arange(10_000).reshape(100, 100)
    after = np.roll(ids, -1, axis=0)
    quads = np.stack([ids[:, :-1], after[:, :-1], after[:, 1:], ids[:, 1:]], axis=-1).reshape(-1, 4)
    start = time.process_time()
    smoother = shapes.Smoother(points, quads, 0.1)
    print(f"smoother of 10,000 nodes made in {1e3 * (time.process_time() - start):.0f} ms")
    yield (
        "smoothing, 10,000 nodes",
        f"{cpu(jax.jit(lambda u: smoother.apply(u)), points):.1f}",
        f"{cpu(smoother.sensitivities, points):.1f}",
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    about(points=100_000)
    table([*boxes(), *smoothing()], ("what", "forward (ms)", "transpose (ms)"))
