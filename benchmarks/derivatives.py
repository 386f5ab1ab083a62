"""What each derivative costs beside one `deform`, on the paper's airfoil: CPU time, and what the compiled program sets aside.

python benchmarks/derivatives.py
"""

import argparse
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _measure import about, cpu_seconds, table

import jaxmorph as jm
from jaxmorph import cases

STEPS, PLANS = 100, 3


def planned(mesh: jm.Mesh) -> jm.Plan:
    """The default method with a basis whose radius can be differentiated."""
    coarse = jm.RBF(jm.WendlandC2(4.0), reduction=jm.KDTree(64, extremes=True))
    method = jm.SurfaceReconstruction(coarse, jm.NearWall())
    return jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)


def square(points):
    return jnp.sum(points**2)


def of_the_map(plan, u):
    """Derivatives of `deform` alone; arguments as an optimiser would pass them, the plan among them."""

    def with_radius(plan, radius):
        return eqx.tree_at(lambda plan: plan.method.coarse.basis.support_radius, plan, radius)

    radius = plan.method.coarse.basis.support_radius
    plans = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *[jm.refit(plan, k * plan.points) for k in (0.9, 1, 1.2)]
    )
    return {
        "`deform`": (jm.deform, (plan, u)),
        "`jax.jvp` by u, value included": (
            lambda plan, u: jax.jvp(lambda u: jm.deform(plan, u), (u,), (0.1 * u,)),
            (plan, u),
        ),
        "`pullback`": (lambda plan, u: jm.pullback(plan, u, plan.points), (plan, u)),
        "`jax.grad` by u": (
            lambda plan, u: jax.grad(lambda u: square(jm.deform(plan, u)))(u),
            (plan, u),
        ),
        "`refit`": (lambda plan, points: jm.refit(plan, points).volume, (plan, plan.points)),
        "`jax.grad` by the base points, through `refit`": (
            lambda plan, u: jax.grad(lambda x: square(jm.deform(jm.refit(plan, x), u)))(
                plan.points
            ),
            (plan, u),
        ),
        "`jax.grad` by the radius of the basis, through `refit`": (
            lambda plan, u: jax.grad(
                lambda r: square(jm.deform(jm.refit(with_radius(plan, r), plan.points), u))
            )(radius),
            (plan, u),
        ),
        f"`eqx.filter_vmap` over {PLANS} plans": (
            eqx.filter_vmap(jm.deform, in_axes=(eqx.if_array(0), None)),
            (plans, u),
        ),
    }


def of_quality(mesh, plan, u):
    """First and second derivatives through `quality` too."""

    def objective(plan, u):
        return jnp.mean((jm.quality(mesh, jm.deform(plan, u)).volume_ratio - 1) ** 2)

    gradient = jax.grad(objective, argnums=1)
    return {
        "`quality` of `deform`, one measure": (objective, (plan, u)),
        "its `jax.grad` by u": (gradient, (plan, u)),
        "its Hessian times a vector, `jax.jvp` of `jax.grad`": (
            lambda plan, u: jax.jvp(lambda u: gradient(plan, u), (u,), (0.1 * u,))[1],
            (plan, u),
        ),
        "the same, `jax.grad` of a product with `jax.grad`": (
            lambda plan, u: jax.grad(lambda v: jnp.vdot(gradient(plan, v), 0.1 * u))(u),
            (plan, u),
        ),
    }


def of_an_optimisation(plan, u):
    """A hundred steps of gradient descent in one program, and the derivative of where they end."""
    target = jm.deform(plan, u)
    curvature = 2 * jnp.sum((target - plan.points) ** 2)

    def ended(plan, target, remembered):
        misfit = lambda a: jnp.sum(jnp.log1p((jm.deform(plan, a * u) - target) ** 2))  # noqa: E731
        step = lambda a, _: (a - 0.2 / curvature * jax.grad(misfit)(a), None)  # noqa: E731
        return jax.lax.scan(remembered(step), jnp.zeros(()), length=STEPS)[0]

    plain, recomputed = (lambda step: step), jax.checkpoint
    return {
        f"{STEPS} steps of a descent in `lax.scan`": (
            lambda plan, target: ended(plan, target, plain),
            (plan, target),
        ),
        "`jax.grad` of where they end": (
            lambda plan, target: jax.grad(ended, argnums=1)(plan, target, plain),
            (plan, target),
        ),
        "the same, each step under `jax.checkpoint`": (
            lambda plan, target: jax.grad(ended, argnums=1)(plan, target, recomputed),
            (plan, target),
        ),
    }


def compiled(function, arguments):
    """The compiled program as a function of nothing, and the bytes that it sets aside."""
    arrays, static = eqx.partition(arguments, eqx.is_array)
    program = jax.jit(lambda arrays: function(*eqx.combine(arrays, static))).lower(arrays).compile()
    return lambda: program(arrays), program.memory_analysis().temp_size_in_bytes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=100_000)
    asked = parser.parse_args().points
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
    jax.config.update("jax_enable_x64", True)
    mesh = cases.naca0015(points=asked)
    plan = planned(mesh)
    wall = np.asarray(plan.points[plan.moving])
    u = jnp.asarray(0.05 * np.sin(np.pi * wall[:, :1]) * [0.0, 1.0])
    sources = len(plan.sources)
    about(n=len(mesh.points), moving=plan.n_moving, sources=sources, dtype="float64")
    functions = of_the_map(plan, u) | of_quality(mesh, plan, u) | of_an_optimisation(plan, u)
    programs = {name: compiled(*what) for name, what in functions.items()}
    seconds = cpu_seconds({name: run for name, (run, _) in programs.items()}, repeats=5)
    first = seconds["`deform`"]
    rows = [
        (
            name,
            f"{1e3 * seconds[name]:.1f}",
            f"{times:.1f}" if (times := seconds[name] / first) < 10 else f"{times:.0f}",
            f"{space / 1e6:.1f}",
        )
        for name, (_, space) in programs.items()
    ]
    table(rows, ("what", "CPU, ms", "times `deform`", "set aside, MB"))


if __name__ == "__main__":
    main()
