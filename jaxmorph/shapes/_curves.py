"""Shapes of a wall along one coordinate: bumps, class functions, B-splines, modes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.arguments import checked
from .._kernels.values import clipped, slack
from . import _bspline
from ._arguments import Numbers, check_finite, known_positions, positions
from ._combine import MatrixOperator
from ._section import Chord
from ._shape import AbstractLinearShape, AbstractOperator


class HicksHenne(AbstractLinearShape):
    """Bumps on an airfoil's side (Hicks and Henne, 1978).

    A bump is sin(pi t^(ln 0.5 / ln c))^w, of height 1 at t = c.

    t runs along the chord from 0 to 1; positions before and behind it stay. The parameters (k,) are
    the heights, in the units of the positions, across the chord. `Part` restricts the bumps to one
    side.

    **Arguments:**

    - `centres`: (k,) between 0 and 1.
    - `widths`: exponents, one or (k,), above 0. A bump with a larger exponent is narrower.
    - `chord`: where the airfoil lies; from (0, 0) to (1, 0) by default.

    **Raises:** `ValueError` for centres outside of 0 to 1, widths that are not above 0, and equal
    bumps.
    """

    centres: Float[Array, " k"]
    widths: Float[Array, " k"]
    chord: Chord

    @checked
    def __init__(self, centres: Numbers, widths: Numbers = 3.0, *, chord: Chord | None = None):
        known = np.asarray(centres, float)
        if known.ndim != 1 or not ((known > 0) & (known < 1)).all():
            raise ValueError(f"`centres` must be (k,) between 0 and 1, got {known}.")
        check_finite(widths=widths)
        if np.shape(widths) not in ((), known.shape) or not (np.asarray(widths) > 0).all():
            raise ValueError(f"`widths` must be one number above 0, or {len(known)} of them.")
        bumps = np.column_stack([known, np.broadcast_to(np.asarray(widths, float), known.shape)])
        if len(np.unique(bumps, axis=0)) < len(bumps):
            raise ValueError(f"{len(bumps) - len(np.unique(bumps, axis=0))} of {len(bumps)} bumps stand twice.")
        self.centres, self.widths = jnp.asarray(known), jnp.broadcast_to(jnp.asarray(widths, float), known.shape)
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Float[Array, " k"]:
        """Makes the heights that move nothing: zeros (k,)."""
        return jnp.zeros(len(self.centres))

    def at(self, x: Numbers) -> MatrixOperator:
        """Computes the bumps at positions (m, d) once."""
        x = positions(x)
        t, _ = self.chord.coordinates(x)
        centres, widths = self.centres.astype(x.dtype)[None, :], self.widths.astype(x.dtype)[None, :]
        inside = (t > 0) & (t < 1)
        power = jnp.where(inside, t, 0.5)[:, None] ** (jnp.log(0.5) / jnp.log(centres)).astype(x.dtype)
        bumps = jnp.where(inside[:, None], jnp.sin(jnp.pi * power) ** widths, 0)
        return MatrixOperator(bumps, self.chord.up.astype(x.dtype))


class CST(AbstractLinearShape):
    """Class and shape functions of one side of an airfoil (Kulfan, 2008).

    They are t^a (1 - t)^b times Bernstein polynomials.

    The parameters are `order + 2` numbers in chords: the weights of the polynomials, and the
    ordinate of a blunt trailing edge. The displacement is what they add across the chord. `Part`
    restricts it to one side; `fit_cst` finds the weights of an airfoil.

    **Arguments:**

    - `order`: degree of the polynomials, 1 or more.
    - `exponents`: (a, b); (0.5, 1) is a round nose and a sharp tail.
    - `chord`: where the airfoil lies; from (0, 0) to (1, 0) by default.
    """

    order: int = eqx.field(static=True)
    exponents: tuple[float, float] = eqx.field(static=True)
    chord: Chord

    @checked
    def __init__(self, order: int, exponents: tuple[float, float] = (0.5, 1.0), *, chord: Chord | None = None):
        if order < 1 or min(exponents) <= 0:
            raise ValueError(f"order {order} and exponents {exponents} must be 1 or more, and above 0.")
        self.order, self.exponents, self.chord = order, exponents, Chord() if chord is None else chord

    def neutral(self) -> Float[Array, " k"]:
        """Makes the weights that add nothing: zeros (order + 2,)."""
        return jnp.zeros(self.order + 2)

    def at(self, x: Numbers) -> MatrixOperator:
        """Computes the functions at positions (m, d) once."""
        x = positions(x)
        t, _ = self.chord.coordinates(x)
        beyond = slack(t.dtype)
        inside = (t >= -beyond) & (t <= 1 + beyond)
        within = jnp.where(inside, t, 0.5)
        a, b = self.exponents
        class_function = jnp.where(inside, _power(within, a) * _power(1 - within, b), 0)
        functions = class_function[:, None] * _bspline.bernstein(within, self.order)
        weights = jnp.concatenate([functions, clipped(t, 0, 1)[:, None]], axis=1)
        return MatrixOperator(weights * self.chord.length.astype(x.dtype), self.chord.up.astype(x.dtype))


def _power(distance: Float[Array, " m"], exponent: float) -> Float[Array, " m"]:
    """Raises distances from nose or tail to a power.

    The derivative at the nose or tail is the derivative inside, or 0 where that is infinite.
    """
    if float(exponent).is_integer():
        return distance ** int(exponent)
    ahead = distance > 0
    return jnp.where(ahead, jnp.where(ahead, distance, 1) ** exponent, 0)


class BSplineCurve(AbstractLinearShape):
    """A B-spline along a curve of nodes, which follow control points by their arc length.

    The parameters are the displacements (count, d) of the control points.

    **Arguments:**

    - `points`: (m, d) the nodes in order, end to end.
    - `count`: control points, above `degree`.
    - `degree`: of the spline.

    **Raises:** `ValueError` for too few control points, coincident neighbours, and other positions
    than `points`.
    """

    shares: Float[Array, " m"]
    count: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)
    dimension: int = eqx.field(static=True)

    @checked
    def __init__(self, points: Numbers, count: int, degree: int = 3):
        known = known_positions(points, "points")
        steps = np.linalg.norm(np.diff(known, axis=0), axis=1)
        if not 1 <= degree < count:
            raise ValueError(f"a B-spline of degree {degree} with {count} control points: degree is 1 to count - 1.")
        if (steps == 0).any():
            first = int(np.argmin(steps))
            raise ValueError(f"{(steps == 0).sum()} nodes stand on the one before, first {first + 1}: leave them out.")
        lengths = np.append(0, np.cumsum(steps))
        self.shares, self.count, self.degree = jnp.asarray(lengths / lengths[-1]), count, degree
        self.dimension = known.shape[1]

    def neutral(self) -> Float[Array, "k d"]:
        """Makes the control displacements that move nothing."""
        return jnp.zeros((self.count, self.dimension))

    def at(self, x: Numbers) -> MatrixOperator:
        """Computes the weights of the wall's nodes, in the order of `points`."""
        x = positions(x)
        if (*self.shares.shape, self.dimension) != x.shape:
            raise ValueError(f"this curve has {len(self.shares)} nodes in {self.dimension}-D; `x` has shape {x.shape}.")
        t = self.shares.astype(x.dtype)
        first = _bspline.spans(t, self.count, self.degree)
        values = _bspline.values(t, first, self.count, self.degree)
        columns = first[:, None] + jnp.arange(self.degree + 1)[None, :]
        weights = jnp.zeros((len(x), self.count), x.dtype).at[jnp.arange(len(x))[:, None], columns].add(values)
        return MatrixOperator(weights, count=x.shape[1])


