"""A thousand motions and adjoints through one plan: no growth, no compilation, the same bits."""

import jax
import numpy as np
import pytest
from memory import resident
from meshes import bricks

import jaxmorph as jm

pytestmark = pytest.mark.slow


@pytest.mark.skipif(not resident(), reason="memory is read as Linux tells it")
def test_a_thousand_calls_leave_nothing_behind():
    mesh = bricks(8)
    points = np.asarray(mesh.points)
    plan = jm.prepare(points, mesh.patch("floor"), np.flatnonzero(points[:, 2] == 1))
    rng = np.random.default_rng(0)
    u, cotangent = 0.01 * rng.normal(size=(plan.n_moving, 3)), rng.normal(size=points.shape)

    def both():
        return np.asarray(jm.deform(plan, u)), np.asarray(jm.pullback(plan, u, cotangent))

    compiled = []

    def listen(event, *_, **__):
        if "backend_compile" in event:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        jax.clear_caches()
        for _ in range(20):
            first = both()
        assert compiled, "the event of a compilation has another name"
        compiled.clear()
        before = resident()
        for _ in range(1000):
            again = both()
    finally:
        jax.monitoring.clear_event_listeners()
    assert not compiled
    assert resident() - before < 20e6
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
