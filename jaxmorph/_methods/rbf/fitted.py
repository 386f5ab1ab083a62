"""A coarse field that follows the body: radial functions fitted to the wall."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._host.package.rounding import roundoff
from ..._host.sources.farthest import ENOUGH, Filled, farthest
from ..._host.sources.reduction import KDTree, drop_close
from ..._host.surface import skin
from ..._host.tolerances import SAME
from ..._kernels.values import Either, as_jax, jax_arrays, norm
from ..base import (
    AbstractMethod,
    Control,
    Pairs,
    Rows,
    Scalar,
    check_kind,
    einsum,
    matmul,
    number_or_none,
)
from ..surface import Surface
from .basis import Columns, Sources, Weights
from .expansion import RBFFactors
from .rbf import RBF, Direct
from .system import polynomial

# largest `ell`, relative to the distance of the nearest node that is fixed or of another wall
JOINT = 0.05
# fewest leaves of the k-d tree if the field interpolates instead of being fitted
SOURCES_ALONE = 64

ELL = 0.03
MU = {2: 0.1, 3: 0.4}
"""Defaults of `ell`, and of `mu` by dimension, relative to the mean chord of the wall."""

BEHIND = 0.02
BEYOND_TIP = 0.2
"""Distance of the source behind a sharp tip, and its largest distance, relative to the mean chord
or to the distance of the nearest held node, whichever is less.
"""

PLATE = 80
"""Radius at which rotation ends, relative to the root mean square radius of the walls."""

STRAIN_WEIGHT = 0.4
"""Weight of a wall's strain against its displacement in the affine motion that rings carry."""

WALLS = {
    2: 8,
    3: 2,
}  # most walls that get sources as if each were alone, by dimension; more share as many
FIT_ROWS = {
    2: 4096,
    3: 2048,
}  # most nodes of the wall, and most edges, that enter the fit, by dimension


class WallIds(eqx.Module):
    """Rows of the surface that a fit needs.

    - `moving`, `fixed`: the sources.
    - `nodes`, `edges`: rows and pairs of rows at which the field follows the wall.
    - `held`: for each edge the nearest row that is fixed or of another wall, else the edge's first
      row.
    - `ends`: for each edge two ends of its wall.
    - `far`: fixed sources on the way to which, at the share `reach`, a ring of sources stands.
    - `tips`: sharp tips of the walls, each with a node on either side.
    - `chord`: the mean chord of each edge's wall, relative to the distance of the wall's ends.
    """

    moving: Int[Array, " s"]
    fixed: Int[Array, " t"]
    nodes: Int[Array, " k"]
    edges: Pairs
    held: Int[Array, " e"]
    ends: Pairs
    far: Int[Array, " r"]
    tips: Int[Array, "g 3"]
    chord: Float[Array, " e"]
    reach: Float[Array, " r"]

    @classmethod
    def found(
        cls, surface: Surface, moving: np.ndarray, fixed: np.ndarray, closest: float
    ) -> "WallIds":
        """Finds the ids of a fit on the host; `closest` is how close two sources may come."""
        points = surface.points
        dimension = surface.points.shape[1]
        pairs = skin.edges(points, surface.moving, surface.faces)
        wall, ends, share = surface.walls
        chord = share * np.linalg.norm(np.subtract(*points[ends.T]), axis=1)
        tips = np.zeros((0, 3), int)
        if dimension == 2:
            beside, tips = _at_tips(surface, pairs, chord[wall[pairs[:, 0]]], closest)
            moving = drop_close(points, np.concatenate([moving, beside]), roundoff(points))
        # each source has a row of its own, so that the system is regular
        nodes = np.union1d(
            surface.seen[skin.thinned(points[surface.seen], FIT_ROWS[dimension])], moving
        )
        pairs = pairs[skin.thinned(points[pairs].mean(axis=1), FIT_ROWS[dimension])]
        label = wall[pairs[:, 0]]
        held = skin.nearest_held(points, surface.moving, wall, pairs)
        centre = _middles(pairs, points)[2]
        body = points[: surface.moving]
        far, reach = skin.drawn_in(points, centre, body, fixed, surface.images)
        fields = jax_arrays(
            moving=moving,
            fixed=fixed,
            nodes=nodes,
            edges=pairs,
            held=held,
            ends=ends[label],
            far=far,
            tips=tips,
            chord=share[label],
            reach=reach,
        )
        return cls(**fields)

    def places(self, surface: Rows) -> Sources:
        """Computes the places of all sources: moving, fixed, on rings between, behind tips."""
        centre = _middles(self.edges, surface)[2][None]
        ring = centre + self.reach.astype(surface.dtype)[:, None] * (surface[self.far] - centre)
        return jnp.concatenate(
            [surface[self.moving], surface[self.fixed], ring, self.behind_tips(surface)]
        )

    def outside(self, values: Rows, rings: "Rings") -> Float[Array, "o d"]:
        """Computes the displacement of sources outside of the fit: fixed, on rings, behind tips."""
        at_rings = rings.moved(values[self.edges].mean(axis=1))
        return jnp.concatenate([values[self.fixed], at_rings, self.behind_tips(values)])

    def behind_tips(self, values: Rows) -> Float[Array, "g d"]:
        """Continues places or displacements of the walls behind their tips: a place behind is the
        mirror image in the tip, which is right for affine motions.
        """
        tip, first, second = self.tips.T
        return 2 * values[tip] - (values[first] + values[second]) / 2


