"""Methods that compute something for each point once, such as barycentric coordinates."""

import abc

from jaxtyping import Array, Float, PyTree

from .base import AbstractMethod


class AbstractPlacing(AbstractMethod):
    """A method that computes something for each point once per base mesh: its place.

    Arguments are as in `AbstractMethod`. In `place` and `carry_place`, `ids` is what `connect`
    returned for the point. The field gets the point's place as its `ids`. `carry` and `carry_place`
    say what changes on the mesh after a step of `march`. By default the solve is new and points
    keep their places, for a graph stands on the undeformed mesh.
    """

    @abc.abstractmethod
    def place(self, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]) -> PyTree:
        """Computes the place of a point: its ids, and numbers that do not depend on `u`. Traced."""

    def carry(self, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], points: Float[Array, "n d"]) -> PyTree:
        """Computes factors on the mesh after a step of `march`, by default with `fit`. Traced.

        Factors that belong to the places of points stay as they are.
        """
        return self.fit(ids, surface, points)

    def carry_place(
        self, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], placed: PyTree
    ) -> PyTree:
        """Changes a point's place after a step of `march`; it stays by default. Traced."""
        return placed


def place(
    method: AbstractMethod, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]
) -> PyTree:
    """Computes a point's place by any method: its ids where the method needs no more."""
    return method.place(x, ids, factors, surface) if isinstance(method, AbstractPlacing) else ids


def carry(
    method: AbstractMethod, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], points: Float[Array, "n d"]
) -> PyTree:
    """Computes any method's factors on the mesh after a step of `march`."""
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
    """Changes a point's place by any method, on the mesh after a step of `march`."""
    return method.carry_place(x, ids, factors, surface, placed) if isinstance(method, AbstractPlacing) else placed
