"""A plan's map as a list of linear steps, which `native/jmplan.h` runs without JAX."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.sparse import csr_array, diags_array, vstack

from .base import AbstractMethod
from .corrections import DelaunayGraph, Layered, LocalCorrection, NearWall
from .inverse_distance import SMALLEST, InverseDistance, InverseDistanceFactors, nearest_bound
from .multiscale import Hierarchy, Multiscale
from .rbf import basis as bases
from .rbf.expansion import Expansion, RBFFactors
from .rbf.fitted import Cholesky, FitFactors, FittedRBF, WallIds, deflection
from .rbf.rbf import RBF
from .rbf.system import polynomial
from .reconstruction import SurfaceReconstruction
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

U = 0
POINTS = 1  # registers of the displacement and of the points
FLAT, TURNED, MINUS = (
    1,
    2,
    4,
)  # flags: the components of all rows are one vector; by the transpose; subtracted


@dataclasses.dataclass
class Tape:
    """Linear steps between registers, arrays of rows in `dimension` components.

    A step is (code, register that changes, register that is read or -1, five arrays or -1, number).
    `array` and `register` return numbers for steps.
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

    def step(self, name: str, out: int, source: int = -1, *arrays: int, number: int = 0) -> None:
        padded = (*arrays, *[-1] * (5 - len(arrays)))
        self.steps.append((CODES.index(name) + 1, out, source, *padded, number))

    def sparse(self, out: int, source: int, matrix: Any) -> None:
        matrix = csr_array(matrix)
        matrix.eliminate_zeros()
        arrays = (
            self.array(matrix.indptr, "i8"),
            self.array(matrix.indices),
            self.array(matrix.data),
        )
        self.step("sparse", out, source, *arrays)

    def dense(self, out: int, source: int, matrix: Any, flags: int = 0) -> None:
        """Adds a matrix times a register; `flags` are `FLAT`, `TURNED` and `MINUS`."""
        self.step("dense", out, source, self.array(matrix), number=flags)

    def cholesky(self, out: int, factor: Cholesky, flags: int = 0) -> None:
        """Solves in place."""
        packed = factor.lower[np.tril_indices(len(factor.lower))]
        self.step("cholesky", out, -1, self.array(packed), self.array(factor.size), number=flags)

    def ldl(self, out: int, matrix: np.ndarray) -> None:
        """Solves by Bunch and Kaufman's factors of a symmetric matrix, in place."""
        lower, blocks, order = scipy.linalg.ldl(matrix)
        packed = lower[order][np.tril_indices(len(lower))]
        diagonals = np.diagonal(blocks), np.append(np.diagonal(blocks, -1), 0.0)
        self.step(
            "ldl", out, -1, self.array(packed), *map(self.array, diagonals), self.array(order)
        )

    def rows_in_place(self, name: str, out: int, is_chosen: Any, matrix: Any) -> None:
        """A step "plane" with its normal, or "turn" with its matrix, for the chosen rows."""
        if is_chosen.any():
            self.step(name, out, -1, self.array(np.flatnonzero(is_chosen)), self.array(matrix))


@dataclasses.dataclass(frozen=True)
class Places:
    """Points at which a field is added to a register: the array, and each point's place."""

    points: int
    placed: Any
    share: Any = 1.0  # of each point in the field, or of all

    def of(self, placed: Any, share: Any = 1.0) -> "Places":
        return Places(self.points, placed, self.share * share)

    def recorded(self, tape: Tape) -> int:
        return tape.array(self.share) if np.ndim(self.share) else -1


Field = Callable[[Tape, int, Places], None]  # adds a displacement field at places to a register


@dataclasses.dataclass(frozen=True)
class SurfaceRows:
    """The surface's rows: register of their displacement, array of their points."""

    u: int
    points: int
    count: int


