"""The float64 logarithm for CPUs, in operations that compile to vectors: four times XLA's speed.

x = 2^k m with m in [sqrt(1/2), sqrt(2)), and log m = 2 artanh(s) with s = (m - 1) / (m + 1)
(Muller, Elementary Functions, chapter 11). Newton's iteration computes the quotient: a division
costs ten multiplications. Coefficients interpolate at Chebyshev points.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .compile import is_for_cpu

_ROOT_HALF = 0x3FE6A09E00000000  # the bits of sqrt(1/2), rounded down to a multiple of 2^32
_ONE = 0x3FF0000000000000
_MANTISSA = 0x000FFFFFFFFFFFFF
_EXPONENT_1 = 0x0010000000000000  # one more in the exponent

# of 2^52; with an integer k < 2^52 in the mantissa, these are the bits of 2^52 + k
_TWO_52 = 0x4330000000000000
_HALF_LOG_2 = 0.34657359027997264  # log(2) / 2

_RECIPROCAL = (2.955511829448898, -2.889776453422684, 0.9349031257061479)
"""1/d to 1.3e-3, d in [1 + sqrt(1/2), 1 + sqrt(2)] / 2: 1 - d y(d) is Chebyshev's of degree 3."""

_ARTANH = (
    0.3333333333333335,
    0.199999999999497525,
    0.142857143129877435,
    0.1111110556739754,
    0.090914445626308615,
    0.07665860800278021,
    0.07308224842521703,
)
"""(artanh(s) / s - 1) / s^2 as a polynomial in s^2, for |s| <= 0.1716, to 2^-57."""


@jax.custom_jvp
def log(x: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """`jax.numpy.log` of positive normal numbers, to 3 units in the last place."""
    return _by_platform(lambda x: 2 * _half_log(x), jnp.log, x)


@log.defjvp
def _log_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return log(x), x_dot / x


@jax.custom_jvp
def half_x_log_x(x: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """x log(x) / 2, and 0 at 0: r^2 log r of x = r^2. Below round-off squared the slope is
    constant.
    """
    return _by_platform(lambda x: x * _half_log(x), lambda x: 0.5 * x * jnp.log(_not_zero(x)), x)


@half_x_log_x.defjvp
def _half_x_log_x_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return half_x_log_x(x), 0.5 * (log(_not_zero(x)) + 1) * x_dot


def _not_zero(x):
    """x, but at least the square of round-off at unit size."""
    # A `where` on x > 0 is not safe. A compiler may compute the distance of a point from itself
    # twice: once as 0, and once, with a fused multiply-add, as a rounding error.
    return jnp.maximum(x, float(jnp.finfo(x.dtype).eps) ** 2)


def _by_platform(in_polynomials, otherwise, x):
    if x.dtype != jnp.float64:
        return otherwise(x)
    if is_for_cpu():
        return in_polynomials(x)
    return jax.lax.platform_dependent(x, cpu=in_polynomials, default=otherwise)


def _half_log(x):
    """log(x) / 2 for positive normal numbers; else a number below 373."""
    # x = 2^k m with m in [sqrt(1/2), sqrt(2)), f = (m - 1) / 2, s = (m - 1) / (m + 1). The half in
    # f costs nothing here, and a thin plate spline needs it.
    bits = jax.lax.bitcast_convert_type(x, jnp.uint64) + jnp.uint64(_ONE - _ROOT_HALF)
    k = _float(bits >> jnp.uint64(52) | jnp.uint64(_TWO_52)) - (2.0**52 + 1023)
    m = _float((bits & jnp.uint64(_MANTISSA)) + jnp.uint64(_ROOT_HALF - _EXPONENT_1))  # half of it
    f = m - 0.5
    d = m + 0.5
    y = _horner(_RECIPROCAL, d)
    e = 1 - d * y
    y = y + y * (e + e * e)
    s = f * y
    s = s + y * (f - d * s)
    return k * _HALF_LOG_2 + s * _horner((1.0, *_ARTANH), s * s)


def _horner(coefficients, x):
    result = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        result = coefficient + x * result
    return result


def _float(bits):
    return jax.lax.bitcast_convert_type(bits, jnp.float64)
