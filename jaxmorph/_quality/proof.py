"""Proof that cells fold nowhere inside, and the margin by which they do not."""

import dataclasses
import functools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.topology import DIMENSION, solid
from .._host.package.arguments import between, checked, whole
from .._kernels.compile import by_place
from .._kernels.values import Either, as_jax, constant, is_known, namespace, smallest
from .._mesh.mesh import Mesh, PointsLike
from . import bernstein
from .bounds import DEPTH, ROOM, bounds
from .jacobian_form import JacobianForm, form_of, nodes_of
from .quality import check_solid, places, signs_of
from .report import Report, place_of_cell
from .vector import PerCell, Points, ValuesByType, in_blocks, join_values

Bounds = Float[np.ndarray, " k"]
IsDecided = Bool[np.ndarray, " k"]
ReferencePlaces = Float[np.ndarray, "k d"]
CellNumbers = Int[np.ndarray, " k"]


@dataclasses.dataclass(frozen=True, eq=False)
class Proof(Report):
    """Proves of each of k cells that it folds nowhere inside, or shows where it folds.

    det J is that of the map from the reference cell, positive where the cell is not folded in the
    handedness of the mesh. Cells stand one type after another, as in `mesh.cells`.

    - `lower`, `upper`: the least det J of the cell is between these, round-off included.
    - `size`: mean of det J over the undeformed cell, without sign: its volume over the volume of
      the reference cell.
    - `margin`: `lower` over `size`. It is 1 for an undeformed simplex, parallelogram or
      parallelepiped. `min_margin` is the smallest; NaN where a coordinate is.
    - `is_valid`: `lower` is positive, so the cell folds nowhere.
    - `is_invalid`: `upper` is negative, and so is det J, evaluated at `reference`. NaN coordinates
      count as well.
    - `is_unknown`: neither. `is_flat`: unknown cells whose det J touches zero to round-off, which
      no depth decides.
    - `valid`, `invalid`, `unknown`: numbers of cells. `from_start`: the number of cells that are
      invalid where the motion begins; 0 without a motion.
    - `reference`, `near`: where det J is `upper`, in the reference cell and in space (k, d).
    - `time`: when, from 0 at `base` to 1 at `points`; None without `base`. Bounds then hold for the
      whole motion.
    - `types`: type and number of cells; `depth`: how often cells were cut where the sign was open.
    - `ids`: the file's number of each cell, `Mesh.cell_ids`, by which tables and messages name it.
    - `counted`: False for boundary elements, which have no det J; their numbers are NaN.

    Reference cells have corners at 0 and 1: a triangle or tetrahedron is below the diagonal, a
    pyramid's apex is above its first corner. A piece of a polyhedron is valid or unknown: a
    polyhedron whose piece is folded may itself be sound.
    """

    rule = "bounds on det J"
    measures = ("margin", "lower", "upper", "size")
    rank = "_least"

    lower: Bounds
    upper: Bounds
    size: Bounds
    is_valid: IsDecided
    is_invalid: IsDecided
    is_flat: IsDecided
    reference: ReferencePlaces
    near: ReferencePlaces
    time: Bounds | None
    counted: IsDecided
    ids: CellNumbers
    types: tuple[tuple[str, int], ...]
    depth: int

    @property
    def is_inverted(self) -> IsDecided:
        return self.is_invalid

    @property
    def volume(self) -> Bounds:
        return self.size

    @property
    def centroid(self) -> ReferencePlaces:
        return self.near

    @property
    def valid(self) -> int:
        return int(self.is_valid.sum())

    @property
    def invalid(self) -> int:
        return int(self.is_invalid.sum())

    @property
    def unknown(self) -> int:
        return int(self.is_unknown.sum())

    @property
    def from_start(self) -> int:
        return 0 if self.time is None else int((self.is_invalid & (self.time == 0)).sum())

    @property
    def is_unknown(self) -> IsDecided:
        return self.counted & ~self.is_valid & ~self.is_invalid

    @property
    def margin(self) -> Bounds:
        return self.lower / self._unit

    @property
    def min_margin(self) -> float:
        return self.min("margin")

    @property
    def _unit(self) -> Bounds:
        return np.where(self.size > 0, self.size, 1)

    @property
    def _least(self) -> Bounds:
        return np.where(self.is_invalid, self.upper, self.lower) / self._unit

    @property
    def _levels(self) -> CellNumbers:
        return np.where(self.is_invalid, 0, np.where(self.is_valid, 2, 1))

    def raise_if_unproven(self) -> None:
        """Raises `ValueError` for invalid or unknown cells: how many, and where the first is."""
        if self.valid == self.count:
            return
        first = self.worst(1)[0]
        start = f", {self.from_start} from the start" if self.from_start else ""
        cure = "Try smaller steps or `improve`." if self.invalid else "Try a larger `depth`."
        raise ValueError(
            f"{self.invalid} of {self.count} cells fold inside{start}, {self.unknown} are not "
            f"proven, first cell {self.ids[first]} "
            f"({self.type_of(first)}) near {place_of_cell(self, first)}. {cure}"
        )

    def type_of(self, cell: int | np.integer) -> str:
        """Names the type of a cell."""
        ends = np.cumsum([count for _, count in self.types])
        return self.types[int(np.searchsorted(ends, cell, side="right"))][0]

    def __repr__(self) -> str:
        return f"Proof({self.valid} valid, {self.invalid} invalid, {self.unknown} unknown)"

    def __str__(self) -> str:
        when = "" if self.time is None else " during the motion"
        lines = [
            f"{self.count} cells: {self.valid} proven valid, {self.invalid} invalid, "
            f"{self.unknown} unknown"
        ]
        if self.from_start:
            lines.append(f"{self.from_start} of them are invalid from the start of the motion.")
        if flat := int((self.is_flat & self.counted).sum()):
            lines.append(
                f"{flat} of the unknown have det J = 0 to round-off: no depth decides them."
            )
        lines.append(f"least det J{when} over the undeformed cell's mean, at depth {self.depth}:")
        time = "" if self.time is None else f"{'time':<5}"
        lines.append(
            f"{'cell':<8}{'type':<10}{'at least':>9}{'at most':>9} {time}{'inside':<15}near"
        )
        for cell in self.worst():
            time = "" if self.time is None else f"{_short(self.time[cell]):<5}"
            inside = " ".join(map(_short, self.reference[cell]))
            near = re.sub("[(,)]", "", place_of_cell(self, cell))
            numbers = f"{self.margin[cell]:>9.2g}{self.upper[cell] / self._unit[cell]:>9.2g}"
            kind = re.sub("^(tri|tet|hex)[a-z]*", r"\1", self.type_of(cell))
            lines.append(f"{self.ids[cell]:<8}{kind:<10}{numbers} {time}{inside:<15}{near}")
        return "\n".join(lines)


