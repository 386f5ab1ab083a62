"""Solvers of the interpolation system (eq. 3): dense, or by conjugate gradients."""

import equinox as eqx
from jaxtyping import Array, Float

from ..._host.package.arguments import whole
from ..._kernels.module import Module
from ..numbers import number

DENSE, SHARE = (1000, 6000), 6
"""Least and greatest number of sources that are solved densely by default.

Between them it is one source of every `SHARE`.
"""


class Direct(Module):
    """Factors the dense system once per plan.

    It takes 8 s^2 bytes and a time proportional to s^3 for s sources: 0.5 GB for 8,000. Each
    displacement then costs little.
    """


class Iterative(Module):
    """Solves by conjugate gradients without the matrix.

    For s sources the memory grows with s, the time with s^2.

    A displacement takes 10 to 20 products with the kernel, and so does a gradient. The
    preconditioner is a sparse factor of the inverse (Faul, Goodsell and Powell, IMA Journal of
    Numerical Analysis 25, 2005). Sources are ordered from far apart to close (Schaefer, Katzfuss
    and Owhadi, SIAM Journal on Scientific Computing 43, 2021). A source carries the function that
    is 1 at its place and 0 at the nearest sources before it. The first sources are solved densely.

    The system is symmetric, so its solve serves derivatives too. `prepare` finds sources and
    neighbours, and `refit` does not change them. Where no solve converges, `prepare` raises. A
    field is NaN if it misses its sources by a thousand tolerances, or by a thousandth of the
    displacement where that is less.

    **Arguments:**

    - `tolerance`: the distance by which the field misses its sources when a solve ends, relative to
      the largest displacement; also the error in the norm of the basis. Default 1e-10; 1.2e-5 at
      least in single precision.
    - `neighbours`: sources in each function's small system. More of them take fewer products, and
      more time and memory to prepare. Default 100.
    - `dense`: the number of first sources that are solved densely. Default None: a sixth of all
      sources, but 1,000 at least and 6,000 at most.

    **Raises:** `ValueError` for a tolerance that is not between 0 and 1, and for fewer than 8
    neighbours or dense sources.
    """

    tolerance: Float[Array, ""] = eqx.field(converter=number("tolerance", 0, 1), default=1e-10)
    neighbours: int = eqx.field(static=True, default=100)
    dense: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        whole("neighbours", self.neighbours, 8)
        if self.dense is not None:
            whole("dense", self.dense, 8)

    def dense_count(self, count: int) -> int:
        """Returns how many of `count` sources are solved densely."""
        fewest, most = DENSE
        return min(count, min(max(fewest, count // SHARE), most) if self.dense is None else self.dense)