class Modes(AbstractLinearShape):
    """Given displacement fields, such as mode shapes; the parameters (k,) are amplitudes.

    **Arguments:**

    - `fields`: (k, m, d).

    **Raises:** `ValueError` for fields of another shape than the positions.
    """

    fields: Float[Array, "k m d"]

    @checked
    def __init__(self, fields: Numbers):
        self.fields = jnp.asarray(fields, float)
        check_finite(fields=self.fields)
        if self.fields.ndim != 3:
            raise ValueError(f"`fields` has shape {self.fields.shape}; expected (k, m, d).")

    def neutral(self) -> Float[Array, " k"]:
        """Makes the amplitudes that move nothing: zeros (k,)."""
        return jnp.zeros(len(self.fields))

    def at(self, x: Numbers) -> "ModesOperator":
        """Checks that the fields belong to positions (m, d)."""
        x = positions(x)
        if self.fields.shape[1:] != x.shape:
            raise ValueError(f"`x` has shape {x.shape}; the modes have {self.fields.shape[1:]}.")
        return ModesOperator(self.fields.astype(x.dtype))


class ModesOperator(AbstractOperator):
    """Sums fields with amplitudes."""

    fields: Float[Array, "k m d"]

    def __call__(self, parameters: Numbers) -> Float[Array, "m d"]:
        parameters = jnp.asarray(parameters, self.fields.dtype)
        if parameters.shape != self.fields.shape[:1]:
            raise ValueError(f"parameters have shape {parameters.shape}; there are {len(self.fields)} modes.")
        return jnp.tensordot(parameters, self.fields, axes=1)
