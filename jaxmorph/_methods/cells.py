"""Methods that solve an equation on the mesh's cells: finite elements, and springs."""

import abc
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.lagrange import derivatives_at_nodes, jacobian_samples
from .._host.cells.topology import CORNERS, EDGES, FRAMES
from .._host.linear import systems
from .._host.linear.products import cofactors, determinant, dot
from .._host.package.rounding import nearest_of
from .._kernels.callback import host_call
from .._kernels.compile import compiled
from .._kernels.module import Module
from .._kernels.values import as_jax, largest, norm
from .base import (
    AbstractMethod,
    AbstractWhole,
    Pairs,
    Points,
    Rows,
    Scalar,
    check_kind,
    einsum,
    matmul,
    number,
    or_one,
)
from .blocks import fold_rows
from .rbf.expansion import is_sound
from .surface import ByKind, Surface

Samples = Float[Array, " q"]  # values at quadrature points
CELLS = 4096  # cells in a block


class CellIds(eqx.Module):
    """Ids of k cells of one type: nodes at the `corners`. `entry` is the place of each pair of
    corners in the list of pairs, its length for corners that are one node. `flipped` pairs begin
    with the entry's second node.
    """

    corners: Int[Array, "k c"]
    entry: Int[Array, "k p"]
    flipped: Bool[Array, "k p"]


class NodeIds(eqx.Module):
    """Ids of a mesh's n nodes for a solve."""

    cells: dict[str, CellIds]
    pairs: Pairs  # nodes that share an entry of the matrix, the smaller id first
    frame: Float[Array, "d d"]  # axes in columns; the normal of each symmetry plane is one
    free: Bool[Array, "n d"]  # unknowns, by node and axis of the frame
    wall: Int[Array, " n"]  # for each node the nearest moving node
    rows: Int[Array, " r"]  # rows of the surface that are nodes of the mesh
    nodes: Int[Array, " r"]  # these nodes


class NodeFactors(eqx.Module):
    """A symmetric matrix as `systems.solve` takes it, and places in the frame. It has an entry for
    each pair of nodes and each node, numbers or blocks. With `masses` M it is K M^-1 K.
    """

    values: Float[Array, "e ..."]
    diagonal: Float[Array, "n ..."]
    masses: Float[Array, " q"]
    places: Points

    def times(self, pairs: Pairs, x: Points) -> Points:
        i, j = pairs.T

        def scaled(a, b):
            return a[:, None] * b if a.ndim == 1 else einsum("eab,eb->ea", a, b)

        def once(x):
            below = jax.ops.segment_sum(scaled(self.values, x[j]), i, len(x))
            above = jax.ops.segment_sum(scaled(_turned(self.values), x[i]), j, len(x))
            return scaled(self.diagonal, x) + (below + above)

        return once(once(x) / self.masses[:, None]) if len(self.masses) else once(x)

    def solve(self, pairs: Pairs, free: Bool[Array, "n d"], right: Points) -> Points:
        leaves = (pairs, self.values, self.diagonal, self.masses, free)

        def times(x):
            return jnp.where(free, self.times(pairs, jnp.where(free, x, 0)), x)

        def on_host(*system):
            return systems.solve(*system, multigrid=self.places.shape[1] > 0)

        def solve(_, right):
            shape = jax.ShapeDtypeStruct(right.shape, right.dtype)
            return host_call(on_host, shape, *jax.lax.stop_gradient(leaves), right)

        return jax.lax.custom_linear_solve(times, jnp.where(free, right, 0), solve, symmetric=True)


def _turned(blocks: Float[Array, "e ..."]) -> Float[Array, "e ..."]:
    return blocks if blocks.ndim == 1 else jnp.swapaxes(blocks, 1, 2)


