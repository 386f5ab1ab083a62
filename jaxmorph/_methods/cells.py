"""Methods that solve a linear system on the mesh's cells: ids, the matrix, and the field."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.topology import CORNERS
from .._host.linear import systems
from .._host.package.rounding import nearest_of
from .._kernels.callback import host_call
from .._kernels.compile import compiled
from .._kernels.values import jax_arrays, norm
from .base import AbstractMethod, AbstractWhole, Pairs, Points, Rows, Scalar, einsum, matmul
from .blocks import fold_rows
from .rbf.expansion import is_sound
from .surface import ByKind, Surface

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
            above = jax.ops.segment_sum(scaled(_transposed(self.values), x[i]), j, len(x))
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


def _transposed(blocks: Float[Array, "e ..."]) -> Float[Array, "e ..."]:
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
        fields = jax_arrays(pairs=pairs, frame=frame, free=free, wall=wall, rows=rows, nodes=nodes)
        return NodeIds(cells=of_kind, **fields), volume

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
            ids[kind] = CellIds(**jax_arrays(corners=corners[kind], entry=entry, flipped=i > j))
        return np.stack(np.divmod(unique, n), axis=1), ids

    def fit(self, ids: NodeIds, surface, points):
        places = matmul(points, ids.frame.astype(points.dtype))
        n = len(places)
        distance = norm(places - places[ids.wall])
        first, *others = [self._of_cells(kind, ids, places, distance) for kind in ids.cells]
        values = sum(others, start=first)
        i, j = ids.pairs.T
        diagonal = -jax.ops.segment_sum(values, i, n) - jax.ops.segment_sum(
            _transposed(values), j, n
        )
        return NodeFactors(values, diagonal, self.masses(ids, places), places)

    def _of_cells(self, kind: str, ids: NodeIds, places, distance):
        cells = ids.cells[kind]

        @jax.vmap
        @jax.checkpoint
        def entries(corners, flipped):
            values = self.entries(kind, places[corners], distance[corners])
            flipped = flipped.reshape(-1, *(1,) * (values.ndim - 1))
            return jnp.where(flipped, _transposed(values), values)

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
            float(_refinement(ids, factors, u)),
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
def _refinement(ids: NodeIds, factors: NodeFactors, u: Rows) -> Scalar:
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
