"""A box in a box: control points that another shape carries."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from .._host.package.arguments import check_fields
from ._arguments import Numbers, positions
from ._freeform import FreeForm
from ._lattice import LatticeOperator
from ._shape import AbstractLinearShape, AbstractOperator


class ChildOperator(AbstractOperator):
    """Computes displacements of points from a parent and from a child's control points."""

    parent: AbstractOperator
    carrier: AbstractOperator
    child: LatticeOperator
    free: Bool[Array, "..."]
    inside: Bool[Array, " m"]

    def __call__(self, parameters: Sequence[Any]) -> Float[Array, "m d"]:
        if len(parameters) != 2:
            raise ValueError(f"{len(parameters)} sets of parameters; expected two, (parent's, child's).")
        of_parent, offsets = parameters
        carried = self.carrier(of_parent)
        offsets = jnp.asarray(offsets, carried.dtype)
        if offsets.shape != (*self.free.shape, carried.shape[1]):
            raise ValueError(
                f"control displacements have shape {offsets.shape}; the child needs {self.free.shape} points."
            )
        control = carried.reshape(offsets.shape) + jnp.where(self.free[..., None], offsets, 0)
        return jnp.where(self.inside[:, None], self.child(control), self.parent(of_parent))


class Child(AbstractLinearShape):
    """A box whose control points another shape carries, such as a flap's box in a wing's box.

    Boxes nest to any depth.

    Points in the child's box follow its control points, which move with the parent and by their own
    displacements. All other points follow the parent. The parent's motion is taken at Greville's
    abscissae, so a child reproduces affine motions of its parent to round-off. It follows any other
    motion as closely as its control points can: put its border between walls, not across a wall.
    The parameters are (parent's, child's).

    **Arguments:**

    - `child`: a box; what its `continuity` holds stays where the parent carries it.
    - `parent`: a linear shape, such as a box or another `Child`.

    **Raises:** `ValueError` for positions in another dimension, and for parameters of another
    shape.
    """

    child: FreeForm
    parent: AbstractLinearShape

    def __check_init__(self):
        check_fields(self)

    def neutral(self) -> tuple[PyTree, PyTree]:
        """Makes the parameters that move nothing."""
        return self.parent.neutral(), self.child.neutral()

    def at(self, x: Numbers) -> ChildOperator:
        """Computes the weights of positions (m, d) once."""
        x = positions(x)
        whole = FreeForm(self.child.origin, self.child.axes, self.child.counts, degree=self.child.degrees)
        anchors = whole.anchors().reshape(-1, len(whole.counts)).astype(x.dtype)
        inside = whole.holds(whole.coordinates(x))
        return ChildOperator(
            self.parent.at(x), self.parent.at(anchors), whole.at(x), jnp.asarray(self.child.free), inside
        )

    def lattice(self, parameters: PyTree) -> Float[Array, "..."]:
        """Computes the positions (*counts, d) of the child's control points."""
        of_parent, offsets = parameters
        anchors = self.child.anchors()
        carried = self.parent.at(anchors.reshape(-1, anchors.shape[-1]))(of_parent).reshape(anchors.shape)
        return self.child.lattice(carried + jnp.where(jnp.asarray(self.child.free)[..., None], jnp.asarray(offsets), 0))