class AbstractCellMethod(AbstractMethod):
    """Solves a linear system for all inner nodes, made of one small matrix for each cell.

    The matrix is symmetric, and its rows add to zero: a translation is reproduced. Nodes at one
    place are one node. Nodes on a symmetry plane slide in it. Nodes in no cell rest, and so do
    cells without a connection to a moving or fixed node. The solve runs on the host, within traced
    code. In 2-D it factors the matrix. In 3-D a large system takes conjugate gradients with a
    multigrid cycle. If they do not converge, up to 60,000 unknowns are factored; with more,
    `prepare` raises. The last two factors are cached. The transpose costs as much as the solve.
    """

    def pairs(self, kind: str) -> tuple[tuple[int, int], ...]:
        """Lists the pairs of corners of a type of cells that have an entry, by default all."""
        return all_pairs(kind)

    def ends(self, kind: str) -> np.ndarray:
        """The first and the second corner (2, p) of each pair."""
        return np.array(self.pairs(kind)).T

    @abc.abstractmethod
    def entries(
        self, kind: str, corners: Float[Array, "c d"], distance: Float[Array, " c"]
    ) -> Float[Array, "p"] | Float[Array, "p d d"]:
        """Computes a cell's entries: numbers, or blocks of rows of the first corner. Traced.

        `distance` is that of each corner from the nearest moving node.
        """

    def masses(self, ids: NodeIds, places: Points) -> Float[Array, " q"]:
        """Computes masses M of the nodes, for the matrix K M^-1 K; none by default. Traced."""
        return jnp.zeros(0, places.dtype)

    @property
    def needs_cells(self) -> bool:
        return True

    def connect(self, surface: Surface, points):
        cells = surface.cells
        assert cells is not None  # the driver asks `needs_cells`
        n = len(cells.on_plane)
        present = np.flatnonzero(surface.nodes >= 0)
        rows = present[surface.nodes[present] < n]  # images lie beyond: the surface alone has them
        nodes = surface.nodes[rows]
        stands = systems.coincident(points[:n], nodes)
        corners = {kind: stands[ids] for kind, ids in cells.corners.items()}
        pairs, of_kind = self._numbered(corners, n)
        wall = nodes[rows < surface.moving]
        wall = nearest_of(points[:n], points[wall], wall)
        known = np.zeros(n, dtype=bool)
        known[nodes] = True
        is_free = (
            systems.reached(pairs, known) & ~known & (np.bincount(pairs.ravel(), minlength=n) > 0)
        )
        frame = _frame(cells.normals)
        slides = [
            cells.on_plane[:, np.abs(cells.normals @ axis) > 0.5].any(axis=1) for axis in frame.T
        ]
        free = is_free[:, None] & ~np.stack(slides, axis=1)
        systems.check_solver(int(free.sum()), points.shape[1])
        volume = np.concatenate([stands, np.zeros(len(points) - n, stands.dtype)]).astype(np.int32)
        volume[surface.nodes[present]] = n + present
        pairs, wall, rows, nodes = (ids.astype(np.int32) for ids in (pairs, wall, rows, nodes))
        return NodeIds(of_kind, *as_jax((pairs, frame, free, wall, rows, nodes))), volume

    def _numbered(self, corners: ByKind, n: int) -> tuple[np.ndarray, dict[str, CellIds]]:
        # A pair of nodes is one integer, smaller id times n plus larger id. The list of pairs is
        # sorted and unique, so a search finds each cell's entries. Corners at one place get the
        # number beyond it.
        both = {
            kind: np.moveaxis(cells[:, self.ends(kind)], 1, 0) for kind, cells in corners.items()
        }
        keys = {kind: np.minimum(i, j) * n + np.maximum(i, j) for kind, (i, j) in both.items()}
        real = [keys[kind][i != j] for kind, (i, j) in both.items()]
        ordered = np.sort(np.concatenate([np.zeros(0, np.int64), *real]))
        unique = ordered[
            np.diff(ordered, prepend=-1) > 0
        ]  # NumPy's own takes a table of hashes, and ten times as long
        ids = {}
        for kind, (i, j) in both.items():
            entry = np.where(i != j, np.searchsorted(unique, keys[kind]), len(unique))
            ids[kind] = CellIds(
                *as_jax((corners[kind].astype(np.int32), entry.astype(np.int32), i > j))
            )
        return np.stack(np.divmod(unique, n), axis=1), ids

    def fit(self, ids: NodeIds, surface, points):
        places = matmul(points, ids.frame.astype(points.dtype))
        n = len(places)
        distance = norm(places - places[ids.wall])
        first, *others = [self._of_cells(kind, ids, places, distance) for kind in ids.cells]
        values = sum(others, start=first)
        i, j = ids.pairs.T
        diagonal = -jax.ops.segment_sum(values, i, n) - jax.ops.segment_sum(_turned(values), j, n)
        return NodeFactors(values, diagonal, self.masses(ids, places), places)

    def _of_cells(self, kind: str, ids: NodeIds, places, distance):
        cells = ids.cells[kind]

        @jax.vmap
        @jax.checkpoint
        def entries(corners, flipped):
            values = self.entries(kind, places[corners], distance[corners])
            flipped = flipped.reshape(-1, *(1,) * (values.ndim - 1))
            return jnp.where(flipped, _turned(values), values)

        def add(total, rows):
            corners, entry, flipped = rows
            return total.at[entry].add(entries(corners, flipped))

        every = jax.eval_shape(entries, cells.corners, cells.flipped)
        none = jnp.zeros((len(ids.pairs), *every.shape[2:]), every.dtype)
        return fold_rows(add, none, (cells.corners, cells.entry, cells.flipped), CELLS)

    def field(self, ids: NodeIds, factors: NodeFactors, surface, u):
        moved = _in_frame(ids, factors, u)
        return NodeField(jnp.concatenate([matmul(moved, ids.frame.astype(u.dtype).T), u]))

    def check(self, ids: NodeIds, factors: NodeFactors, u):
        is_sound(
            float(_rounding(ids, factors, u)),
            u.dtype,
            lambda fault: (
                f"the {int(ids.free.sum())} unknowns of {type(self).__name__} are {fault}. Its "
                "stiffness is not finite or not positive, or differs too much between cells "
                "(cells without volume), or conjugate gradients did not converge. Try a smaller "
                "exponent, or a method that does not solve on cells, such as the default."
            ),
            "not solved for",
        )