def _middles(
    edges: Int[Either, "e 2"], surface: Float[Either, "b d"]
) -> tuple[Float[Either, "e d"], Float[Either, " e"], Float[Either, " d"]]:
    """The middles of edges, their shares of the length of all, and their mean by these shares: one
    more node changes neither mean nor moments of a wall.
    """
    length = norm(surface[edges[:, 1]] - surface[edges[:, 0]])
    weight = length / length.sum()
    middle = surface[edges].mean(axis=1)
    return middle, weight, (weight[:, None] * middle).sum(axis=0)


class Rings(eqx.Module):
    """The map from displacements at the middles of edges to those of the rings.

    A body pushes and turns the rings as it would an elastic plate that is held at the far field.
    They get shares of its mean displacement, and of the affine motion about its centre that fits it
    best. Strain weighs there, so a thin body's change of thickness goes no farther.

    - `moments` (1 + d, e): weights of the mean, and of its moments.
    - `shares` (d, r, d, 1 + d): of the mean and the moments at the rings.
    """

    moments: Float[Array, "k e"]
    shares: Float[Array, "d r d k"]

    @classmethod
    def made(cls, ids: WallIds, surface: Rows) -> "Rings":
        d = surface.shape[1]
        eye = jnp.eye(d, dtype=surface.dtype)
        middle, weight, centre = _middles(ids.edges, surface)
        arm = middle - centre[None]
        moments = jnp.concatenate([weight[None], (weight[:, None] * arm).T])
        if not len(ids.far):
            return cls(moments, jnp.zeros((d, 0, d, 1 + d), surface.dtype))
        # (A M + weight 2 dev sym A)_ab = mean of u_a arm_b, with the moments M of the arms
        unit = einsum("ac,bd->abcd", eye, eye)
        strain = unit + unit.swapaxes(0, 1) - 2 / d * einsum("ab,cd->abcd", eye, eye)
        matrix = matmul(moments[1:], arm)
        # the turn of a straight body about itself is none
        system = einsum("ac,db->abcd", eye, matrix) + jnp.trace(matrix) * (
            STRAIN_WEIGHT * strain + SAME * unit
        )
        affine = jnp.linalg.inv(system.reshape(d * d, d * d)).reshape(d, d, d, d)
        reach = ids.reach.astype(surface.dtype)
        way = surface[ids.far] - centre[None]
        # a plate so large that its rotation has an end in a small mesh as in a large one
        body = jnp.sqrt(jnp.trace(matrix))
        held = jnp.minimum(norm(way), PLATE * body)
        turned = turning(jnp.minimum(reach * norm(way) / held, 1)) / turning(body / held)
        turned = (turned * reach)[:, None] * way
        pushed = einsum("r,ac->arc", pushing(reach), eye)[..., None]
        return cls(
            moments, jnp.concatenate([pushed, einsum("rb,abck->arck", turned, affine)], axis=3)
        )

    def moved(self, middles: Float[Array, "e d"]) -> Float[Array, "r d"]:
        return einsum("arck,kc->ra", self.shares, matmul(self.moments, middles))


def pushing(reach: Float[Array, " r"]) -> Float[Array, " r"]:
    """The share of a displacement at a share of the way to the far field, where a plate is held."""
    squared = reach**2
    return 1 - squared + squared * jnp.log(squared)