def _short(share: Any) -> str:
    return f"{share + 0.0:.2g}".removeprefix("0") or "0"


@checked
def proof(
    mesh: Mesh,
    points: PointsLike | None = None,
    *,
    base: PointsLike | None = None,
    depth: int = DEPTH,
) -> Proof:
    """Proves that cells fold nowhere inside: bounds det J, at `points` or during a motion.

    `quality` judges corners, between which a hexahedron or a curved cell may fold. Here det J is
    written in the Bernstein basis, whose least coefficient is a lower bound on it. Where that is
    negative and no corner is, the cell is cut into parts, whose bounds are closer. A bound includes
    round-off, so that `valid` is a proof for the coordinates as they are. The handedness of cells
    is that of the undeformed mesh, as `quality` finds it. It runs on the host, in double precision;
    `proven_margin` is traced. Source: Johnen, Remacle, Geuzaine, Geometrical validity of
    curvilinear finite elements, J. Comput. Phys. 233, 2013.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default `mesh.points`.
    - `base`: where they came from (n, d). The bounds then hold at every instant of the straight
      motion from `base` to `points`. Default: none, only `points` is judged.
    - `depth`: how often a cell is cut where its sign is open, default 4. Each cut halves all edges,
      and the time. A cell with few open parts is cut up to twice as often.

    **Raises:** `ValueError` for a mesh without cells of its own dimension, another shape of
    `points` or `base`, and traced points.
    """
    whole("depth", depth, 0)
    states = {"points": mesh.points if points is None else points} | (
        {} if base is None else {"base": base}
    )
    for name, x in states.items():
        places(mesh, x, name)
    if not is_known(states, mesh.points, tuple(mesh.cells.values())):
        raise ValueError(
            "`proof` speaks on the host and takes no traced points. `proven_margin` is traced."
        )
    check_solid(mesh, "det J is defined for these alone")
    ends = tuple(np.asarray(x, float) for x in list(states.values())[::-1])
    with np.errstate(all="ignore"):  # coordinates may be NaN
        return _proven(mesh, ends, depth)