@compiled
def _rounding(ids: NodeIds, factors: NodeFactors, u: Rows) -> Scalar:
    """The change by one step of iterative refinement; NaN for a system that is not solved."""
    moved = _in_frame(ids, factors, u)
    if jnp.finfo(u.dtype).bits < 64:  # the residual is coarser than the solution
        return jnp.max(0 * moved)
    missed = factors.times(ids.pairs, moved)
    return jnp.max(jnp.abs(factors.solve(ids.pairs, ids.free, missed)), initial=0.0)


def _in_frame(ids: NodeIds, factors: NodeFactors, u: Rows) -> Points:
    """The displacements (n, d) of nodes, along the axes of the frame."""
    turned = matmul(u, ids.frame.astype(u.dtype))
    boundary = jnp.zeros(factors.places.shape, u.dtype).at[ids.nodes].set(turned[ids.rows])
    return boundary + factors.solve(ids.pairs, ids.free, -factors.times(ids.pairs, boundary))


class NodeField(AbstractWhole):
    """Displacements of nodes, then of the surface's rows; a point's id is its row among them."""

    values: Float[Array, "k d"]

    def __call__(self, x, ids):
        return self.values[ids]


def _frame(normals: np.ndarray) -> np.ndarray:
    d = normals.shape[1]
    axes: list[np.ndarray] = []
    for direction in (*normals, *np.eye(d)):
        rest = direction - sum((axis * (axis @ direction) for axis in axes), start=np.zeros(d))
        if np.linalg.norm(rest) > 0.3 and len(axes) < d:
            axes.append(rest / np.linalg.norm(rest))
    return np.stack(axes, axis=1)


def all_pairs(kind: str) -> tuple[tuple[int, int], ...]:
    return tuple((i, j) for j in range(CORNERS[kind]) for i in range(j))


