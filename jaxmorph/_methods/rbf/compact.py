"""Radial basis functions of compact support at all nodes of the surface: one sparse system."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import dtypes
from jaxtyping import Array, Bool, Float, Int

from ..._host.package.rounding import Tree, extent_of, roundoff
from ..._host.sources.hierarchy import overlaps, padded
from ..._host.sources.reduction import drop_close
from ..._kernels.compile import compiled
from ..._kernels.values import as_jax, jax_arrays
from ..base import AbstractPlacing, Control, Flag, Pairs, Point, Rows, Scalar, number_or_none
from ..cells import NodeFactors
from ..sparse import SEARCH_SLACK, InterpolatedField, NodeSearch, Reach, is_lost, squared_distance
from ..surface import Surface
from .basis import WendlandC2
from .expansion import is_sound, warn_of_close

RADIUS_NEIGHBOURS = 200  # nodes within the automatic radius of half of the moving nodes
WITHIN = (
    1 - 1e-6
)  # share of a squared radius at which a function counts as zero: its value there is 1e-24


class CompactIds(eqx.Module):
    """Ids of the surface's b rows."""

    stands: Int[Array, " b"]  # the row that has the function of all rows at its place
    speaks: Bool[
        Array, " b"
    ]  # whether a row's displacement counts; a fixed row at a moving row's place does not
    pairs: Pairs  # rows with functions, within the search's distance of each other
    radius: Scalar  # the functions' radius
    search: NodeSearch  # the coordinates of the search

    @property
    def has_function(self) -> Bool[Array, " b"]:
        return self.stands == jnp.arange(len(self.stands))

    def at_functions(self, u: Rows) -> Rows:
        """The mean displacement of the rows that speak at each function; 0 elsewhere."""
        count = jax.ops.segment_sum(self.speaks.astype(u.dtype), self.stands, len(u))
        total = jax.ops.segment_sum(jnp.where(self.speaks[:, None], u, 0), self.stands, len(u))
        return jnp.where(self.has_function[:, None], total / jnp.maximum(count, 1)[:, None], 0)


class CompactFactors(eqx.Module):
    radius: Scalar
    matrix: NodeFactors
    has_function: Bool[Array, " b"]
    is_certain: Flag

    def reaches(self, x: Float[Array, "*k d"], y: Float[Array, "*m d"]) -> Bool[Array, "*n"]:
        """Checks whether a function at y reaches x; at the very end of the reach it does not."""
        return squared_distance(x, y) < WITHIN * self.radius**2

    def count(self, x: Point, surface: Rows) -> Int[Array, ""]:
        return (self.has_function & self.reaches(x[None], surface)).sum()