@functools.singledispatch
def recorded(
    method: AbstractMethod, tape: Tape, ids: Any, factors: Any, rows: SurfaceRows
) -> Field:
    """Records the solve of a method as steps, as its `field` does it."""
    raise ValueError(
        f"{type(method).__name__} cannot be exported. A plan in a file is a linear map without a "
        "solve on cells: of RBF, "
        "FittedRBF, InverseDistance, DelaunayGraph, NearWall, LocalCorrection, Multiscale, and "
        "SurfaceReconstruction of two."
    )


@recorded.register
def _(method: SurfaceReconstruction, tape, ids, factors, rows) -> Field:
    coarse = recorded(method.coarse, tape, ids[0], factors[0], rows)
    at_surface, offset = (tape.register(rows.count) for _ in range(2))
    coarse(tape, at_surface, Places(rows.points, factors[1]))
    tape.step("add", offset, rows.u, number=1)
    tape.step("add", offset, at_surface, number=-1)  # eq. (5)
    left = SurfaceRows(offset, rows.points, rows.count)
    if isinstance(method.correction, NearWall) and ids[1] is None:
        turn = _turned(tape, ids[2].turn, factors[2].turn, rows, (coarse, at_surface))
        correction = _layered(method.correction, tape, ids[2], factors[2], left, turn)
    else:
        correction = recorded(method.correction, tape, ids[2], factors[2], left)

    def add(tape: Tape, out: int, places: Places) -> None:
        coarse(tape, out, places.of(places.placed[0]))
        correction(tape, out, places.of(places.placed[1]))

    return add


@recorded.register(DelaunayGraph)
@recorded.register(LocalCorrection)
def _(method, tape, ids, factors, rows) -> Field:
    return _Interpolated(rows.u)


@recorded.register
def _(method: Multiscale, tape, ids: Hierarchy, factors, rows) -> Field:
    count = rows.count
    values = tape.register(count)
    own = np.arange(count)
    row = ids.row
    column = ids.column
    has_function = ids.nearest != own
    tape.sparse(values, rows.u, csr_array((has_function.astype(float), (own, own)), (count, count)))
    below = csr_array((factors.entries, (row, column)), (count, count))
    level = np.full(count, -1)
    higher = np.zeros(count, np.int64)
    while (level != higher).any():  # until each row is above all columns of its entries
        level = higher
        higher = higher.copy()
        np.maximum.at(higher, row, level[column] + 1)
    arrays = tape.array(below.indptr, "i8"), tape.array(below.indices), tape.array(below.data)
    tape.step("forward", values, -1, *arrays, tape.array(np.argsort(level, kind="stable")))
    return _Interpolated(values)


@recorded.register
def _(method: NearWall, tape, ids, factors, rows) -> Field:
    turn = _turned(tape, ids.turn, factors.turn, rows, None)
    return _layered(method, tape, ids, factors, rows, turn)


def _layered(
    method: NearWall, tape: Tape, ids: Layered, factors: Layered, rows: SurfaceRows, turn: int
) -> Field:
    """Records `turned_field`, whose slopes are in the register `turn`, or -1 for none."""
    correction = recorded(method.correction, tape, ids.correction, factors.correction, rows)
    count = rows.count

    def add(tape: Tape, out: int, places: Places) -> None:
        place = places.placed
        wall = _matrix(places.of(place.wall, place.share), count)
        inner = places.of(place.correction, 1 - place.share)
        is_one = isinstance(correction, _Interpolated) and correction.values == rows.u
        if is_one:  # one product in place of two
            wall = wall + _matrix(inner, count)
        tape.sparse(out, rows.u, wall)
        if not is_one:
            correction(tape, out, inner)
        if turn >= 0:
            tape.sparse(out, turn, _matrix(places.of(place.wall, place.rise), count))

    return add


