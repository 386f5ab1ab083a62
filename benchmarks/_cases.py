"""The case of the kernel-sum benchmarks: s sources spread over a sphere, n points in a cube, the sum alone or its C++ peer."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxmorph as jm

BASES = {
    "ThinPlateSpline": (lambda: jm.ThinPlateSpline(), 1, 0),
    "WendlandC2": (lambda: jm.WendlandC2(0.5), 1, 1),
    "Gaussian": (lambda: jm.Gaussian(0.2), 1, 2),
    "Multiquadric": (lambda: jm.Multiquadric(0.2), 1, 3),
}
"""A basis, the degree of its polynomial and its number in kernel_sum.cpp."""

RADIUS = {"WendlandC2": 0.5, "Gaussian": 0.2, "Multiquadric": 0.2}


def sphere(count: int) -> np.ndarray:
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1
    )


def plan_of(n: int, s: int, basis: str = "ThinPlateSpline", dtype=np.float64) -> jm.Plan:
    """All s moving nodes are sources, nothing is fixed: `deform` is the kernel sum and little else."""
    points = np.random.default_rng(0).uniform(-0.55, 0.55, (n, 3))
    points[:s] = sphere(s)
    make, degree, _ = BASES[basis]
    every = jm.AllPoints()
    method = jm.RBF(make(), reduction=every, fixed_reduction=every, degree=degree)
    return jm.prepare(points.astype(dtype), np.arange(s), method=method)


def displacements(plan: jm.Plan, count: int | None = None):
    shape = (plan.n_moving, 3) if count is None else (count, plan.n_moving, 3)
    return jnp.asarray(0.1 * np.random.default_rng(1).normal(size=shape), plan.points.dtype)


class Cpp:
    """kernel_sum.cpp, compiled here: the sum of the same plan, on coordinates prepared beforehand."""

    flags = ("-O3", "-march=native", "-ffast-math", "-fopenmp")

    @staticmethod
    def available() -> bool:
        return shutil.which("g++") is not None

    def __init__(self):
        library = Path(tempfile.mkdtemp()) / "kernel_sum.so"
        source = Path(__file__).with_name("kernel_sum.cpp")
        subprocess.run(
            ["g++", *self.flags, "-shared", "-fPIC", str(source), "-o", str(library)], check=True
        )
        self.library = ctypes.CDLL(str(library))
        self.version = subprocess.run(
            ["g++", "-dumpfullversion"], capture_output=True, text=True
        ).stdout.strip()

    def prepared(self, plan: jm.Plan, u, basis: str):
        """A function that makes the sum, and the array (3, n) that it fills with displacements."""
        field = plan.method.field(plan.surface.ids, plan.surface.factors, plan.surface.points, u)
        scale = np.asarray(field.scale)
        arrays = [
            (np.asarray(plan.points) - field.centre).T * scale,
            field.sources.T,
            field.beta,
            field.alpha.T,
        ]
        arrays = [np.ascontiguousarray(array, np.float64) for array in arrays]
        result = np.empty((3, plan.points.shape[0]))
        pointers = [
            array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in (*arrays, result)
        ]
        radius = ctypes.c_double(RADIUS.get(basis, 1.0) * float(scale))
        sizes = ctypes.c_ssize_t(result.shape[1]), ctypes.c_ssize_t(len(field.sources))

        def run(kept=(arrays, result)):
            self.library.kernel_sum(BASES[basis][2], radius, *sizes, *pointers)

        return run, result
