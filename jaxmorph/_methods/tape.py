"""A plan's map as a list of linear steps, which `native/jmplan.h` runs without JAX."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.sparse import csr_array, diags_array, eye_array

from .._host.rows import Rows
from .._kernels.values import as_jax
from .base import AbstractMethod
from .corrections import DelaunayGraph, LocalCorrection, NearWall
from .inverse_distance import AT_NODE, InverseDistance, InverseDistanceFactors, nearest_bound
from .multiscale import Hierarchy, Multiscale
from .rbf import basis as bases
from .rbf.expansion import Expansion, RBFFactors
from .rbf.fitted import Cholesky, FitFactors, FittedRBF, WallIds
from .rbf.rbf import RBF
from .rbf.system import polynomial
from .reconstruction import OfBoth, SurfaceReconstruction
from .turn import WallTurn, WallTurnIds

CODES = (
    "add",
    "shift",
    "take",
    "put",
    "sparse",
    "dense",
    "cholesky",
    "ldl",
    "kernel",
    "mean",
    "plane",
    "turn",
    "pair",
    "copy",
    "forward",
)
"""Names of steps: the first has the code 1 in the file."""

FUNCTIONS = (
    bases.ThinPlateSpline,
    bases.LinearSpline,
    bases.CubicSpline,
    bases.Gaussian,
    bases.Multiquadric,
    bases.InverseMultiquadric,
    bases.InverseQuadratic,
    bases.WendlandC0,
    bases.WendlandC2,
    bases.WendlandC4,
    bases.WendlandC6,
    bases.CompactC0,
    bases.CompactC1,
    bases.CompactC2a,
    bases.CompactC2b,
)
"""Bases, in the order of their numbers in the file."""

# registers of the displacement and of the points
U = 0
POINTS = 1
# flags: the components of all rows are one vector; by the transpose; subtracted
ONE_VECTOR = 1
TURNED = 2
MINUS = 4


@dataclasses.dataclass
class Tape:
    """Linear steps between registers, arrays of rows in `dimension` components.

    A step is (code, register that changes, register that is read or -1, five arrays or -1, number).
    What is computed from a register is added to the register `out`, by default to a new one; its
    number is returned.
    """

    dimension: int
    rows: list[int] = dataclasses.field(default_factory=list)
    arrays: list[np.ndarray] = dataclasses.field(default_factory=list)
    steps: list[tuple[int, ...]] = dataclasses.field(default_factory=list)
    known: dict[tuple[int, str], tuple[int, Any]] = dataclasses.field(default_factory=dict)

    def register(self, rows: int) -> int:
        self.rows.append(rows)
        return len(self.rows) - 1

    def array(self, values: Any, kind: str = "") -> int:
        """Adds an array of its own `kind`: numbers of eight bytes, ids of four."""
        kind = kind or ("f8" if np.asarray(values).dtype.kind == "f" else "i4")
        key = id(values), kind
        if key not in self.known:  # the entry holds the array, whose `id` no other one then gets
            self.known[key] = len(self.arrays), values
            self.arrays.append(np.ascontiguousarray(np.asarray(values), f"<{kind}").ravel())
        return self.known[key][0]

    def step(self, name: str, out: int, source: int = -1, *arrays: Any, number: int = 0) -> None:
        """Adds a step; `arrays` may be numbers of arrays, or matrices, which are three arrays."""
        numbers = []
        for array in arrays:
            if isinstance(array, csr_array):
                numbers += [
                    self.array(array.indptr, "i8"),
                    *map(self.array, (array.indices, array.data)),
                ]
            else:
                numbers.append(array if isinstance(array, int) else self.array(array))
        padded = (*numbers, *[-1] * (5 - len(numbers)))
        self.steps.append((CODES.index(name) + 1, out, source, *padded, number))

    def copy(self, source: int) -> int:
        out = self.register(self.rows[source])
        self.step("add", out, source, number=1)
        return out

    def take(self, source: int, rows: np.ndarray) -> int:
        out = self.register(len(rows))
        self.step("take", out, source, rows)
        return out

    def sparse(self, source: int, matrix: Any, out: int | None = None) -> int:
        out = self.register(matrix.shape[0]) if out is None else out
        matrix = csr_array(matrix)
        matrix.eliminate_zeros()
        self.step("sparse", out, source, matrix)
        return out

    def dense(self, source: int, matrix: Any, flags: int = 0, out: int | None = None) -> int:
        out = self.register(matrix.shape[1 if flags & TURNED else 0]) if out is None else out
        self.step("dense", out, source, matrix, number=flags)
        return out

    def mix(self, source: int, out: int, entries: tuple[Any, Any], left: Any, right: Any) -> None:
        """Adds left[k] (right[k] . row j of the source) to row i, for each entry k at (i, j)."""
        # A step treats all components alike. So for each pair of components a copy of the source
        # has the one that is read in the place of the one that changes, and zeros elsewhere.
        axes = np.eye(self.dimension)
        shape = self.rows[out], self.rows[source]
        for c, e in np.ndindex(self.dimension, self.dimension):
            weights = left[:, c] * right[:, e]
            if weights.any():
                copy = self.copy(source)
                every = np.ones(shape[1], dtype=bool)
                self.rows_in_place("turn", copy, every, axes[c][:, None] * axes[e])
                self.sparse(copy, csr_array((weights, entries), shape), out)

    def cholesky(self, out: int, factor: Cholesky, flags: int = 0) -> int:
        """Solves in place."""
        packed = factor.lower[np.tril_indices(len(factor.lower))]
        self.step("cholesky", out, -1, packed, factor.size, number=flags)
        return out

    def ldl(self, out: int, matrix: np.ndarray) -> None:
        """Solves by Bunch and Kaufman's factors of a symmetric matrix, in place."""
        lower, blocks, order = scipy.linalg.ldl(matrix)
        packed = lower[order][np.tril_indices(len(lower))]
        diagonals = (np.diagonal(blocks), np.append(np.diagonal(blocks, -1), 0.0))
        self.step("ldl", out, -1, packed, *diagonals, order)

    def rows_in_place(self, name: str, out: int, is_chosen: Any, matrix: Any) -> None:
        """A step "plane" with its normal, or "turn" with its matrix, for the chosen rows."""
        if is_chosen.any():
            self.step(name, out, -1, np.flatnonzero(is_chosen), matrix)


