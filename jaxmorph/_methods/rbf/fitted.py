"""A coarse field that follows the body: radial functions fitted to the wall."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._host.sources.farthest import Filled
from ..._host.sources.reduction import KDTree
from ..._host.surface.skin import has_free_sides
from ..._kernels.values import as_jax, norm
from ..base import AbstractMethod, Control, check_kind
from ..numbers import length_or_none
from ..surface import Surface
from .expansion import RBFFactors
from .rbf import RBF
from .solvers import Direct
from .system import polynomial
from .wall import WallIds

JOINT = 0.05
"""Largest `ell`, relative to the distance of the nearest node that is fixed or of another wall."""

SOURCES_ALONE = 64
"""Fewest leaves of the k-d tree if the field interpolates instead of being fitted."""


class FittedRBF(AbstractMethod):
    """Fits radial basis functions that follow the body instead of its skin.

    It is a coarse field, made to be corrected.

    `RBF` takes the wall's displacement u at its sources. This method chooses the values v at the
    moving sources; at the fixed sources v is u. The field c_v is then the best fit, in least
    squares over nodes i and edges e of the moving walls:

        mean_i |c_v - u|^2  +  mean_e mu^2 |d/ds (c_v - u)|^2  +  mean_e ell^2 2 |dev sym grad
        c_v|^2

    d/ds is the derivative along an edge, and dev sym grad the deviatoric strain at its middle. The
    first two terms follow value and slope along the wall. The third term lets the field carry the
    body as rigidly as the first two allow. So grid lines stay at right angles to the wall, and a
    change of one side of a thin body does not go on beyond its other side. The change of the skin
    itself is left to the correction. An affine motion of the whole surface is reproduced: strain is
    measured from the affine motion that fits the surface's displacement best.

    A thin plate spline carries the body's slope on to the far field: at 500 chords a bump moves
    nodes by several times its height. So where fixed sources are farther away than about 45 chords,
    the field comes to rest at 20 and 40 chords. Only the walls' mean displacement and affine
    motions of the whole surface go farther.

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
      another boundary is near, and then the nodes farthest from them: 84 in 2-D, 400 in 3-D.
    - `ell`: the length that weighs strain, in the mesh's units. A large length keeps the wall's
      lines at right angles, a small length follows the skin. It is nowhere more than 0.05 of the
      distance to the nearest node that is held or of another wall. Default 0.17 of each wall's mean
      chord, half of its perimeter, but at most 2.25 of its mean thickness. In 3-D it is 0.07 of
      half of the wall's area over its span.
    - `mu`: the length that weighs the slope along the wall, in the mesh's units. Default 0.1 of
      each wall's mean chord, and 0.5 within 0.03 chords of a sharp tip. In 3-D it is 0.4.

    Walls of more than 4,096 nodes or edges, in 3-D 2,048, are sampled.

    The fit is linear in u. It costs a dense factorisation of d s unknowns once per plan, for s
    moving sources.
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
        # The ids depend on the surface alone, so all pieces of a mesh share them. A method with
        # array leaves has no hash: its id is the key, and the entry holds the method itself, so
        # that no other object can get that id.
        key = ("fitted", id(self), bool(is_open))
        return surface.once(key, lambda: (self, self._ids(surface, is_open)))[1], None

    def _ids(self, surface: Surface, is_open: bool) -> WallIds:
        if is_open:
            return WallIds.without_edges(surface, self._denser.chosen(surface))
        closest = self.rbf.reduction.closest(surface.points[: surface.moving])
        return WallIds.found(surface, self.rbf.chosen(surface), closest)

    @property
    def _denser(self) -> RBF:
        """The field for meshes with free sides, and for points alone."""
        reduction = self.rbf.reduction
        if isinstance(reduction, KDTree | Filled) and reduction.leaves is not None:
            reduction = dataclasses.replace(reduction, leaves=max(SOURCES_ALONE, reduction.leaves), crowded=None)
        return RBF(self.rbf.basis, reduction, self.rbf.fixed_reduction, self.rbf.degree)

    def control(self, ids):
        sources = np.concatenate([np.asarray(ids.moving), np.asarray(ids.fixed)])
        return Control(sources, np.asarray(ids.fixed) if len(ids.edges) else sources)

    def check(self, ids, factors: "FitFactors", u):
        more = np.zeros((len(ids.far) + len(ids.tips), u.shape[1]), u.dtype)
        values = as_jax(np.concatenate([np.asarray(u)[self.control(ids).sources], more]))
        self.rbf.check(np.arange(len(values)), factors.rbf, values)

    def fit(self, ids: WallIds, surface, points):
        sources = ids.places(surface)
        rbf = self.rbf.fit(jnp.arange(len(sources)), sources, points)
        if not len(ids.edges):
            return FitFactors(rbf, *(jnp.zeros((0,) * rank, sources.dtype) for rank in (2, 2, 4, 1, 2, 2, 2, 2)))
        surface = surface.astype(rbf.lu.dtype)
        count, moves, dimension = len(rbf.sources), len(ids.moving), surface.shape[1]
        start, end = surface[ids.edges[:, 0]], surface[ids.edges[:, 1]]
        middle, along = (start + end) / 2, end - start
        length = jnp.sqrt(jnp.sum(along**2, axis=1))
        cardinal = rbf.solve(jnp.eye(len(rbf.lu), count, dtype=surface.dtype))

        def rows(points):
            return self.rbf.expansion.rows(rbf.sources, rbf.scale, (points - rbf.centre[None]) * rbf.scale)

        def derivative(axis):
            direction = jnp.broadcast_to(jnp.eye(dimension, dtype=surface.dtype)[axis], middle.shape)
            return jax.jvp(rows, (middle,), (direction,))[1]

        value = _product(rows(surface[ids.nodes]), cardinal)
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

    def _lengths(self, ids: WallIds, surface, middle):
        span = norm(surface[ids.ends[:, 0]] - surface[ids.ends[:, 1]])
        ell, mu = (
            share.astype(surface.dtype) * span if length is None else jnp.full_like(span, length)
            for share, length in ((ids.ell, self.ell), (ids.mu, self.mu))
        )
        free = ids.held == ids.edges[:, 0]
        return jnp.where(free, ell, jnp.minimum(ell, JOINT * norm(surface[ids.held] - middle))), mu

    def field(self, ids: WallIds, factors: "FitFactors", surface, u):
        values = u.astype(factors.rbf.lu.dtype)
        if not len(ids.edges):  # an interpolation: fitting it to its own sources would lose half of the digits
            return self.rbf.expansion.field(
                factors.rbf, jnp.concatenate([values[ids.moving], values[ids.fixed]]), u.dtype
            )
        affine = self._affine_part(factors, values)
        rest = values - _product(factors.polynomial, affine)
        difference = rest[ids.edges[:, 1]] - rest[ids.edges[:, 0]]
        wanted = _product(factors.nodes.T, rest[ids.nodes]) + _product(factors.edges.T, difference)
        fixed = jnp.concatenate([rest[ids.fixed], ids.at_rings(rest), ids.behind_tips(rest)])
        wanted = wanted.T - jnp.einsum("aicj,jc->ai", factors.outer, fixed, precision="highest")
        solved = jax.scipy.linalg.cho_solve((factors.lower, True), wanted.ravel() * factors.scale) * factors.scale
        moving = solved.reshape(wanted.shape).T + _product(factors.polynomial[ids.moving], affine)
        ring = _product(factors.ring, affine) + ids.at_rings(rest)
        everything = jnp.concatenate([moving, values[ids.fixed], ring, ids.behind_tips(values)])
        return self.rbf.expansion.field(factors.rbf, everything, u.dtype)

    def _affine_part(self, factors: "FitFactors", values):
        """Finds the coefficients (p, d) of the affine motion nearest to the displacement."""
        moments = _product(factors.polynomial.T, values)
        return jax.scipy.linalg.cho_solve((factors.moments, True), moments)


