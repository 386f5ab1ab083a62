"""CPU seconds of the first `prepare`, `deform`, `pullback` and `quality` in a fresh process, compilation included.

JAX_ENABLE_COMPILATION_CACHE=0 python benchmarks/first_calls.py [--layers 140]
"""

import argparse
import time
import warnings

import faults
import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--layers", type=int, default=140)
    layers = parser.parse_args().layers
    mesh = faults.sharp_o_grid(around=2 * layers, layers=layers)
    about(points=len(mesh.points), imports=f"{time.process_time():.2f} s")
    began = [time.process_time()]
    plan = jax.block_until_ready(jm.prepare(mesh, "airfoil", "farfield"))
    began.append(time.process_time())
    u = 0.1 * np.sin(np.asarray(plan.moving_points))
    points = jax.block_until_ready(jm.deform(plan, u))
    began.append(time.process_time())
    jax.block_until_ready(jm.pullback(plan, u, points))
    began.append(time.process_time())
    jm.quality(mesh, points).raise_if_inverted()
    began.append(time.process_time())
    spent = [*np.diff(began), began[-1] - began[0]]
    table([[f"{each:.2f}" for each in spent]], ("prepare", "deform", "pullback", "quality", "all"))
