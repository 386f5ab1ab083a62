"""Motion of a wall by some design variables."""

import abc

import equinox as eqx
from jaxtyping import Array, Float


class AbstractPart(eqx.Module):
    """The displacement by some design variables; `rows` are their places among all values."""

    rows: eqx.AbstractVar[tuple[int, ...]]

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "m d"], values: Float[Array, " k"]) -> Float[Array, "m d"]:
        """Computes displacements (m, d) of a wall at `x`."""
