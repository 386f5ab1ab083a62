"""Exact surface reconstruction: a coarse field and a correction (section 2.3 of the paper)."""

import equinox as eqx
import jax
import numpy as np

from .._host.sources.reduction import KDTree
from .base import (
    AbstractField,
    AbstractMethod,
    AbstractPlacing,
    AbstractWhole,
    Control,
    Rows,
    check_kind,
    has_part,
)
from .blocks import map_points, place_points
from .corrections import DelaunayGraph, NearWall, begun_graph, turned_field
from .rbf.fitted import FittedRBF
from .rbf.rbf import RBF
from .surface import Surface


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
        return (coarse, coarse_at_surface, correction), (coarse_at_points, correction_at_points)

    def fit(self, ids, surface, points):
        coarse, at_surface, correction = ids
        factors = self.coarse.fit(coarse, surface, points)
        placed = place_points(self.coarse, surface, at_surface, factors, surface)
        return factors, placed, self.correction.fit(correction, surface, points)

    def carry(self, ids, factors, surface, points):
        coarse, _, correction = ids
        coarse_factors, placed, correction_factors = factors
        carried = self.coarse.carry(coarse, coarse_factors, surface, points)
        return (
            carried,
            placed,
            self.correction.carry(correction, correction_factors, surface, points),
        )

    def place(self, x, ids, factors, surface):
        coarse = self.coarse.place(x, ids[0], factors[0], surface)
        return coarse, self.correction.place(x, ids[1], factors[2], surface)

    def carry_place(self, x, ids, factors, surface, placed):
        coarse = self.coarse.carry_place(x, ids[0], factors[0], surface, placed[0])
        return coarse, self.correction.carry_place(x, ids[1], factors[2], surface, placed[1])

    def control(self, ids):
        coarse = self.coarse.control(ids[0])
        correction = self.correction.control(ids[2])
        return Control(np.concatenate([coarse.sources, correction.sources]), correction.matched)

    def check(self, ids, factors, u):
        self.coarse.check(ids[0], factors[0], u)
        self.correction.check(ids[2], factors[2], u)

    def field(self, ids, factors, surface, u):
        coarse, offset = self._split(ids, factors, surface, u)
        correction = self.correction
        if isinstance(correction, NearWall) and ids[1] is None:
            # the coarse field is known everywhere

            def at(places: Rows) -> Rows:
                return map_points(coarse, places, None)

            field = turned_field(correction, ids[2], factors[2], surface, (u, offset), at)
        else:
            field = correction.field(ids[2], factors[2], surface, offset)
        return SumField(coarse, field)

    def offset(self, ids, factors, surface, u):
        """Computes the surface displacement that is left to the correction (eq. 5). Traced."""
        return self._split(ids, factors, surface, u)[1]

    def _split(self, ids, factors, surface, u):
        coarse = self.coarse.field(ids[0], factors[0], surface, u)
        return coarse, u - map_points(coarse, surface, factors[1])  # eq. (5)


class SumField(AbstractWhole):
    first: AbstractField
    second: AbstractField

    def __call__(self, x, ids):
        return self.first(x, ids[0]) + self.second(x, ids[1])

    def evaluate(self, points, ids):
        return map_points(self.first, points, ids[0]) + map_points(self.second, points, ids[1])


def sees_free_sides(method: AbstractMethod) -> bool:
    """Checks whether a method is or has a `FittedRBF`, whose field depends on `Surface.is_open`."""
    return has_part(method, FittedRBF)