@dataclasses.dataclass(frozen=True)
class Places:
    """Points at which a field is added to a register, and each point's place."""

    points: Any
    placed: Any
    share: Any = 1.0  # of each point in the field, or of all

    def of(self, placed: Any, share: Any = 1.0) -> "Places":
        return Places(self.points, placed, self.share * share)

    @property
    def shares(self) -> Any:
        return self.share if np.ndim(self.share) else -1

    def matrix(self, columns: int) -> csr_array:
        """The weights of an `Interpolation`, times the shares."""
        weights = self.placed.matrix(columns)
        share = np.broadcast_to(self.share, weights.shape[:1])
        matrix = csr_array(diags_array(share) @ weights)
        matrix.sum_duplicates()
        return matrix


Field = Callable[[int, Places], None]  # adds a displacement field at places to a register


@dataclasses.dataclass(frozen=True)
class SurfaceRows:
    """The surface's rows: the register of their displacement, and their points. A correction has
    the coarse field, too, if it is known at any place: as `Remainder` has it.
    """

    u: int
    points: Any
    coarse: "Coarse | None" = None

    @property
    def count(self) -> int:
        return len(self.points)


@dataclasses.dataclass(frozen=True)
class Coarse:
    """A coarse field, and registers of what it was given, and of its values, at the rows."""

    field: Field
    u: int
    at_surface: int


@functools.singledispatch
def record(method: AbstractMethod, tape: Tape, ids: Any, factors: Any, rows: SurfaceRows) -> Field:
    """Records the solve of a method as steps, as its `field` does it."""
    raise ValueError(
        f"{type(method).__name__} cannot be exported. A plan in a file is a linear map without a "
        "solve on cells: of RBF, "
        "FittedRBF, InverseDistance, DelaunayGraph, NearWall, LocalCorrection, Multiscale, and "
        "SurfaceReconstruction of two."
    )


@record.register
def _(method: SurfaceReconstruction, tape, ids: OfBoth, factors: OfBoth, rows) -> Field:
    coarse = record(method.coarse, tape, ids.coarse, factors.coarse, rows)
    at_surface = tape.register(rows.count)
    coarse(at_surface, Places(rows.points, factors.at_surface))
    offset = tape.copy(rows.u)
    tape.step("add", offset, at_surface, number=-1)  # eq. (5)
    known = Coarse(coarse, rows.u, at_surface) if factors.at_surface is None else None
    left = SurfaceRows(offset, rows.points, known)
    correction = record(method.correction, tape, ids.correction, factors.correction, left)

    def add(out: int, places: Places) -> None:
        coarse(out, places.of(places.placed.coarse))
        correction(out, places.of(places.placed.correction))

    return add


