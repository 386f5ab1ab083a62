"""Exact surface reconstruction: a coarse field and a correction (section 2.3 of the paper)."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from .._host.sources.reduction import KDTree
from .base import (
    AbstractField,
    AbstractMethod,
    AbstractPlacing,
    AbstractWhole,
    Control,
    Remainder,
    Rows,
    check_kind,
    has_part,
)
from .blocks import map_points, place_points
from .corrections import DelaunayGraph, NearWall, begun_graph
from .rbf.fitted import FittedRBF
from .rbf.rbf import RBF
from .surface import Surface


class OfBoth(eqx.Module):
    """Ids, factors or places of the coarse field and of the correction, where the surface has them
    also ids or places of the coarse field at its rows.
    """

    coarse: PyTree
    correction: PyTree
    at_surface: PyTree = None


class SurfaceReconstruction(AbstractPlacing):
    """Corrects a coarse field by its offset on the surface (eq. 5): the paper's method.

    u = u_coarse + correction of (u_surface - u_coarse at the surface). Any two methods combine. The
    surface is exact if the correction is exact on it. With a linear correction several steps
    (section 3.2 of the paper) equal one step.

    **Arguments:**

    - `coarse`: the method everywhere. Default `FittedRBF()`.
    - `correction`: the method that carries the offset. Default `NearWall()`.
    """

    coarse: AbstractMethod = eqx.field(default_factory=FittedRBF)
    correction: AbstractMethod = eqx.field(default_factory=NearWall)

    def __check_init__(self):
        check_kind(self.coarse, AbstractMethod, "coarse", "jm.RBF()")
        check_kind(self.correction, AbstractMethod, "correction", "jm.NearWall()")

    @classmethod
    def published(cls, leaves: int = 64, fixed_leaves: int = 16) -> "SurfaceReconstruction":
        """Returns the paper's method: sources by a k-d tree, corrected by the Delaunay graph alone.

        Its walls should be convex: a graph lays chords over concave walls.

        **Arguments:**

        - `leaves`: leaves of the tree on the moving nodes; a leaf has up to 4 sources (2-D) or 8
          (3-D). Default 64.
        - `fixed_leaves`: leaves of the tree on the fixed nodes. Default 16.

        **Returns:** a `SurfaceReconstruction`.
        """
        return cls(
            RBF(reduction=KDTree(leaves), fixed_reduction=KDTree(fixed_leaves)), DelaunayGraph()
        )

    @property
    def exact(self) -> bool:
        return self.correction.exact

    @property
    def needs_cells(self) -> bool:
        return self.coarse.needs_cells or self.correction.needs_cells

    @property
    def linear(self) -> bool:
        return self.coarse.linear and self.correction.linear

    def connect(self, surface: Surface, points):
        if len(points) > (surface.nodes >= 0).sum() and has_part(self.correction, DelaunayGraph):
            begun_graph(surface)
        everywhere, more = surface.among(points)
        coarse, coarse_ids = self.coarse.connect(everywhere, more)
        coarse_at_points = jax.tree.map(lambda leaf: leaf[: len(points)], coarse_ids)
        coarse_at_surface = jax.tree.map(lambda leaf: leaf[everywhere.nodes], coarse_ids)
        surface = everywhere.altered(
            nodes=surface.nodes, matched=self.coarse.control(coarse).matched
        )
        correction, correction_at_points = self.correction.connect(surface, points)
        ids = OfBoth(coarse, correction, at_surface=coarse_at_surface)
        return ids, OfBoth(coarse_at_points, correction_at_points)

    def fit(self, ids, surface, points):
        coarse = self.coarse.fit(ids.coarse, surface, points)
        at_surface = place_points(self.coarse, surface, ids.at_surface, coarse, surface)
        correction = self.correction.fit(ids.correction, surface, points)
        return OfBoth(coarse, correction, at_surface)

    def carry(self, ids, factors, surface, points):
        coarse = self.coarse.carry(ids.coarse, factors.coarse, surface, points)
        correction = self.correction.carry(ids.correction, factors.correction, surface, points)
        return OfBoth(coarse, correction, factors.at_surface)

    def place(self, x, ids, factors, surface):
        coarse = self.coarse.place(x, ids.coarse, factors.coarse, surface)
        return OfBoth(coarse, self.correction.place(x, ids.correction, factors.correction, surface))

    def carry_place(self, x, ids, factors, surface, placed):
        coarse = self.coarse.carry_place(x, ids.coarse, factors.coarse, surface, placed.coarse)
        correction = self.correction.carry_place(
            x, ids.correction, factors.correction, surface, placed.correction
        )
        return OfBoth(coarse, correction)

    def control(self, ids):
        coarse = self.coarse.control(ids.coarse)
        correction = self.correction.control(ids.correction)
        return Control(np.concatenate([coarse.sources, correction.sources]), correction.matched)

    def check(self, ids, factors, u):
        self.coarse.check(ids.coarse, factors.coarse, u)
        self.correction.check(ids.correction, factors.correction, u)

    def field(self, ids, factors, surface, u):
        coarse = self.coarse.field(ids.coarse, factors.coarse, surface, u)
        left = self._remainder(coarse, factors, surface, u)
        return SumField(
            coarse, self.correction.correct(ids.correction, factors.correction, surface, left)
        )

    def offset(self, ids, factors, surface, u):
        """Computes the surface displacement that is left to the correction (eq. 5). Traced."""
        coarse = self.coarse.field(ids.coarse, factors.coarse, surface, u)
        return self._remainder(coarse, factors, surface, u).offset

    def _remainder(self, coarse: AbstractField, factors: OfBoth, surface: Rows, u: Rows):
        offset = u - map_points(coarse, surface, factors.at_surface)  # eq. (5)
        return Remainder(u, offset, coarse if factors.at_surface is None else None)


class SumField(AbstractWhole):
    coarse: AbstractField
    correction: AbstractField

    def __call__(self, x, ids: OfBoth):
        return self.coarse(x, ids.coarse) + self.correction(x, ids.correction)

    def evaluate(self, points, ids: OfBoth):
        coarse = map_points(self.coarse, points, ids.coarse)
        return coarse + map_points(self.correction, points, ids.correction)


def sees_free_sides(method: AbstractMethod) -> bool:
    """Checks whether a method is or has a `FittedRBF`, whose field depends on `Surface.is_open`."""
    return has_part(method, FittedRBF)