class CompactRBF(AbstractPlacing):
    """Interpolates with a Wendland C2 function of one radius at every surface node.

    The system is sparse. The field is exact at the nodes, and zero beyond the radius from all
    nodes. It has no polynomial, so alone it does not even reproduce a translation. It may be a
    correction too. Cells fold where the motion is a good part of the radius, so take a radius of
    several times the largest displacement. By default the `radius`, in the mesh's units, reaches
    200 nodes of the surface, or all of it, from half of the moving nodes. Memory is that of the
    pairs of nodes within the radius. Duplicate nodes have one function: within 1.5e-8 (3.5e-4 in
    float32) times the radius or the extent of the surface, whichever is less, they are equal in the
    matrix. The function takes the mean of their displacements, of moving nodes alone where fixed
    nodes are among them. Each node still goes where `u` sends it. The field is one-valued, so it
    does not follow the two sides of a crack that opens. `LinearElasticity`, which sees cells, does.

    **Raises:** `ValueError` for a radius that is not positive and finite. `prepare` raises it if
    rounding changes displacements by more than 1 %, because the radius is too wide, and warns from
    1e-6 on (1e-3 in float32). It also warns of pairs of nodes that are nearer to each other than
    1/1000 of the distance to the next nodes: the difference of a pair comes out a thousandfold.
    `refit` raises it where nodes have come within the radius since the plan was made; traced code
    answers NaN there.
    """

    radius: Scalar | None = eqx.field(converter=number_or_none("radius", 0), default=None)

    def connect(self, surface: Surface, points):
        nodes = surface.points.astype(float)
        dtype = dtypes.canonicalize_dtype(surface.points.dtype)
        if self.radius is None:
            count = min(RADIUS_NEIGHBOURS, len(nodes))
            reach = np.asarray(Tree(nodes).query(nodes[: surface.moving], k=count)[0]).reshape(
                surface.moving, -1
            )
            radius = float(np.median(reach[:, -1]))
        else:
            radius = float(self.radius)
        # there 1 - phi is a few units of rounding
        indistinct = float(np.sqrt(np.finfo(dtype).eps)) * min(radius, float(extent_of(nodes)))
        owners = drop_close(nodes, np.arange(len(nodes)), max(roundoff(surface.points), indistinct))
        stands = owners[np.asarray(Tree(nodes[owners]).query(nodes)[1])]
        moves = np.arange(len(nodes)) < surface.moving
        speaks = moves | (np.bincount(stands, moves, minlength=len(nodes)) == 0)[stands]
        distance = (1 + SEARCH_SLACK) * radius
        pairs = np.asarray(
            Tree(nodes[owners]).query_pairs(distance, output_type="ndarray"), np.int32
        ).reshape(-1, 2)
        near = overlaps(nodes, owners, np.full(len(nodes), distance), points.astype(float))
        reach = Reach(*as_jax(padded(*near, len(points))))
        search = NodeSearch(*as_jax((points, surface.points, np.asarray(distance))))
        ids = jax_arrays(stands=stands, speaks=speaks, pairs=owners[pairs], radius=radius)
        return CompactIds(**ids, search=search), reach

    def control(self, ids: CompactIds):
        return Control(reach=float(ids.radius))

    def fit(self, ids: CompactIds, surface, points):
        radius = ids.radius if self.radius is None else self.radius
        i, j = ids.pairs.T
        values = WendlandC2(radius)(jnp.sum((surface[i] - surface[j]) ** 2, axis=1))
        none = jnp.zeros((len(surface), 0), values.dtype)
        matrix = NodeFactors(values, jnp.ones_like(surface[:, 0]), none[0], none)
        is_certain = ids.search.is_certain(radius, surface, points)
        factors = CompactFactors(radius, matrix, ids.has_function, is_certain)

        def look():
            count = jax.lax.map(lambda x: factors.count(x, surface), surface)
            listed = factors.reaches(surface[i], surface[j]).sum()
            return jnp.sum(count * ids.has_function) > 2 * listed + ids.has_function.sum()

        lost = is_lost(is_certain, look)
        return eqx.tree_at(
            lambda factors: factors.matrix.values, factors, jnp.where(lost, jnp.nan, values)
        )

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors: CompactFactors, surface):
        def look():
            listed = factors.reaches(x[None], surface[ids.nodes])
            return factors.count(x, surface) > (listed & ids.reached).sum()

        lost = is_lost(factors.is_certain, look)
        weights = WendlandC2(factors.radius)(jnp.sum((surface[ids.nodes] - x[None]) ** 2, axis=1))
        return ids.weighted(weights, lost)

    def field(self, ids: CompactIds, factors: CompactFactors, surface, u):
        free = jnp.broadcast_to(ids.has_function[:, None], u.shape)
        return InterpolatedField(factors.matrix.solve(ids.pairs, free, ids.at_functions(u)))

    def check(self, ids: CompactIds, factors: CompactFactors, u):
        error = float(_error_at_nodes(self, ids, factors, u))
        dtype = factors.matrix.values.dtype
        nodes = np.asarray(ids.search.surface, dtype=float)[np.asarray(ids.has_function)]
        matrix = (
            f"the matrix of CompactRBF, of {len(nodes)} nodes and radius "
            f"{float(factors.radius):.3g}"
        )
        is_sound(
            error,
            dtype,
            lambda fault: f"{matrix}, is {fault}. Try a smaller radius.",
            "not positive, or no solve converged",
        )
        warn_of_close(nodes, float(factors.radius), "CompactRBF")


@compiled
def _error_at_nodes(
    method: CompactRBF, ids: CompactIds, factors: CompactFactors, u: Rows
) -> Scalar:
    reached = factors.matrix.times(ids.pairs, method.field(ids, factors, u, u).u)
    missed = jnp.where(ids.has_function[:, None], ids.at_functions(u) - reached, 0)
    return jnp.abs(missed).max() / jnp.abs(u).max()
