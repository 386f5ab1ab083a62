"""A coarse field that follows the body: radial basis functions fitted to the wall, strained as little as possible."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._host.package.rounding import SAME, roundoff
from ..._host.sources.farthest import Filled
from ..._host.sources.reduction import KDTree, drop_close
from ..._host.surface.sharp import behind_tips, beside_tips, sharp_tips
from ..._host.surface.skin import drawn_in, edges, has_free_sides, nearest_held, thicknesses, thinned
from ..._kernels.values import as_jax, norm
from ..base import AbstractMethod, Control, Surface, check_kind
from ..numbers import length_or_none
from .rbf import RBF, RBFFactors
from .solvers import Direct
from .system import polynomial

ELL, MU = {2: 0.17, 3: 0.07}, {2: 0.1, 3: 0.4}
"""Defaults of `ell` and `mu` by dimension, relative to the mean chord of the wall.

A body that twists in 3-D pays for every large rotation, so less of it is asked for there.
"""

THIN = 2.25
"""Largest default of `ell`, relative to the mean thickness of a closed wall in 2-D.

Both sides of a thin body may change in opposite senses.
"""

JOINT = 0.05
"""Largest `ell`, relative to the distance of the nearest node that is fixed or of another wall."""

BEHIND, BEYOND_TIP = 0.02, 0.2
"""Distance of the source behind a sharp tip, relative to the mean chord, or to that of the nearest held node if that is less.

Its largest distance is `BEYOND_TIP`, relative to the same.
"""

SOURCES_ALONE = 64
"""Fewest leaves of the k-d tree if the field interpolates instead of being fitted."""

AT_TIP = 0.03, 0.5
"""Distance from a sharp tip, and `mu` there, both relative to the mean chord: the field follows the wall's slope at the tip.