def _proven(mesh: Mesh, ends: tuple[np.ndarray, ...], depth: int) -> Proof:
    """Bounds det J at one end or between two; folded pieces of polyhedra are unknown."""
    base = np.asarray(mesh.points, float)
    has_time = len(ends) == 2
    counted = np.repeat(
        [DIMENSION[kind] == base.shape[1] for kind in mesh.cells],
        list(map(len, mesh.cells.values())),
    )

    def among_all(rows: Float[np.ndarray, "*n s"]) -> Float[np.ndarray, "*n k"]:
        result = np.full((*rows.shape[:-1], len(counted)), np.nan)
        result[..., counted] = rows
        return result

    found = jax.tree.map(among_all, _bounded_cells(mesh, base, ends, depth))
    lower = found["lower"]
    upper = found["upper"]
    is_invalid = counted & ((found["value"] < 0) & (upper < 0) | np.isnan(upper))
    if mesh.polyhedra is not None:
        is_invalid &= ~np.isin(mesh.cell_ids, mesh.polyhedra.cut)
    is_valid = counted & (lower > 0)
    return Proof(
        lower=lower,
        upper=upper,
        size=found["size"],
        is_valid=is_valid,
        is_invalid=is_invalid,
        is_flat=counted & (found["is_flat"] > 0) & ~is_valid & ~is_invalid,
        reference=found["reference"].T,
        near=found["near"].T,
        time=found["time"] if has_time else None,
        counted=counted,
        ids=np.asarray(mesh.cell_ids),
        types=tuple((kind, len(ids)) for kind, ids in mesh.cells.items()),
        depth=depth,
    )


def _bounded_cells(
    mesh: Mesh, base: np.ndarray, ends: tuple[np.ndarray, ...], depth: int
) -> dict[str, np.ndarray]:
    signs = signs_of(mesh)
    columns = {}
    for kind, ids in solid(mesh.cells, base.shape[1]).items():
        size = _cells_at_once(np, form_of(kind, len(ends) == 2))
        bound = functools.partial(_bounded, kind, base, ends, depth)
        columns[kind] = in_blocks(
            np, bound, np.asarray(ids).T, np.asarray(signs[kind], float), size=size
        )
    return join_values(np, columns)


def _mean_jacobian(form: JacobianForm, points: Points, ids: Int[Either, "c k"]) -> PerCell:
    return form.mean(form.coefficients(nodes_of(ids, points)))


def _bounded(
    kind: str, base: np.ndarray, ends: tuple, depth: int, ids: Int[np.ndarray, "c k"], sign: Any
) -> dict[str, np.ndarray]:
    form = form_of(kind, len(ends) == 2)
    x = nodes_of(ids, *ends)
    columns = form.columns(x)
    found = bounds(form.space, sign * form.determinant(columns), form.round_off(x, columns), depth)
    at = form.inside(found.at)
    nodes = [np.concatenate([end[ids, axis] for end in ends]) for axis in range(base.shape[1])]
    return {
        "lower": found.lower,
        "upper": found.upper,
        "size": np.abs(_mean_jacobian(form_of(kind), base, ids)),
        "value": sign * form.values(columns, at),
        "is_flat": found.is_flat.astype(float),
        "time": at[0],
        "reference": form.reference(at),
        "near": form.places(nodes, at).T,
    }


TRACED_ROOM = 1 << 22  # coefficients in a block of JAX