def _turned(
    tape: Tape,
    ids: WallTurnIds | None,
    turn: WallTurn | None,
    rows: SurfaceRows,
    coarse: tuple[Field, int] | None,
) -> int:
    """Records `WallTurn.turned`; returns its register, or -1 for a wall that turns nothing.
    `coarse` is a field, and the register of its displacements at the rows.
    """
    if ids is None or turn is None:
        return -1
    count = rows.count
    out = tape.register(count)
    first, second = ids.pairs.T
    places = (np.tile(first, 2), np.concatenate([second, first]))
    for c, e in np.ndindex(tape.dimension, tape.dimension):
        weight = -turn.strength[first] * turn.slopes[:, c] * turn.normal[first, e]
        matrix = csr_array((np.concatenate([weight, -weight]), places), (count, count))
        _mixed(tape, (out, c), (rows.u, e), matrix)
    growth = tape.register(int(ids.wall.max()) + 1)
    entries = np.arange(count), ids.wall
    shape = count, tape.rows[growth]
    for e in range(tape.dimension):
        arms = csr_array((turn.arms[:, e], entries), shape)
        _mixed(tape, (growth, 0), (rows.u, e), arms.T)
    for c in range(tape.dimension):
        normal = csr_array((turn.strength * turn.normal[:, c], entries), shape)
        _mixed(tape, (out, c), (growth, 0), normal)
    if coarse is not None:
        field, near = coarse
        far = tape.register(count)
        field(tape, far, Places(tape.array(turn.probes), None))
        slope = turn.strength / turn.step
        tape.sparse(out, far, diags_array(-slope))
        tape.sparse(out, near, diags_array(slope))
    return out


def _mixed(tape: Tape, out: tuple[int, int], source: tuple[int, int], matrix: Any) -> None:
    """Adds a matrix times one component of a register to one component of another; both are pairs
    of register and component.
    """
    # a step treats all components alike: a copy has the one that counts in the other's place
    copy = tape.register(tape.rows[source[0]])
    tape.step("add", copy, source[0], number=1)
    axes = np.eye(tape.dimension)
    swap = axes[out[1]][:, None] * axes[source[1]]
    tape.rows_in_place("turn", copy, np.ones(tape.rows[copy], dtype=bool), swap)
    tape.sparse(out[0], copy, matrix)


@dataclasses.dataclass(frozen=True)
class _Interpolated:
    """A field of weighted sums of the rows of a register."""

    values: int

    def __call__(self, tape: Tape, out: int, places: Places) -> None:
        tape.sparse(out, self.values, _matrix(places, tape.rows[self.values]))


def _matrix(places: Places, columns: int) -> csr_array:
    matrix = places.placed.matrix(columns)
    matrix = csr_array(diags_array(np.broadcast_to(places.share, matrix.shape[:1])) @ matrix)
    matrix.sum_duplicates()
    return matrix


@recorded.register
def _(method: InverseDistance, tape, ids, factors: InverseDistanceFactors, rows) -> Field:
    alpha = float(method.alpha)
    extent = float(factors.extent)
    bound = nearest_bound(method, np.float64)
    numbers = tape.array([method.far, method.near, alpha, extent, bound, (SMALLEST * extent) ** 2])

    def add(tape: Tape, out: int, places: Places) -> None:
        arrays = (
            places.points,
            rows.points,
            numbers,
            places.recorded(tape),
            tape.array(factors.area),
        )
        tape.step("mean", out, rows.u, *arrays)

    return add


@recorded.register
def _(method: RBF, tape, ids, factors: RBFFactors, rows) -> Field:
    coefficients = tape.register(len(factors.lu))
    sources = method.control(ids).sources
    tape.sparse(coefficients, rows.u, _stacked([_chosen(sources, rows.count)], len(factors.lu)))
    return _expansion(method.expansion, tape, factors, coefficients)


