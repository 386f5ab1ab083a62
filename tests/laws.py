"""Laws of a plan whose boundary slides, repeats or is mirrored, which several files of tests hold."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm


def check_linear(plan, u) -> np.ndarray:
    """Holds a plan to be linear in `u`, with `pullback` as its transpose; returns the motion of a random displacement."""
    points, rng = np.asarray(plan.points), np.random.default_rng(0)
    v, w = rng.normal(size=u.shape), rng.normal(size=points.shape)
    moved, other = np.asarray(jm.deform(plan, u)), np.asarray(jm.deform(plan, v)) - points
    assert (jm.deform(plan, 0 * u) == points).all()
    np.testing.assert_allclose(
        jm.deform(plan, 2 * u - v) - points, 2 * (moved - points) - other, rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(np.vdot(jm.pullback(plan, v, w), v), np.vdot(w, other), rtol=1e-10)
    return other


def check_base_derivative(plan, u, allowed) -> None:
    """Holds the derivative by the base points to its difference, along a step that `allowed` keeps on the boundary."""
    points, rng = np.asarray(plan.points), np.random.default_rng(1)
    w, step = rng.normal(size=points.shape), allowed(1e-7 * rng.normal(size=points.shape))

    @jax.jit
    @jax.value_and_grad
    def objective(points):
        return jnp.sum(w * jm.deform(jm.refit(plan, points), u))

    difference = (objective(points + step)[0] - objective(points - step)[0]) / 2
    np.testing.assert_allclose(
        np.vdot(objective(points)[1], step), difference, rtol=1e-5, atol=1e-12
    )


def check_steps(plan, path) -> list[np.ndarray]:
    """Holds steps to their replay; returns where they end, with kept and with rebuilt ids."""
    ends = []
    for rebuild in (False, True):
        plans, end = jm.march(plan, path, rebuild=rebuild)
        np.testing.assert_allclose(jm.replay(plans, path), end, rtol=0, atol=1e-12)
        ends.append(np.asarray(end))
    return ends


def check_parts(boundary, plan, u, size) -> None:
    """Holds chunks, and a plan laid over a device, to move as the whole does."""
    whole = np.asarray(jm.deform(plan, u))
    chunks = list(jm.prepare_in_chunks(boundary, size=size, method=plan.method))
    assert len(chunks) > 1
    for nodes, part in chunks:
        np.testing.assert_allclose(jm.deform(part, u), whole[nodes], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        jm.deform(jm.shard(plan, jax.devices()[:1]), u), whole, rtol=0, atol=1e-12
    )