class AbstractStiffness(Module):
    """Gives each cell a stiffness, or a diffusivity."""

    @abc.abstractmethod
    def __call__(self, volume: Scalar, distance: Scalar) -> Scalar:
        """Computes a cell's stiffness by its volume (in 2-D its area), and its corners' mean
        distance from the nearest moving node. Traced.
        """


class ByVolume(AbstractStiffness):
    """Makes a cell as stiff as 1 / volume^exponent: small cells keep their shape.

    OpenFOAM calls it `inverseVolume`. The default of `exponent` is 1; with 0 all cells are equally
    stiff.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return volume ** -self.exponent.astype(volume.dtype)


class ByDistance(AbstractStiffness):
    """Makes a cell as stiff as 1 / distance^exponent, by its corners' mean distance.

    The distance is that from the nearest moving node. A quad has a stiffness at each corner, with
    the mean of the corner and its two neighbours. The default of `exponent` is 1. OpenFOAM calls it
    `inverseDistance`, with the exponent 2 `quadratic inverseDistance`.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return distance ** -self.exponent.astype(distance.dtype)


SLIVER = 1e-6  # share of a cell's largest Jacobian below which a quadrature point fades out


def gradients(kind: str, corners: Float[Array, "c d"]) -> tuple[Float[Array, "q c d"], Samples]:
    """Returns the shape functions' gradients and the volumes at the quadrature points. Traced."""
    # A point whose Jacobian is small beside the cell's largest fades out: it belongs to a triangle
    # at a straight corner, or between two corners at one place.
    reference, weights = (jnp.asarray(table, corners.dtype) for table in quadrature(kind))
    jacobian = einsum("qca,cb->qab", reference, corners)  # d place / d reference, transposed
    inverse, determinant, safe = _inverse(jacobian)
    volume = jnp.abs(determinant)
    top = largest(volume)
    share = jnp.where(top > 0, jnp.minimum(volume / (SLIVER * or_one(top)), 1) ** 2, 1)
    gradient = einsum("qba,qca->qcb", inverse * share[:, None, None], reference)
    return gradient, weights * jnp.where(top > 0, volume, jnp.abs(safe))


def stiffness(
    of_cell: AbstractStiffness, kind: str, volume: Samples, distance: Float[Array, " c"]
) -> Samples:
    """Computes the stiffness at the quadrature points. A point takes the mean distance of the
    corners whose shape functions vary there. Where all corners move, nothing depends on the
    stiffness.
    """
    share = np.any(quadrature(kind)[0] != 0, axis=2).astype(float)
    share = jnp.asarray(share / share.sum(axis=1, keepdims=True), distance.dtype)
    mean = matmul(share, distance)
    return jax.vmap(lambda mean: of_cell(volume.sum(), mean))(or_one(mean))


def _inverse(matrix: Float[Array, "q d d"]) -> tuple[Float[Array, "q d d"], Samples, Samples]:
    """Inverts matrices in closed form; returns determinants, and divisors that are not zero."""
    columns = list(jnp.moveaxis(matrix, 0, 2).swapaxes(0, 1))
    rows = cofactors(columns)
    determinant = dot(rows[0], columns[0])
    size = jnp.sum(matrix**2, axis=(1, 2)) ** (len(rows) / 2)
    least = float(jnp.finfo(matrix.dtype).eps) * or_one(size)
    safe = jnp.where(jnp.abs(determinant) > least, determinant, least)
    return (
        jnp.moveaxis(jnp.stack([jnp.stack(row) for row in rows]), 2, 0) / safe[:, None, None],
        determinant,
        safe,
    )