@record.register(DelaunayGraph)
@record.register(LocalCorrection)
def _(method, tape, ids, factors, rows) -> Field:
    return _Interpolated(tape, rows.u)


@record.register
def _(method: Multiscale, tape, ids: Hierarchy, factors, rows) -> Field:
    own = np.arange(rows.count)
    has_function = (ids.nearest != own).astype(float)
    values = tape.sparse(rows.u, diags_array(has_function))
    below = csr_array((factors.entries, (ids.row, ids.column)), (rows.count, rows.count))
    # rows in the order of the sweep, in which each comes after all columns of its entries
    swept = ids.forward.owner[(ids.forward.entries >= 0).any(axis=2)]
    order = np.array(list(dict.fromkeys([*np.setdiff1d(own, swept), *swept])))
    tape.step("forward", values, -1, below, order)
    return _Interpolated(tape, values)


@record.register
def _(method: NearWall, tape, ids, factors, rows) -> Field:
    alone = dataclasses.replace(rows, coarse=None)
    correction = record(method.correction, tape, ids.correction, factors.correction, alone)
    slope = None if ids.turn is None else _record_turn(tape, ids.turn, factors.turn, rows)
    is_one = isinstance(correction, _Interpolated) and correction.values == rows.u

    def add(out: int, places: Places) -> None:
        place = places.placed
        inner = places.of(place.correction, 1 - place.share)
        wall = places.of(place.wall, place.share).matrix(rows.count)
        if is_one:  # one product in place of two
            wall = wall + inner.matrix(rows.count)
        else:
            correction(out, inner)
        tape.sparse(rows.u, wall, out)
        if slope is not None:
            tape.sparse(slope, places.of(place.wall, place.rise).matrix(rows.count), out)

    return add


def _record_turn(tape: Tape, ids: WallTurnIds, turn: WallTurn, rows: SurfaceRows) -> int:
    """Records `WallTurn.turned`; returns its register."""
    out = tape.register(rows.count)
    u = rows.u if rows.coarse is None else rows.coarse.u
    own = np.arange(rows.count)
    axis = np.eye(tape.dimension)[:1]
    first, second = ids.pairs.T
    along = -turn.strength[first][:, None] * turn.slopes
    entries = (np.tile(first, 2), np.concatenate([second, first]))
    tape.mix(u, out, entries, np.concatenate([along, -along]), turn.normal[entries[0]])
    growth = tape.register(int(ids.wall.max()) + 1)
    tape.mix(u, growth, (ids.wall, own), axis, turn.arms)
    tape.mix(growth, out, (own, ids.wall), turn.strength[:, None] * turn.normal, axis)
    if rows.coarse is not None:
        far = tape.register(rows.count)
        rows.coarse.field(far, Places(turn.probes, None))
        slope = turn.strength / turn.step
        tape.sparse(far, diags_array(-slope), out)
        tape.sparse(rows.coarse.at_surface, diags_array(slope), out)
    return out


@dataclasses.dataclass(frozen=True)
class _Interpolated:
    """A field of weighted sums of the rows of a register."""

    tape: Tape
    values: int

    def __call__(self, out: int, places: Places) -> None:
        self.tape.sparse(self.values, places.matrix(self.tape.rows[self.values]), out)


@record.register
def _(method: InverseDistance, tape, ids, factors: InverseDistanceFactors, rows) -> Field:
    alpha = float(method.alpha)
    extent = float(factors.extent)
    bound = nearest_bound(method, np.float64)
    numbers = np.array([method.far, method.near, alpha, extent, bound, (AT_NODE * extent) ** 2])

    def add(out: int, places: Places) -> None:
        arrays = (places.points, rows.points, numbers, places.shares, factors.area)
        tape.step("mean", out, rows.u, *arrays)

    return add


@record.register
def _(method: RBF, tape, ids, factors: RBFFactors, rows) -> Field:
    chosen = _chosen(method.control(ids).sources, rows.count, len(factors.lu))
    return _expansion(method.expansion, tape, factors, tape.sparse(rows.u, chosen))


