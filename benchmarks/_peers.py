"""Other packages that evaluate a thin plate spline with a linear polynomial; only installed packages are run."""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.interpolate import RBFInterpolator


def evaluations(
    sources: np.ndarray, values: np.ndarray, points: np.ndarray
) -> Iterator[tuple[str, Callable[[], np.ndarray]]]:
    """Each peer's name and its evaluation at the points (n, 3); the fit is done beforehand."""
    scipy = RBFInterpolator(sources, values, kernel="thin_plate_spline", degree=1)
    yield "SciPy", lambda: scipy(points)
    for name, peer in (
        ("ferreus-rbf", ferreus),
        ("treverhines-rbf", treverhines),
        ("a loop in Numba", numba_loop(scipy)),
    ):
        try:
            yield name, peer(sources, values, points)
        except ImportError:
            continue


def ferreus(sources, values, points):
    """Fast multipole."""
    from ferreus_rbf import RBFInterpolator
    from ferreus_rbf.interpolant_config import (
        Drift,
        FittingAccuracy,
        FittingAccuracyType,
        InterpolantSettings,
    )
    from ferreus_rbf.interpolant_config import RBFKernelType as Kernel

    accuracy = FittingAccuracy(1e-10, FittingAccuracyType.Relative)
    settings = InterpolantSettings(
        Kernel.ThinPlateSpline, drift=Drift.Linear, fitting_accuracy=accuracy
    )
    interpolator = RBFInterpolator(sources, values, settings)
    return lambda: interpolator.evaluate(points)


def treverhines(sources, values, points):
    """The package from which SciPy's interpolator came."""
    from rbf.interpolate import RBFInterpolant

    interpolant = RBFInterpolant(sources, values, phi="phs2", order=1)
    return lambda: interpolant(points)


def numba_loop(scipy: RBFInterpolator):
    """The sum as one writes it by hand, with the coefficients that SciPy found."""

    def prepared(sources, values, points):
        import numba

        @numba.njit(fastmath=True, error_model="numpy")
        def evaluate(points, sources, beta):
            result = np.zeros((len(points), 3))
            for i in range(len(points)):
                x, y, z = points[i]
                u = v = w = 0.0
                for j in range(len(sources)):
                    r2 = (
                        (x - sources[j, 0]) ** 2
                        + (y - sources[j, 1]) ** 2
                        + (z - sources[j, 2]) ** 2
                    )
                    phi = 0.5 * r2 * np.log(r2 + 1e-300)
                    u += phi * beta[j, 0]
                    v += phi * beta[j, 1]
                    w += phi * beta[j, 2]
                result[i] = u, v, w
            return result

        coefficients = scipy._coeffs  # pyright: ignore[reportAttributeAccessIssue] -- nowhere else
        beta = np.ascontiguousarray(coefficients[: len(sources)])
        alpha = coefficients[len(sources) :]
        shift, scale = scipy._shift, scipy._scale  # pyright: ignore[reportAttributeAccessIssue]
        tail = np.concatenate([np.ones((len(points), 1)), (points - shift) / scale], axis=1) @ alpha
        evaluate(points[:2], sources, beta)
        return lambda: evaluate(points, sources, beta) + tail

    return prepared