def _expansion(expansion: Expansion, tape: Tape, factors: RBFFactors, values: int) -> Field:
    """Solves for coefficients in the register of values, and returns the field of eq. (1)."""
    kind = type(expansion.basis)
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
    basis = expansion.basis
    radius = float(getattr(basis, "radius", getattr(basis, "support_radius", 1.0)))
    factor = 1.0 if basis.scale_free else 1 / (scale * radius) ** 2
    numbers = tape.array([*factors.centre, scale, factor])
    sources = tape.array(factors.sources.T)
    tail = len(factors.lu) - len(factors.sources)

    def add(tape: Tape, out: int, places: Places) -> None:
        arrays = places.points, sources, numbers, places.recorded(tape)
        tape.step("kernel", out, values, *arrays, number=FUNCTIONS.index(kind) + 256 * tail)

    return add


@recorded.register
def _(method: FittedRBF, tape, ids: WallIds, factors: FitFactors, rows) -> Field:
    u = rows.u
    expansion = method.rbf.expansion
    count = rows.count
    terms = np.asarray(polynomial(jnp.asarray(factors.rbf.sources), method.rbf.degree))
    moving = len(ids.moving)
    tail = len(factors.rbf.lu)
    values = tape.register(tail)
    if not len(ids.edges):
        tape.sparse(values, u, _stacked([_chosen(np.append(ids.moving, ids.fixed), count)], tail))
        return _expansion(expansion, tape, factors.rbf, values)
    affine, rest, outer = map(
        tape.register, (factors.polynomial.shape[1], count, factors.outer.shape[3])
    )
    tape.dense(affine, u, factors.polynomial, TURNED)
    tape.cholesky(affine, factors.affine)
    tape.step("add", rest, u, number=1)
    tape.dense(rest, affine, factors.polynomial, MINUS)
    outside = [_chosen(ids.fixed, count), _rings(ids, count), _behind_tips(ids, count)]
    tape.sparse(outer, rest, vstack(outside))
    at_nodes, along = map(tape.register, (len(ids.nodes), len(ids.edges)))
    tape.step("take", at_nodes, rest, tape.array(ids.nodes))
    tape.sparse(along, rest, _chosen(ids.edges[:, 1], count) - _chosen(ids.edges[:, 0], count))
    solved = tape.register(moving)
    tape.dense(solved, at_nodes, factors.nodes, TURNED)
    tape.dense(solved, along, factors.edges, TURNED)
    tape.dense(solved, outer, factors.outer, FLAT | MINUS)
    tape.cholesky(solved, factors.fit, FLAT)
    tape.sparse(values, solved, _stacked([_chosen(np.arange(moving), moving)], tail))
    tape.sparse(values, rest, _stacked([csr_array((moving, count)), *outside], tail))
    tape.dense(values, affine, np.pad(terms, ((0, tail - len(terms)), (0, 0))))
    return _expansion(expansion, tape, factors.rbf, values)


def _chosen(rows: Any, columns: int) -> csr_array:
    return csr_array((np.ones(len(rows)), rows, np.arange(len(rows) + 1)), (len(rows), columns))


def _stacked(blocks: Sequence[csr_array], rows: int) -> csr_array:
    """Stacks sparse rows, and fills up with empty ones."""
    matrix = csr_array(vstack(blocks))
    matrix.resize((rows, blocks[0].shape[1]))  # pyright: ignore[reportOptionalSubscript]
    return matrix


def _rings(ids: WallIds, count: int) -> csr_array:
    """`WallIds.at_rings` as a matrix."""
    fade = np.asarray(deflection(jnp.asarray(ids.reach))) / max(1, len(ids.moving))
    rows, columns = map(np.ravel, np.meshgrid(np.arange(len(fade)), ids.moving, indexing="ij"))
    return csr_array((fade[rows], (rows, columns)), (len(fade), count))


def _behind_tips(ids: WallIds, count: int) -> csr_array:
    """`WallIds.behind_tips` as a matrix."""
    rows = np.repeat(np.arange(len(ids.tips)), 3)
    entries = np.tile([2.0, -0.5, -0.5], len(ids.tips)), (rows, ids.tips.ravel())
    return csr_array(entries, (len(ids.tips), count))
