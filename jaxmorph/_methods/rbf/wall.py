"""The wall as `FittedRBF` sees it: sources, nodes and edges of the fit, sharp tips."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._host.package.rounding import SAME, roundoff
from ..._host.sources.separation import drop_close
from ..._host.surface.sharp import behind_tips, beside_tips, sharp_tips
from ..._host.surface.skin import drawn_in, edges, nearest_held, thicknesses, thinned
from ..._kernels.values import as_jax
from ..surface import Surface

ELL, MU = {2: 0.17, 3: 0.07}, {2: 0.1, 3: 0.4}
"""Defaults of `ell` and `mu` by dimension, relative to the mean chord of the wall.

A body that twists in 3-D pays for every large rotation, so less of it is asked for there.
"""

THIN = 2.25
"""Largest default of `ell`, relative to the mean thickness of a closed wall in 2-D.

Both sides of a thin body may change in opposite senses.
"""

BEHIND, BEYOND_TIP = 0.02, 0.2
"""Distance of the source behind a sharp tip, and its largest distance.

Both are relative to the mean chord, or to the distance of the nearest held node if that is less.
"""

AT_TIP = 0.03, 0.5
"""Distance from a sharp tip, and `mu` there, both relative to the mean chord.

The field follows the wall's slope at the tip.

Cells at a sharp tip are small, and the wall's angle there changes with the thickness.
"""

ROWS = {2: 4096, 3: 2048}
"""Most nodes of the wall, and most edges, that enter the fit, by dimension."""


class WallIds(eqx.Module):
    """Rows of the surface that a fit needs. A fit without edges is an interpolation.

    - `moving`, `fixed`: the sources.
    - `nodes`, `edges`: rows and pairs of rows at which the field follows the wall.
    - `held`: for each edge the nearest row that is fixed or of another wall, else the edge's first
      row.
    - `ends`: for each edge two ends of its wall.
    - `far`: fixed sources so far away that more of them rest nearer to the walls, at the share
      `reach` of the way to them.
    - `tips`: sharp tips of the walls, each with a node on either side.
    - `ell`, `mu`: the default lengths at each edge, relative to the distance of the wall's ends.
    """

    moving: Int[Array, " s"]
    fixed: Int[Array, " t"]
    nodes: Int[Array, " k"]
    edges: Int[Array, "e 2"]
    held: Int[Array, " e"]
    ends: Int[Array, "e 2"]
    far: Int[Array, " r"]
    tips: Int[Array, "g 3"]
    ell: Float[Array, " e"]
    mu: Float[Array, " e"]
    reach: Float[Array, " r"]

    @classmethod
    def without_edges(cls, surface: Surface, sources: np.ndarray) -> "WallIds":
        """Makes the ids of a field that interpolates."""
        moving, fixed = sources[sources < surface.moving], sources[sources >= surface.moving]
        none = np.zeros((0, 2))
        rows = (moving, fixed, moving, none, none[:, 0], none, none[:, 0], np.zeros((0, 3)))
        return cls(*as_jax([ids.astype(np.int32) for ids in rows]), *[jnp.zeros(0)] * 3)

    @classmethod
    def found(cls, surface: Surface, sources: np.ndarray, closest: float) -> "WallIds":
        """Finds the ids of a fit on the host; `closest` is how close two sources may come."""
        points, dimension = surface.points, surface.points.shape[1]
        moving, fixed = sources[sources < surface.moving], sources[sources >= surface.moving]
        pairs = edges(points, surface.moving, surface.faces)
        wall, ends, share = surface.walls
        chord = share * np.linalg.norm(np.subtract(*points[ends.T]), axis=1)
        tips, sharp = np.zeros((0, 3)), np.zeros((0, dimension))
        if dimension == 2:
            beside, tips, sharp = _at_tips(surface, pairs, chord[wall[pairs[:, 0]]], closest)
            moving = drop_close(points, np.concatenate([moving, beside]), roundoff(points))
        # each source has a row of its own, so that the system is regular
        nodes = np.union1d(thinned(points[: surface.moving], ROWS[dimension]), moving)
        pairs = pairs[thinned(points[pairs].mean(axis=1), ROWS[dimension])]
        label = wall[pairs[:, 0]]
        held = nearest_held(points, surface.moving, wall, pairs)
        far, reach = drawn_in(points, moving, fixed, surface.images)
        rows = (moving, fixed, nodes, pairs, held, ends[label], far, tips)
        ell, mu = (length[label] for length in default_lengths(points, wall, surface.faces, ends, share))
        near, largest = AT_TIP
        for tip in sharp:
            distance = np.linalg.norm(points[pairs].mean(axis=1) - tip, axis=1)
            mu = np.where(distance < near * chord[label] * (1 - SAME), largest * share[label], mu)
        return cls(*as_jax([*(ids.astype(np.int32) for ids in rows), ell, mu, reach]))

    def places(self, surface: Float[Array, "b d"]) -> Float[Array, "s d"]:
        """Computes the places of all sources: moving, fixed, on rings between, behind tips."""
        moving, fixed = surface[self.moving], surface[self.fixed]
        centre = moving.mean(axis=0)[None]
        ring = centre + self.reach.astype(surface.dtype)[:, None] * (surface[self.far] - centre)
        return jnp.concatenate([moving, fixed, ring, self.behind_tips(surface)])

    def behind_tips(self, values: Float[Array, "b d"]) -> Float[Array, "g d"]:
        """Continues places or displacements of the walls behind their tips.

        A place behind is the mirror image in the tip.

        It is right for affine motions.
        """
        tip, first, second = self.tips.T
        return 2 * values[tip] - (values[first] + values[second]) / 2

    def at_rings(self, values: Float[Array, "b d"]) -> Float[Array, "r d"]:
        """Computes the displacement of the rings, a share of the walls' mean displacement.

        So a body that is carried far away takes them along.

        It is the share of the deflection of a plate that is held at the far field and pushed in the
        middle.
        """
        mean, squared = values[self.moving].mean(axis=0), self.reach.astype(values.dtype) ** 2
        return (1 - squared + squared * jnp.log(squared))[:, None] * mean[None]


def default_lengths(points, wall, faces, ends, share) -> tuple[np.ndarray, np.ndarray]:
    """Computes the default ell and mu of each wall (w,), relative to the distance of its ends."""
    dimension = points.shape[1]
    ell = ELL[dimension] * share
    if dimension == 2:
        ell = np.minimum(ell, THIN * thicknesses(points, wall, faces, ends))
    return ell, MU[dimension] * share


def _at_tips(
    surface: Surface, pairs: np.ndarray, chord: np.ndarray, closest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds sources (k,) beside sharp tips in 2-D, and the tips.

    It returns the sources, the tips (g, 3) that get a source behind them, each with a node on
    either side, and the places (h, 2) of all tips.

    `pairs` are all edges of the moving walls: a tip lies between two. `chord` (e,) is that of each
    edge's wall. A source stands behind the g tips.
    """
    held = nearest_held(surface.points, surface.moving, surface.walls[0], pairs)
    distance = np.linalg.norm(surface.points[pairs].mean(axis=1) - surface.points[held], axis=1)
    room = np.where(held == pairs[:, 0], chord, np.minimum(chord, distance))
    walls = sharp_tips(surface.points, pairs)
    behind = behind_tips(walls, BEHIND * room, closest, BEYOND_TIP * room)
    return beside_tips(walls, chord), behind, walls.points[walls.tips]