@functools.cache
def quadrature(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns reference derivatives (q, corners, d) of the shape functions, and weights (q,). A
    simplex has one point; a quad its four corners, with the linear triangles of the corners and
    their neighbours: the mean of both diagonals. Other types have two Gauss points in every
    direction.
    """
    if kind in ("triangle", "tetra"):
        return derivatives_at_nodes(kind)[:1].round(12), np.array(
            [1 / (2 if kind == "triangle" else 6)]
        )
    if kind == "quad":
        return derivatives_at_nodes(kind).round(12), np.full(4, 1 / 4)
    slopes, weights = jacobian_samples(kind)
    return slopes[weights > 0], weights[weights > 0]


class Laplacian(AbstractCellMethod):
    """Smooths each component of the displacement by Laplace's equation, of linear finite elements.

    Löhner and Yang made the diffusivity depend on the distance from the body (Communications in
    Numerical Methods in Engineering 12, 1996). Components are independent: a rotation shears the
    cells. `prepare` needs cells, and refuses those without volume. The `diffusivity` of a cell is
    `ByDistance(exponent)` or `ByVolume(exponent)`, by default `ByDistance(2)`, which OpenFOAM calls
    `quadratic inverseDistance`.
    """

    diffusivity: AbstractStiffness = eqx.field(default_factory=lambda: ByDistance(2.0))

    def __check_init__(self):
        check_kind(self.diffusivity, AbstractStiffness, "diffusivity", "jm.ByDistance(2)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        stiff = volume * stiffness(self.diffusivity, kind, volume, distance)
        return _products(gradient, stiff, self.ends(kind))


class Biharmonic(AbstractCellMethod):
    """Smooths each component by the biharmonic equation, in its mixed form (Helenbrook 2003).

    The displacement's derivative across the surface is zero: first cells keep their height, and
    follow the wall's translation, not its rotation. Finite elements are linear. `prepare` needs
    cells, and refuses those without volume.
    """

    def entries(self, kind, corners, distance):
        return _products(*gradients(kind, corners), self.ends(kind))

    def masses(self, ids, places):
        masses = jnp.zeros(len(places), places.dtype)
        for kind, cells in ids.cells.items():
            volumes = jax.vmap(
                lambda corners, kind=kind: gradients(kind, places[corners])[1].sum()
            )(cells.corners)
            share = jnp.broadcast_to(volumes[:, None], cells.corners.shape) / cells.corners.shape[1]
            masses = masses.at[cells.corners].add(share)
        return or_one(masses)


def _products(gradient, volume, ends):
    i, j = ends
    return einsum("q,qpa,qpa->p", volume, gradient[:, i], gradient[:, j])


class LinearElasticity(AbstractCellMethod):
    """Moves the mesh like an elastic solid, of linear finite elements (in 2-D in plane strain).

    A quad is the mean of both cuts into triangles. Small cells are stiff, as Johnson and Tezduyar
    proposed (Computer Methods in Applied Mechanics and Engineering 119, 1994). Translations and
    small rotations are reproduced; a large rotation is not, for the equation is linear. `prepare`
    needs cells, and refuses those without volume.

    **Arguments:**

    - `stiffening`: a cell's modulus of elasticity: `ByVolume(exponent)` or `ByDistance(exponent)`.
      Default `ByVolume(1)`.
    - `poisson`: Poisson's ratio, between -1 and 0.5. Default 0.3.

    **Raises:** `ValueError` for another ratio.
    """

    stiffening: AbstractStiffness = eqx.field(default_factory=ByVolume)
    poisson: Scalar = eqx.field(converter=number("poisson", -1, 0.5), default=0.3)

    def __check_init__(self):
        check_kind(self.stiffening, AbstractStiffness, "stiffening", "jm.ByVolume(1)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        i, j = self.ends(kind)
        nu = self.poisson.astype(corners.dtype)
        shear = 1 / (2 * (1 + nu))
        dilation = nu / ((1 + nu) * (1 - 2 * nu))
        stiff = volume * stiffness(self.stiffening, kind, volume, distance)
        outer = einsum("q,qpa,qpb->pab", stiff, gradient[:, i], gradient[:, j])
        trace = jnp.trace(outer, axis1=1, axis2=2)
        isotropic = trace[:, None, None] * jnp.eye(corners.shape[1], dtype=corners.dtype)[None]
        return dilation * outer + shear * (jnp.swapaxes(outer, 1, 2) + isotropic)


class SpringAnalogy(AbstractCellMethod):
    """Holds each edge by a spring that acts in all directions (Batina 1990).

    A spring is as stiff as 1 / length^`exponent`, by default 2. `prepare` needs cells, for their
    edges.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=2.0)

    def pairs(self, kind):
        return EDGES[kind] if kind != "triangle" else all_pairs(kind)

    def entries(self, kind, corners, distance):
        i, j = self.ends(kind)
        squared = jnp.sum((corners[j] - corners[i]) ** 2, axis=1)
        has_length = squared > 0
        stiff = jnp.where(has_length, squared, 1) ** (-self.exponent.astype(corners.dtype) / 2)
        return -jnp.where(has_length, stiff, jnp.inf)