def turning(reach: Float[Array, " r"]) -> Float[Array, " r"]:
    """The same for a rotation, but for a factor."""
    return -jnp.log(reach) - (1 - reach**2) / 2


def _at_tips(
    surface: Surface, pairs: np.ndarray, chord: np.ndarray, closest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Finds sources (k,) beside sharp tips in 2-D, and tips (g, 3) that get a source behind them,
    each with a node on either side. `pairs` are all edges of the moving walls, `chord` (e,) is that
    of each edge's wall.
    """
    held = skin.nearest_held(surface.points, surface.moving, surface.walls.number, pairs)
    distance = np.linalg.norm(surface.points[pairs].mean(axis=1) - surface.points[held], axis=1)
    room = np.where(held == pairs[:, 0], chord, np.minimum(chord, distance))
    walls = skin.sharp_tips(surface.points, pairs)
    behind = skin.behind_tips(walls, BEHIND * room, closest, BEYOND_TIP * room)
    return skin.beside_tips(walls, chord), behind


def _on_each_wall(surface: Surface, sources: np.ndarray, closest: float) -> np.ndarray:
    """Adds sources until each of several moving walls has enough, with their images."""
    rows = np.arange(surface.moving)
    wall = surface.walls.number[rows]
    images = surface.images[rows]
    labels = np.unique(wall[images == rows])
    if len(labels) < 2:
        return sources
    most = len(labels)
    count = ENOUGH[surface.points.shape[1]]
    enough = count * min(most, WALLS[surface.points.shape[1]]) // most
    chosen = [sources]
    for label in labels:
        own = np.intersect1d(rows[(wall == label) & (images == rows)], surface.seen)
        first = np.flatnonzero(np.isin(own, sources))
        if len(first) < enough:
            chosen.append(
                own[farthest(surface.points[own], enough, closest, first if len(first) else None)]
            )
    moving = rows[np.isin(images, np.concatenate(chosen))]
    return np.concatenate([moving, sources[sources >= surface.moving]])


class FittedRBF(AbstractMethod):
    """Fits radial basis functions that follow the body instead of its skin.

    It is a coarse field, made to be corrected.

    `RBF` takes the wall's displacement u at its sources. This method chooses the values v at the
    moving sources; at the fixed sources v is u. The field c_v is then the best fit, in least
    squares over nodes i and edges e of the moving walls:

        mean_i |c_v - u|^2  +  mean_e mu^2 |d/ds (c_v - u)|^2  +  mean_e ell^2 2 |dev sym grad
        c_v|^2

    d/ds is the derivative along an edge, and dev sym grad the deviatoric strain at its middle. The
    first two terms follow value and slope along the wall. The third smooths the field: a change of
    one side of a thin body goes on less beyond its other side. The change of the skin itself is
    left to the correction, which turns grid lines with the wall. An affine motion of the whole
    surface is reproduced: strain is measured from the affine motion that fits the surface's
    displacement best.

    A thin plate spline carries the change of one side of a thin body on to the far field: a bump
    moves nodes by several times its height. So sources stand on rings 12 and 24 radii of the body
    away, where every fixed node is farther, and 40 and 80 on the way to fixed nodes beyond. They
    move as an elastic plate would that is held at the far field, pushed and turned in the middle.
    They get a share of the body's mean displacement, and of the affine motion that fits the body
    best with little strain.

    A thin plate spline turns abruptly behind a sharp trailing edge, within the first cell there. So
    in 2-D a sharp tip of a wall has a fixed source behind it: its displacement is the wall's own,
    continued straight on. Six moving sources stand beside the tip, at 0.002 to 0.032 of the chord.
    Cells there are so small that a wavy field inverts them. Tips of less than 60 degrees are sharp.

    A free side is a side of the mesh that is neither moving, fixed nor a symmetry plane. A field
    that turns with the body would carry it out of its plane. A mesh with a free side gets the
    interpolation of many sources instead of the fit. So do points without faces: they show neither
    sharp edges nor which nodes are neighbours.

    **Arguments:**

    - `rbf`: basis and sources. The default takes moving sources from 16 leaves of a k-d tree, 32 if
      another boundary is near, and then the nodes farthest from them: 84 in 2-D, 400 in 3-D. Each
      of several walls gets as many (up to 8 walls, 2 in 3-D; more walls share them).
    - `ell`: the length that weighs strain, in the mesh's units. A large length carries the body as
      rigidly as possible, a small length follows the skin. It is nowhere more than 0.05 of the
      distance to the nearest node that is held or of another wall. Default 0.03 of each wall's mean
      chord: of half of its perimeter, in 3-D of half of its area over its span.
    - `mu`: the length that weighs the slope along the wall, in the mesh's units. Default 0.1 of
      each wall's mean chord, in 3-D 0.4.

    Walls of more than 4,096 nodes or edges, in 3-D 2,048, are sampled.

    The fit is linear in u. It costs a dense factorisation of d s unknowns once per plan, for s
    moving sources.
    """

    rbf: RBF = eqx.field(default_factory=lambda: RBF(reduction=Filled()))
    ell: Scalar | None = eqx.field(default=None, converter=number_or_none("ell", 0))
    mu: Scalar | None = eqx.field(default=None, converter=number_or_none("mu", 0))

    def __check_init__(self):
        check_kind(self.rbf, RBF, "rbf", "jm.RBF()")
        if self.rbf.solver is not None and not isinstance(self.rbf.solver, Direct):
            raise ValueError(
                "FittedRBF factors its dense system: `rbf` with "
                f"solver={type(self.rbf.solver).__name__}() is for RBF alone."
            )

    @property
    def exact(self) -> bool:
        return False

    def connect(self, surface: Surface, points):
        is_open = surface.faces is None or surface.has_free_sides(points)
        # the ids depend on the surface alone, so all pieces of a mesh share them
        return surface.once((self, is_open), lambda: self._ids(surface, is_open)), None

    def _ids(self, surface: Surface, is_open: bool) -> "WallIds | np.ndarray":
        """Finds the ids of the fit; sources alone for an interpolation."""
        if is_open:
            return self._denser.chosen(surface)
        closest = self.rbf.reduction.closest(surface.points[: surface.moving])
        sources = _on_each_wall(surface, self.rbf.chosen(surface), closest)
        is_moving = sources < surface.moving
        ids = WallIds.found(surface, sources[is_moving], sources[~is_moving], closest)
        return ids if len(ids.edges) else sources

    @property
    def _denser(self) -> RBF:
        """The field for meshes with free sides, and for points alone."""
        reduction = self.rbf.reduction
        if isinstance(reduction, KDTree | Filled) and reduction.leaves is not None:
            reduction = dataclasses.replace(
                reduction, leaves=max(SOURCES_ALONE, reduction.leaves), crowded=None
            )
        return RBF(self.rbf.basis, reduction, self.rbf.fixed_reduction, self.rbf.degree)

    def control(self, ids):
        if not isinstance(ids, WallIds):
            return self.rbf.control(ids)
        fixed = np.asarray(ids.fixed)
        return Control(np.concatenate([np.asarray(ids.moving), fixed]), fixed)

    def check(self, ids, factors: "FitFactors | RBFFactors", u):
        if isinstance(factors, RBFFactors):
            return self.rbf.check(ids, factors, u)
        more = np.zeros((len(ids.far) + len(ids.tips), u.shape[1]), u.dtype)
        values = as_jax(np.concatenate([np.asarray(u)[self.control(ids).sources], more]))
        self.rbf.check(np.arange(len(values)), factors.rbf, values)

    def fit(self, ids, surface, points):
        if not isinstance(ids, WallIds):
            return self.rbf.fit(ids, surface, points)
        sources = ids.places(surface)
        rbf = self.rbf.fit(jnp.arange(len(sources)), sources, points)
        surface = surface.astype(rbf.lu.dtype)
        moves = len(ids.moving)
        cardinal = rbf.solve(jnp.eye(len(rbf.lu), len(rbf.sources), dtype=surface.dtype))
        start = surface[ids.edges[:, 0]]
        end = surface[ids.edges[:, 1]]
        middle = (start + end) / 2
        along = end - start
        length = jnp.sqrt(jnp.sum(along**2, axis=1))

        def rows(points):
            return self.rbf.expansion.rows(
                rbf.sources, rbf.scale, (points - rbf.centre[None]) * rbf.scale
            )

        value = matmul(rows(surface[ids.nodes]), cardinal)
        slopes = einsum(
            "eta,ts->eas", jax.vmap(jax.jacfwd(lambda x: rows(x[None])[0]))(middle), cardinal
        )
        slope = einsum("ea,eas->es", along / length[:, None], slopes)
        ell, mu = self._lengths(ids, surface, middle)
        nodes = value[:, :moves] / len(value)
        weighted = slope[:, :moves] * (mu**2 / len(slope))[:, None]
        squares = matmul(nodes.T, value)
        matrix = _system(
            squares + matmul(weighted.T, slope), slopes * (ell * len(slope) ** -0.5)[:, None, None]
        )
        fit = Cholesky.of(matrix[..., :moves].reshape(matrix.shape[0] * moves, -1))
        terms = polynomial((surface - rbf.centre[None]) * rbf.scale, self.rbf.degree)
        affine = Cholesky.of(matmul(terms.T, terms))
        edges = weighted / length[:, None]
        return FitFactors(
            rbf=rbf,
            nodes=nodes,
            edges=edges,
            outer=matrix[..., moves:],
            rings=Rings.made(ids, surface),
            fit=fit,
            polynomial=terms,
            affine=affine,
        )

    def _lengths(self, ids: WallIds, surface, middle):
        span = norm(surface[ids.ends[:, 0]] - surface[ids.ends[:, 1]])
        chord = ids.chord.astype(surface.dtype) * span
        ell = ELL * chord if self.ell is None else jnp.full_like(chord, self.ell)
        mu = MU[surface.shape[1]] * chord if self.mu is None else jnp.full_like(chord, self.mu)
        free = ids.held == ids.edges[:, 0]
        return jnp.where(free, ell, jnp.minimum(ell, JOINT * norm(surface[ids.held] - middle))), mu

    def field(self, ids, factors: "FitFactors | RBFFactors", surface, u):
        if isinstance(factors, RBFFactors):
            # a fit to its own sources would lose half of the digits
            return self.rbf.field(ids, factors, surface, u)
        values = u.astype(factors.rbf.lu.dtype)
        affine = factors.affine.solve(matmul(factors.polynomial.T, values))
        rest = values - matmul(factors.polynomial, affine)
        difference = rest[ids.edges[:, 1]] - rest[ids.edges[:, 0]]
        outer = ids.outside(rest, factors.rings)
        at_nodes = matmul(factors.nodes.T, rest[ids.nodes])
        wanted = (at_nodes + matmul(factors.edges.T, difference)).T
        wanted = wanted - einsum("aicj,jc->ai", factors.outer, outer)
        fitted = factors.fit.solve(wanted.reshape(-1, 1)).reshape(wanted.shape).T
        rest = jnp.concatenate([fitted, outer])
        terms = polynomial(factors.rbf.sources, self.rbf.degree)
        return self.rbf.expansion.field(factors.rbf, rest + matmul(terms, affine), u.dtype)


class Cholesky(eqx.Module):
    """The factor of a matrix whose rows and columns are multiplied by `size`."""

    lower: Float[Array, "s s"]
    size: Float[Array, " s"]

    @classmethod
    def of(cls, matrix: Float[Array, "s s"]) -> "Cholesky":
        size = 1 / jnp.sqrt(jnp.diagonal(matrix))
        return cls(jnp.linalg.cholesky(matrix * size[:, None] * size[None]), size)

    def solve(self, right: Columns) -> Columns:
        return (
            jax.scipy.linalg.cho_solve((self.lower, True), right * self.size[:, None])
            * self.size[:, None]
        )


class FitFactors(eqx.Module):
    """The factored systems of sources, `fit` and `affine` part, and weighted rows of the fit.
    `outer` are the columns of the sources outside of the fit: fixed ones, rings, those behind tips.
    """

    rbf: RBFFactors
    nodes: Weights
    edges: Float[Array, "e s"]
    outer: Float[Array, "d s d t"]
    rings: Rings
    fit: Cholesky
    polynomial: Float[Array, "b p"]
    affine: Cholesky


def _system(follow: Float[Array, "m s"], slopes: Float[Array, "e d s"]) -> Float[Array, "d m d s"]:
    """Assembles the normal equations of the first m sources, which move: `follow` for each
    component, and 2 |dev sym G|^2 = G:G + G:G^T - 2/d (tr G)^2.
    """
    count, d, s = slopes.shape
    m = len(follow)
    moving = slopes[:, :, :m].reshape(count, d * m)
    strain = matmul(moving.T, slopes.reshape(count, d * s)).reshape(d, m, d, s)
    component = follow + sum(strain[b, :, b] for b in range(d))
    diagonal = jnp.einsum("ac,ij->aicj", jnp.eye(d, dtype=follow.dtype), component)
    return diagonal + strain.transpose(2, 1, 0, 3) - (2 / d) * strain