def _expansion(expansion: Expansion, tape: Tape, factors: RBFFactors, values: int) -> Field:
    """Solves for coefficients in the register of values, and returns the field of eq. (1)."""
    basis = expansion.basis
    kind = type(basis)
    if factors.cardinals is not None:
        raise ValueError(
            "RBF with Iterative() cannot be exported: take fewer sources, or "
            "jm.RBF(solver=jm.Direct())."
        )
    if kind not in FUNCTIONS:
        raise ValueError(
            f"the basis {kind.__name__} cannot be exported: native/jmplan.h computes "
            f"{', '.join(basis.__name__ for basis in FUNCTIONS)}."
        )
    # the matrix of eq. (3) again: half of a symmetric matrix's factors is enough
    matrix = np.empty_like(factors.lu)
    matrix[factors.order] = (np.tril(factors.lu, -1) + np.eye(len(matrix))) @ np.triu(factors.lu)
    tape.ldl(values, (matrix + matrix.T) / 2)
    scale = float(factors.scale)
    radius = float(getattr(basis, "radius", getattr(basis, "support_radius", 1.0)))
    factor = 1.0 if basis.scale_free else 1 / (scale * radius) ** 2
    numbers = np.array([*factors.centre, scale, factor])
    sources = factors.sources.T
    tail = len(factors.lu) - len(factors.sources)

    def add(out: int, places: Places) -> None:
        arrays = (places.points, sources, numbers, places.shares)
        tape.step("kernel", out, values, *arrays, number=FUNCTIONS.index(kind) + 256 * tail)

    return add


@record.register
def _(method: FittedRBF, tape, ids, factors: FitFactors | RBFFactors, rows) -> Field:
    if isinstance(factors, RBFFactors):
        return record(method.rbf, tape, ids, factors, rows)
    expansion = method.rbf.expansion
    count = rows.count
    height = len(factors.rbf.lu)
    affine = tape.cholesky(tape.dense(rows.u, factors.polynomial, TURNED), factors.affine)
    rest = tape.dense(affine, factors.polynomial, MINUS, tape.copy(rows.u))
    outer = tape.sparse(rest, _outside_matrix(ids, count))
    start, end = (_chosen(ends, count) for ends in ids.edges.T)
    moments = tape.dense(tape.sparse(rest, (start + end) / 2), factors.rings.moments)
    others = len(ids.fixed), len(ids.tips)
    shares = np.pad(factors.rings.shares, ((0, 0), others, (0, 0), (0, 0)))
    tape.dense(moments, shares, ONE_VECTOR, outer)
    fitted = tape.dense(tape.take(rest, ids.nodes), factors.nodes, TURNED)
    tape.dense(tape.sparse(rest, end - start), factors.edges, TURNED, fitted)
    tape.dense(outer, factors.outer, ONE_VECTOR | MINUS, fitted)
    tape.cholesky(fitted, factors.fit, ONE_VECTOR)
    # values of the sources: moving ones, those outside of the fit, and zeros for the polynomial
    moving = tape.rows[fitted]
    values = tape.sparse(fitted, eye_array(height, moving))
    tape.sparse(outer, eye_array(height, tape.rows[outer], k=-moving), values)
    terms = np.asarray(polynomial(as_jax(factors.rbf.sources), method.rbf.degree))
    tape.dense(affine, np.pad(terms, ((0, height - len(terms)), (0, 0))), out=values)
    return _expansion(expansion, tape, factors.rbf, values)


def _chosen(rows: np.ndarray, columns: int, height: int | None = None) -> csr_array:
    """The matrix that takes rows, over empty ones up to a `height`."""
    height = len(rows) if height is None else height
    starts = np.minimum(np.arange(height + 1), len(rows))
    return csr_array((np.ones(len(rows)), rows, starts), (height, columns))


def _outside_matrix(ids: WallIds, count: int) -> csr_array:
    """`WallIds.outside` as a matrix without rings: by its values for unit rows, of the few rows
    that it reads.
    """
    read = Rows(np.unique(np.concatenate([ids.moving, ids.fixed, ids.far, ids.tips.ravel()])))
    few = jax.tree.map(lambda leaf: read.of(leaf) if leaf.dtype.kind == "i" else leaf, ids)
    eye = jnp.eye(len(read.ids))
    rows = [eye[few.fixed], jnp.zeros((len(ids.far), len(eye))), as_jax(few).behind_tips(eye)]
    return csr_array(np.concatenate(rows)) @ _chosen(read.ids, count)