class FitFactors(eqx.Module):
    """The factored systems of sources, fit and affine part, and weighted rows of the fit."""

    rbf: RBFFactors
    nodes: Float[Array, "k s"]
    edges: Float[Array, "e s"]
    outer: Float[Array, "d s d t"]
    scale: Float[Array, " ds"]
    lower: Float[Array, "ds ds"]
    polynomial: Float[Array, "b p"]
    moments: Float[Array, "p p"]
    ring: Float[Array, "r p"]


def _system(follow: Float[Array, "m s"], slopes: Float[Array, "e d s"]) -> Float[Array, "d m d s"]:
    """Assembles the normal equations of the first m sources, which move.

    They hold `follow` for each component, and 2 |dev sym G|^2 = G:G + G:G^T - 2/d (tr G)^2.
    """
    (count, d, s), m = slopes.shape, len(follow)
    moving = slopes[:, :, :m].reshape(count, d * m)
    strain = _product(moving.T, slopes.reshape(count, d * s)).reshape(d, m, d, s)
    component = follow + sum(strain[b, :, b] for b in range(d))
    diagonal = jnp.einsum("ac,ij->aicj", jnp.eye(d, dtype=follow.dtype), component)
    return diagonal + strain.transpose(2, 1, 0, 3) - (2 / d) * strain


def _affine(method: RBF, rbf: RBFFactors, surface: Float[Array, "b d"]):
    """Evaluates the polynomial's terms at the surface, and factors the matrix of their moments."""
    terms = polynomial((surface - rbf.centre[None]) * rbf.scale, method.degree)
    return terms, jnp.linalg.cholesky(_product(terms.T, terms))


def _product(a: Float[Array, "m k"], b: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return jnp.matmul(a, b, precision="highest")
