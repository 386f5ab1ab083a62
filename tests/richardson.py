"""Jacobians by differences, to ten digits: the oracle of derivatives, component by component."""

import jax
import numpy as np


def jacobian(function, x, step):
    """Jacobians of a tree of arrays by each component of x, from central differences of three steps; the error is of step^6."""
    x = np.asarray(x, dtype=float)

    def column(place):
        tangent = np.zeros(x.size)
        tangent[place] = 1.0
        tangent = tangent.reshape(x.shape)

        def central(h):
            ahead, behind = function(x + h * tangent), function(x - h * tangent)
            return jax.tree.map(lambda a, b: (np.asarray(a) - np.asarray(b)) / (2 * h), ahead, behind)

        def refined(coarse, middle, fine):
            first, second = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
            return (16 * second - first) / 15

        return jax.tree.map(refined, *(central(step / share) for share in (1, 2, 4)))

    columns = [column(place) for place in range(x.size)]
    return jax.tree.map(lambda *parts: np.stack(parts, axis=-1).reshape(*parts[0].shape, *x.shape), *columns)