class TorsionalSprings(AbstractCellMethod):
    """Holds each edge by a spring, and each angle by a spring that grows stiff as it closes.

    `prepare` needs cells. In 2-D it is the method of Farhat et al. (1998): springs against changes
    of the angles of each triangle. A quad has the triangles at its four corners. In 3-D it is the
    semi-torsional method (Zeng and Ethier 2005). An edge of a tetrahedron is as stiff as 1 / sin^2
    of the angle between the two faces that meet it in one node. Other cells have the tetrahedra at
    their corners. `lineal`, by default 0.1, is the stiffness of the springs along edges, times 1 /
    length^2, so that scaling the mesh changes nothing. Farhat et al. have 1 / length.
    """

    lineal: Scalar = eqx.field(converter=number("lineal", 0, ends="[)"), default=0.1)

    def entries(self, kind, corners, distance):
        simplices = np.array(FRAMES[kind])
        element = _triangle if corners.shape[1] == 2 else _tetrahedron
        blocks = jax.vmap(lambda corners: element(corners, self.lineal.astype(corners.dtype)))(
            corners[simplices]
        )
        total = jnp.zeros((len(corners), len(corners), *blocks.shape[3:]), corners.dtype)
        i, j = self.ends(kind)
        return total.at[simplices[:, :, None], simplices[:, None]].add(blocks)[i, j]


def _triangle(corners: Float[Array, "3 2"], lineal: Scalar) -> Float[Array, "3 3 2 2"]:
    def angles(corners):
        (ax, ay), (bx, by) = ((jnp.roll(corners, -k, axis=0) - corners).T for k in (1, 2))
        return jnp.arctan2(ax * by - ay * bx, ax * bx + ay * by)

    edges = corners[None] - corners[:, None]
    squared = jnp.sum(edges**2, axis=2) + jnp.eye(3, dtype=corners.dtype)
    area = determinant([*edges[0, 1:]])
    stiff = jnp.stack(
        [
            squared[0, 1] * squared[0, 2],
            squared[1, 2] * squared[1, 0],
            squared[2, 0] * squared[2, 1],
        ]
    )
    rates = jax.jacfwd(angles)(corners)
    turning = einsum("k,kia,kjb->ijab", stiff / area**2, rates, rates)  # 1 / sin^2
    return turning - lineal * edges[..., None] * edges[..., None, :] / squared[..., None, None] ** 2


_ENDS = np.array(
    [(i, j, *sorted({0, 1, 2, 3} - {i, j})) for i, j in itertools.permutations(range(4), 2)]
).T
"""The two corners of each edge of a tetrahedron, then the two other corners."""


def _tetrahedron(corners: Float[Array, "4 3"], lineal: Scalar) -> Float[Array, "4 4"]:
    """Stiffnesses of edges: lineal, and by the angle between the faces opposite to the ends."""
    i, j, k, m = (corners[ends] for ends in _ENDS)
    normal_i, normal_j = (
        jnp.cross(m - k, i - k),
        jnp.cross(m - k, j - k),
    )  # both faces have the edge k m
    both = jnp.sum(normal_i**2, axis=1) * jnp.sum(normal_j**2, axis=1)
    sine = jnp.sum(jnp.cross(normal_i, normal_j) ** 2, axis=1)
    stiff = (lineal + both / sine) / jnp.sum((j - i) ** 2, axis=1)
    return jnp.zeros((4, 4), corners.dtype).at[_ENDS[0], _ENDS[1]].set(-stiff)
