"""A plan laid over devices: the same answers, the work divided, one all-reduce for a gradient."""

import json
import os
import subprocess
import sys

import pytest

SHARDED = """
import json, re
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.linear import systems as linear

mesh, found = cases.naca0015(points=2000), {}
rng = np.random.default_rng(0)
u, cotangent = 0.01 * rng.normal(size=(len(mesh.patch("airfoil")), 2)), rng.normal(size=mesh.points.shape)
methods = {
    "default": jm.SurfaceReconstruction(jm.RBF(reduction=jm.KDTree(8), fixed_reduction=jm.KDTree(4)), jm.NearWall()),
    "graph": jm.DelaunayGraph(),
    "compact": jm.CompactRBF(0.2),
}
solves, solved = [], linear.solve
linear.solve = lambda *system, **options: solves.append(1) or solved(*system, **options)
for name, method in methods.items():
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)
    path = np.stack([u / 2, u])
    whole = jm.deform(plan, u), jm.pullback(plan, u, cotangent), jm.march(plan, path)[1]
    base = jax.grad(lambda x: jnp.vdot(jm.deform(jm.refit(plan, x), u), cotangent))(plan.points)
    for count in (2, 3):
        laid = jm.shard(plan, jax.devices()[:count])
        solves.clear()
        equal = bool((jm.deform(laid, u) == whole[0]).all())
        jax.block_until_ready(jm.pullback(laid, u, cotangent))
        found[f"{name} {count} solves"] = [equal, len(solves)]
        shared = jm.deform(laid, u), jm.pullback(laid, u, cotangent), jm.march(laid, path)[1]
        shared += (jax.grad(lambda x: jnp.vdot(jm.deform(jm.refit(laid, x), u), cotangent))(laid.points),)
        found[f"{name} {count}"] = [float(jnp.abs(a - b).max() / jnp.abs(a).max()) for a, b in zip((*whole, base), shared)]
        gradient = jax.jit(jax.grad(lambda u, laid: (jm.deform(laid, u) ** 3).sum()))
        text = gradient.lower(jnp.asarray(u), laid).compile().as_text()
        bodies = re.findall(r"body=%?([\\w.]+)", text)
        inside = [body for body in bodies if "all-reduce" in text.split("%" + body + " (")[1].split("\\n}")[0]]
        found[f"{name} {count} text"] = [len(re.findall(r"all-reduce(?:-start)?\\(", text)), len(inside)]
    found[f"{name} points"] = len(laid.points) == len(plan.points)
print(json.dumps(found))
"""


@pytest.mark.nightly
def test_equal_to_the_whole_with_one_all_reduce_outside_of_loops():
    """Points bit for bit but for the order of sums, gradients as far as the solve lets them: one process compiles it all."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=3"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", SHARDED], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout)
    for method, least in (("default", 1e-8), ("graph", 1e-12), ("compact", 1e-11)):
        assert found[f"{method} points"], "the number of points has changed"
        for count in (2, 3):
            points, pulled, marched, base = found[f"{method} {count}"]
            assert points < 1e-13
            assert marched < 1e-12  # a second solve, on points that differ by round-off
            assert max(pulled, base) < least
            reduces, in_loops = found[f"{method} {count} text"]
            assert in_loops == 0
            if method == "compact":  # `deform` and `pullback` solve on the host once each, not once a device
                assert found[f"{method} {count} solves"] == [True, 2]
            else:
                assert reduces == 1
