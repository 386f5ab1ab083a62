"""First roots: the place from which a polynomial of degree 3 is below zero."""

import itertools

import numpy as np
from jaxtyping import Float


def first_roots(coefficients: Float[np.ndarray, "4 k"]) -> Float[np.ndarray, " k"]:
    """Finds where cubics (lowest coefficient first) first fall below 0 in 0 to 1; else infinity."""
    roots = np.full(coefficients.shape[1], np.inf)
    roots[coefficients[0] < 0] = 0
    c0, c1, c2, c3 = coefficients
    with np.errstate(divide="ignore", invalid="ignore"):
        # places of the extremes, by the form of the quadratic's roots that does not cancel
        half = c2 + np.copysign(np.sqrt(np.maximum(c2**2 - 3 * c1 * c3, 0)), c2)
        extremes = np.stack([-half / (3 * c3), -c1 / half])
    extremes = np.where((extremes > 0) & (extremes < 1), extremes, 1)
    stops = np.concatenate([np.zeros((1, len(c0))), np.sort(extremes, axis=0), np.ones((1, len(c0)))])
    for before, after in itertools.pairwise(stops):
        falls = np.isinf(roots) & (_value(coefficients, after) < 0)
        if falls.any():
            roots[falls] = _bisect(coefficients[:, falls], before[falls], after[falls])
    return roots


def _value(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    c0, c1, c2, c3 = coefficients
    return c0 + t * (c1 + t * (c2 + t * c3))


def _bisect(coefficients: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_below = _value(coefficients, middle) < 0
        low, high = np.where(is_below, low, middle), np.where(is_below, middle, high)
    return low