Cells at a sharp tip are small, and the wall's angle there changes with the thickness.
"""

ROWS = {2: 4096, 3: 2048}
"""Most nodes of the wall, and most edges, that enter the fit, by dimension."""


class FittedRBF(AbstractMethod):
    """Fits radial basis functions that follow the body instead of its skin; a coarse field, made to be corrected.

    `RBF` takes the wall's displacement u at its sources. This method chooses the values v at the moving sources; those at the
    fixed ones are u. The field c_v is then the best fit, in least squares over nodes i and edges e of the moving walls:

        mean_i |c_v - u|^2  +  mean_e mu^2 |d/ds (c_v - u)|^2  +  mean_e ell^2 2 |dev sym grad c_v|^2

    d/ds is the derivative along an edge, and dev sym grad the deviatoric strain at its middle. The first two terms follow
    value and slope along the wall. The third lets the field carry the body as rigidly as they allow. So grid lines stay at
    right angles to the wall, and a change of one side of a thin body does not go on beyond its other side. The change of the
    skin itself is left to the correction. If the whole surface moves by an affine motion, the field is that motion: strain is
    measured from the affine motion that fits the surface's displacement best.

    A thin plate spline carries a slope that the body keeps on to the far field: at 500 chords a bump moves nodes by several
    times its height. So where fixed sources are farther away than about 45 chords, the field comes to rest at 20 and 40 chords:
    all but the walls' mean displacement, and affine motions of the whole.

    A thin plate spline turns abruptly behind a sharp trailing edge, within the first cell there. So in 2-D a sharp tip of a wall
    has a fixed source behind it: its displacement is the wall's own, continued straight on. Six moving ones stand beside it, at
    0.002 to 0.032 of the chord: cells there are so small that a wavy field inverts them. Tips of less than 60 degrees are sharp.

    A free side is a side of the mesh that is neither moving, fixed nor a symmetry plane. A field that turns with the body
    would carry it out of its plane. A mesh with a free side gets the interpolation of many sources instead of the fit. So do
    points without faces: they show neither sharp edges nor which nodes are neighbours.

    **Arguments:**

    - `rbf`: basis and sources. By default the moving sources are those of 16 leaves of a k-d tree, 32 if another boundary is
      near, and then the nodes farthest from them: 84 in 2-D, 400 in 3-D.
    - `ell`: the length that weighs strain, in the mesh's units. A large one keeps the wall's lines at right angles, a small one
      follows the skin. It is nowhere more than 0.05 of the distance to the nearest node that is held or of another wall.
      Default 0.17 of each wall's mean chord, half of its perimeter, but at most 2.25 of its mean thickness. In 3-D it is 0.07
      of half of the wall's area over its span.
    - `mu`: the length that weighs the slope along the wall, in the mesh's units. Default 0.1 of each wall's mean chord, and 0.5
      within 0.03 chords of a sharp tip. In 3-D it is 0.4.

    Walls of more than 4,096 nodes or edges, in 3-D 2,048, are sampled.

    The fit is linear in u. It costs a dense factorisation of d s unknowns once per plan, for s moving sources.
    """

    rbf: RBF = eqx.field(default_factory=lambda: RBF(reduction=Filled()))
    ell: Float[Array, ""] | None = eqx.field(default=None, converter=length_or_none("ell"))
    mu: Float[Array, ""] | None = eqx.field(default=None, converter=length_or_none("mu"))

    def __check_init__(self):
        check_kind(self.rbf, RBF, "rbf", "jm.RBF()")
        if self.rbf.solver is not None and not isinstance(self.rbf.solver, Direct):
            raise ValueError(
                f"FittedRBF factors its dense system: `rbf` with solver={type(self.rbf.solver).__name__}() is for RBF alone."
            )

    @property
    def exact(self) -> bool:
        return False

    def connect(self, surface: Surface, points):
        is_open = surface.is_open
        if surface.faces is None:
            is_open = True
        elif is_open is None:
            is_open = has_free_sides(surface.points, surface.rows(len(points)) == len(surface.points), points)
        # The ids depend on the surface alone, so all pieces of a mesh share them. A method with array leaves has no hash:
        # its id is the key, and the entry holds the method itself, so that no other object can get that id.
        key = ("fitted", id(self), bool(is_open))
        return surface.once(key, lambda: (self, self._ids(surface, is_open)))[1], None

    def _ids(self, surface: Surface, is_open: bool) -> "WallIds":
        if is_open:
            return self._sources_alone(surface, self._denser.chosen(surface))
        sources = self.rbf.chosen(surface)
        is_moving = sources < surface.moving
        return self._wall(surface, sources[is_moving], sources[~is_moving])

    def _closest(self, surface: Surface) -> float:
        return self.rbf.reduction.closest(surface.points[: surface.moving])

    @property
    def _denser(self) -> RBF:
        """The field for meshes with free sides and points alone: as many sources as an interpolation needs."""
        reduction = self.rbf.reduction
        if isinstance(reduction, KDTree | Filled) and reduction.leaves is not None:
            reduction = dataclasses.replace(reduction, leaves=max(SOURCES_ALONE, reduction.leaves), crowded=None)
        return RBF(self.rbf.basis, reduction, self.rbf.fixed_reduction, self.rbf.degree)

    def _sources_alone(self, surface: Surface, sources: np.ndarray) -> "WallIds":
        """Makes ids without edges: the field is then the interpolation."""
        moving, fixed = sources[sources < surface.moving], sources[sources >= surface.moving]
        none = np.zeros((0, 2))
        each_row = (moving, fixed, moving, none, none[:, 0], none, none[:, 0], np.zeros((0, 3)))
        return WallIds(*as_jax([each.astype(np.int32) for each in each_row]), *[jnp.zeros(0)] * 3)

    def _wall(self, surface: Surface, moving: np.ndarray, fixed: np.ndarray) -> "WallIds":
        dimension = surface.points.shape[1]
        pairs = edges(surface.points, surface.moving, surface.faces)
        wall, ends, share = surface.walls
        chord = share * np.linalg.norm(np.subtract(*surface.points[ends.T]), axis=1)
        tips, sharp = np.zeros((0, 3)), np.zeros((0, dimension))
        if dimension == 2:
            beside, tips, sharp = self._at_tips(surface, pairs, chord[wall[pairs[:, 0]]])
            moving = drop_close(surface.points, np.concatenate([moving, beside]), roundoff(surface.points))
        nodes = np.union1d(
            thinned(surface.points[: surface.moving], ROWS[dimension]), moving
        )  # regular: each source has its own row
        pairs = pairs[thinned(surface.points[pairs].mean(axis=1), ROWS[dimension])]
        label = wall[pairs[:, 0]]
        held = nearest_held(surface.points, surface.moving, wall, pairs)
        far, reach = drawn_in(surface.points, moving, fixed, surface.images)
        each_row = (moving, fixed, nodes, pairs, held, ends[label], far, tips)
        ell, mu = (length[label] for length in default_lengths(surface.points, wall, surface.faces, ends, share))
        near, largest = AT_TIP
        for tip in sharp:
            distance = np.linalg.norm(surface.points[pairs].mean(axis=1) - tip, axis=1)
            mu = np.where(distance < near * chord[label] * (1 - SAME), largest * share[label], mu)
        return WallIds(*as_jax([*(each.astype(np.int32) for each in each_row), ell, mu, reach]))

    def _at_tips(
        self, surface: Surface, pairs: np.ndarray, chord: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Finds sources (k,) beside sharp tips in 2-D, sharp tips (g, 3) with a node on either side, and all tips' places (h, 2).

        `pairs` are all edges of the moving walls: a tip lies between two. `chord` (e,) is that of each edge's wall. A source
        stands behind the g tips.
        """
        held = nearest_held(surface.points, surface.moving, surface.walls[0], pairs)
        distance = np.linalg.norm(surface.points[pairs].mean(axis=1) - surface.points[held], axis=1)
        room = np.where(held == pairs[:, 0], chord, np.minimum(chord, distance))
        walls = sharp_tips(surface.points, pairs)
        behind = behind_tips(walls, BEHIND * room, self._closest(surface), BEYOND_TIP * room)
        return beside_tips(walls, chord), behind, walls.points[walls.tips]

    def control(self, ids):
        sources = np.concatenate([np.asarray(ids.moving), np.asarray(ids.fixed)])
        return Control(sources, np.asarray(ids.fixed) if len(ids.edges) else sources)

    def check(self, ids, factors: "FitFactors", u):
        more = np.zeros((len(ids.far) + len(ids.tips), u.shape[1]), u.dtype)
        values = as_jax(np.concatenate([np.asarray(u)[self.control(ids).sources], more]))
        self.rbf.check(np.arange(len(values)), factors.rbf, values)

    def fit(self, ids: "WallIds", surface, points):
        sources = _sources(ids, surface)
        rbf = self.rbf.fit(jnp.arange(len(sources)), sources, points)
        if not len(ids.edges):
            return FitFactors(rbf, *(jnp.zeros((0,) * rank, sources.dtype) for rank in (2, 2, 4, 1, 2, 2, 2, 2)))
        surface = surface.astype(rbf.lu.dtype)
        count, moves, dimension = len(rbf.sources), len(ids.moving), surface.shape[1]
        start, end = surface[ids.edges[:, 0]], surface[ids.edges[:, 1]]
        middle, along = (start + end) / 2, end - start
        length = jnp.sqrt(jnp.sum(along**2, axis=1))
        cardinal = rbf.solve(jnp.eye(len(rbf.lu), count, dtype=surface.dtype))

        def derivative(axis):
            direction = jnp.broadcast_to(jnp.eye(dimension, dtype=surface.dtype)[axis], middle.shape)
            return jax.jvp(lambda x: self.rbf.rows(rbf, x), (middle,), (direction,))[1]

        value = _product(self.rbf.rows(rbf, surface[ids.nodes]), cardinal)
        slopes = jnp.stack([_product(derivative(axis), cardinal) for axis in range(dimension)], axis=1)
        slope = jnp.einsum("ea,eas->es", along / length[:, None], slopes, precision="highest")
        ell, mu = self._lengths(ids, surface, middle)
        node, edge = 1 / len(value), 1 / max(1, len(slope))
        follow = _product(value[:, :moves].T * node, value) + _product(slope[:, :moves].T * (edge * mu**2)[None], slope)
        matrix = _system(follow, slopes * (ell * edge**0.5)[:, None, None])
        inner, outer = matrix[..., :moves], matrix[..., moves:]
        inner = inner.reshape(dimension * moves, -1)
        scale = 1 / jnp.sqrt(jnp.diagonal(inner))
        lower = jnp.linalg.cholesky(inner * scale[:, None] * scale[None])
        of_edges = (slope * (edge * mu**2 / length)[:, None])[:, :moves]
        affine = _affine(self.rbf, rbf, surface)
        ring = polynomial(rbf.sources[moves + len(ids.fixed) :], self.rbf.degree)[: len(ids.far)]
        return FitFactors(rbf, node * value[:, :moves], of_edges, outer, scale, lower, *affine, ring)

    def _lengths(self, ids: "WallIds", surface, middle):
        """Computes ell and mu at each edge."""
        span = norm(surface[ids.ends[:, 0]] - surface[ids.ends[:, 1]])
        ell, mu = (
            share.astype(surface.dtype) * span if given is None else jnp.full_like(span, given)
            for share, given in ((ids.ell, self.ell), (ids.mu, self.mu))
        )
        free = ids.held == ids.edges[:, 0]
        return jnp.where(free, ell, jnp.minimum(ell, JOINT * norm(surface[ids.held] - middle))), mu

    def field(self, ids: "WallIds", factors: "FitFactors", surface, u):
        values = u.astype(factors.rbf.lu.dtype)
        if not len(ids.edges):  # an interpolation: fitting it to its own sources would lose half of the digits
            return self.rbf.through(factors.rbf, jnp.concatenate([values[ids.moving], values[ids.fixed]]), u.dtype)
        affine = self._affine_part(factors, values)
        rest = values - _product(factors.polynomial, affine)
        difference = rest[ids.edges[:, 1]] - rest[ids.edges[:, 0]]
        wanted = _product(factors.nodes.T, rest[ids.nodes]) + _product(factors.edges.T, difference)
        fixed = jnp.concatenate([rest[ids.fixed], _at_rings(ids, rest), _behind_tips(ids, rest)])
        wanted = wanted.T - jnp.einsum("aicj,jc->ai", factors.outer, fixed, precision="highest")
        solved = jax.scipy.linalg.cho_solve((factors.lower, True), wanted.ravel() * factors.scale) * factors.scale
        moving = solved.reshape(wanted.shape).T + _product(factors.polynomial[ids.moving], affine)
        ring = _product(factors.ring, affine) + _at_rings(ids, rest)
        everything = jnp.concatenate([moving, values[ids.fixed], ring, _behind_tips(ids, values)])
        return self.rbf.through(factors.rbf, everything, u.dtype)

    def _affine_part(self, factors: "FitFactors", values):
        """Finds the coefficients (p, d) of the affine motion nearest to the surface's displacement."""
        moments = _product(factors.polynomial.T, values)
        return jax.scipy.linalg.cho_solve((factors.moments, True), moments)