@checked
def proven_margin(
    mesh: Mesh,
    points: PointsLike,
    *,
    base: PointsLike | None = None,
    depth: int = 0,
    sharpness: float | None = None,
) -> Float[Array, " k"]:
    """Bounds det J of whole cells from below, over its undeformed mean: above 0 no cell folds.

    It is the least Bernstein coefficient, `Proof.margin` but for round-off. Traced: `jit`, `grad`
    and `vmap` work over `points` and `base`. All cells are cut alike, since a traced program cannot
    depend on the sign.

    **Arguments:**

    - `mesh`, `points`, `base`: as `proof` takes them.
    - `depth`: how often each cell is cut, default 0. A cut makes 8 parts in 3-D, 4 in 2-D, with
      `base` twice as many.
    - `sharpness`: makes the bound smooth in the points. It is then lower, by log(coefficients) /
      sharpness at most, so above 0 it still is a proof. A hexahedron has 27 coefficients. Default
      None: the least coefficient itself.

    **Returns:** one number for each cell (k,), one type of cells after another; infinity for
    boundary elements.

    **Raises:** `ValueError` as `proof` does, and for a `sharpness` that is not positive.
    """
    now = places(mesh, points)
    start = None if base is None else places(mesh, base, "base")
    whole("depth", depth, 0)
    if sharpness is not None and is_known(sharpness):
        between("sharpness", sharpness, 0)
    check_solid(mesh, "det J is defined for these alone")
    with (
        jax.ensure_compile_time_eval()
    ):  # else XLA would compute it from constants while it compiles
        sizes = _undeformed(mesh.cells, jnp.asarray(mesh.points, now.dtype), signs_of(mesh))
    ends = (now,) if start is None else (start, now)
    return as_jax(_margins(mesh.cells, sizes, ends, depth, sharpness))


def _cells_at_once(xp: Any, form: JacobianForm, parts: int = 1) -> int:
    return max(
        1 if xp is np else 64,
        (ROOM if xp is np else TRACED_ROOM) // (bernstein.count_coefficients(form.space) * parts),
    )


@by_place
def _undeformed(cells: ValuesByType, points: Points, signs: ValuesByType) -> ValuesByType:
    """Mean det J of undeformed cells, with the proper sign; that sign where the mean is zero."""
    xp = namespace(points)
    sizes = {kind: sign.astype(points.dtype) for kind, sign in signs.items()}
    for kind, ids in cells.items():
        if DIMENSION[kind] == points.shape[1]:
            form = form_of(kind)
            size = in_blocks(
                xp,
                functools.partial(_mean_jacobian, form, points),
                ids.T,
                size=_cells_at_once(xp, form),
            )
            sizes[kind] *= abs(xp.where(size == 0, 1, size))
    return sizes


@by_place
def _margins(
    cells: ValuesByType, sizes: ValuesByType, ends: tuple[Either, ...], depth: int, sharpness: Any
) -> PerCell:
    xp = namespace(ends[0])
    margins = {}
    for kind, ids in cells.items():
        if DIMENSION[kind] == ends[0].shape[1]:
            form = form_of(kind, len(ends) == 2)
            size = _cells_at_once(xp, form, 2 ** (depth * sum(m for m, _ in form.space)))
            margin = functools.partial(_margin, form, ends, depth, sharpness)
            margins[kind] = in_blocks(xp, margin, ids.T, sizes[kind], size=size)
        else:
            margins[kind] = xp.full(len(ids), np.inf, ends[0].dtype)
    return join_values(xp, margins)


def _margin(
    form: JacobianForm,
    ends: tuple[Either, ...],
    depth: int,
    sharpness: Any,
    ids: Int[Either, "c k"],
    size: PerCell,
) -> PerCell:
    xp = namespace(ends[0])
    values = form.coefficients(nodes_of(ids, *ends)) / size[None]
    for _ in range(depth):
        values = bernstein.halved(form.space, values)
    values = values.reshape(-1, ids.shape[1])
    if sharpness is None:
        return smallest(values)
    least = constant(smallest(values))
    return least - xp.log(xp.sum(xp.exp(-sharpness * (values - least[None])), axis=0)) / sharpness
