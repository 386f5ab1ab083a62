"""Methods whose field needs of each point what its own place gives, such as barycentric coordinates."""

import abc

from jaxtyping import Array, Float, PyTree

from .base import AbstractMethod


class AbstractPlacing(AbstractMethod):
    """A method that places each point once per base mesh: what its place gives is ready before any displacement comes.

    Arguments are those of `AbstractMethod`; `ids` in `place` and `carry_place` is what `connect` returned for the point. The field
    then gets for each point what `place` made of it. On the mesh that a step of `march` left, `carry` and `carry_place` say what
    changes. By default the solve is new and points keep their places, for a graph stands on the undeformed mesh.
    """

    @abc.abstractmethod
    def place(self, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]) -> PyTree:
        """Adds to a point's ids what its own place gives, whatever `u` is. Traced."""

    def carry(self, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], points: Float[Array, "n d"]) -> PyTree:
        """Computes factors on the mesh that a step of `march` left; those of `fit` by default. Traced.

        What goes with the places that points keep stays as it is.
        """
        return self.fit(ids, surface, points)

    def carry_place(
        self, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], placed: PyTree
    ) -> PyTree:
        """Changes what `place` returned for a point, on the mesh that a step of `march` left; by default it stays. Traced."""
        return placed


def place(
    method: AbstractMethod, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]
) -> PyTree:
    """Places a point by any method: the ids themselves where the method needs no more."""
    return method.place(x, ids, factors, surface) if isinstance(method, AbstractPlacing) else ids


def carry(
    method: AbstractMethod, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], points: Float[Array, "n d"]
) -> PyTree:
    """Computes any method's factors on the mesh that a step of `march` left."""
    if isinstance(method, AbstractPlacing):
        return method.carry(ids, factors, surface, points)
    return method.fit(ids, surface, points)


def carry_place(
    method: AbstractMethod,
    x: Float[Array, " d"],
    ids: PyTree,
    factors: PyTree,
    surface: Float[Array, "b d"],
    placed: PyTree,
) -> PyTree:
    """Changes, by any method, what its `place` returned for a point, on the mesh that a step of `march` left."""
    return method.carry_place(x, ids, factors, surface, placed) if isinstance(method, AbstractPlacing) else placed