class WallIds(eqx.Module):
    """Rows of the surface: sources, nodes and edges of the fit; for each edge the nearest held row and two ends of its wall.

    `ell` and `mu` are the default lengths at each edge, relative to the distance of these ends.

    `far` are fixed sources so far away that more of them rest nearer to the walls, at the share `reach` of the way to them.
    `tips` are sharp tips of the walls, each with a node on either side.
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


class FitFactors(eqx.Module):
    """The solve of the sources, weighted rows of the fit, its factored system, and that of the affine part."""

    rbf: RBFFactors
    nodes: Float[Array, "k s"]
    edges: Float[Array, "e s"]
    outer: Float[Array, "d s d t"]
    scale: Float[Array, " ds"]
    lower: Float[Array, "ds ds"]
    polynomial: Float[Array, "b p"]
    moments: Float[Array, "p p"]
    ring: Float[Array, "r p"]


def default_lengths(points, wall, faces, ends, share) -> tuple[np.ndarray, np.ndarray]:
    """Computes the defaults of ell and mu of each wall (w,), relative to the distance of its ends, on the host."""
    dimension = points.shape[1]
    ell = ELL[dimension] * share
    if dimension == 2:
        ell = np.minimum(ell, THIN * thicknesses(points, wall, faces, ends))
    return ell, MU[dimension] * share


def _sources(ids: WallIds, surface: Float[Array, "b d"]) -> Float[Array, "s d"]:
    """Computes the places of the moving and fixed sources, of the rings between them, and behind sharp tips."""
    moving, fixed = surface[ids.moving], surface[ids.fixed]
    centre = moving.mean(axis=0)[None]
    ring = centre + ids.reach.astype(surface.dtype)[:, None] * (surface[ids.far] - centre)
    return jnp.concatenate([moving, fixed, ring, _behind_tips(ids, surface)])


def _behind_tips(ids: WallIds, values: Float[Array, "b d"]) -> Float[Array, "g d"]:
    """Continues places or displacements of the walls behind their tips: the mirror image in the tip, right for affine motions."""
    tip, first, second = ids.tips.T
    return 2 * values[tip] - (values[first] + values[second]) / 2


def _at_rings(ids: WallIds, values: Float[Array, "b d"]) -> Float[Array, "r d"]:
    """Computes what the rings keep of the walls' mean displacement: a body that is carried far away takes them along.

    It is the share of the deflection of a plate that is held at the far field and pushed in the middle.
    """
    mean, squared = values[ids.moving].mean(axis=0), ids.reach.astype(values.dtype) ** 2
    return (1 - squared + squared * jnp.log(squared))[:, None] * mean[None]


def _system(follow: Float[Array, "m s"], slopes: Float[Array, "e d s"]) -> Float[Array, "d m d s"]:
    """Assembles the normal equations of the first m sources, which move.

    They hold `follow` for each component, and 2 |dev sym G|^2 = G:G + G:G^T - 2/d (tr G)^2.
    """
    (count, d, s), m = slopes.shape, len(follow)
    moving = slopes[:, :, :m].reshape(count, d * m)
    strain = _product(moving.T, slopes.reshape(count, d * s)).reshape(d, m, d, s)
    each = follow + sum(strain[b, :, b] for b in range(d))
    same = jnp.einsum("ac,ij->aicj", jnp.eye(d, dtype=follow.dtype), each)
    return same + strain.transpose(2, 1, 0, 3) - (2 / d) * strain


def _affine(method: RBF, rbf: RBFFactors, surface: Float[Array, "b d"]):
    """Evaluates the polynomial's terms at the surface, and factors the matrix of their moments."""
    terms = polynomial((surface - rbf.centre[None]) * rbf.scale, method.degree)
    return terms, jnp.linalg.cholesky(_product(terms.T, terms))


def _product(a: Float[Array, "m k"], b: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return jnp.matmul(a, b, precision="highest")
