"""A mesh whose pieces lie in the processes of an MPI run, none of which holds all (extra `mpi`)."""

try:
    from mpi4py import MPI
except (ImportError, RuntimeError) as error:  # the latter where mpi4py is there and no MPI library
    raise ImportError(
        "pieces over MPI need mpi4py and an MPI library: pip install 'jaxmorph[mpi]' mpich, or the machine's own MPI"
    ) from error

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int, Real

import jaxmorph as jm
from jaxmorph._boundary.symmetry import check_dimension, on_facing
from jaxmorph._host.package.arguments import check, shown
from jaxmorph._host.package.orders import rows_in
from jaxmorph._host.package.ranks import together

from ._shared import agree, faces_of, joined, owned

ROWS = Real[ArrayLike, "k d"] | Sequence[Any]


@dataclasses.dataclass(frozen=True)
class Piece:
    """Moves the piece of a mesh that this process has.

    `prepare` makes it; every process calls its functions together.

    - `comm`: the communicator.
    - `plan`: the plan of this piece's n points; its displacements are those of all moving nodes.
    - `nodes` (n,): the whole mesh's ids of the points.
    - `moving` (k,): the points that move, as `prepare` was given them.
    - `rows` (k,): the row of each in the displacement of all moving nodes.
    - `is_owner` (n,): whether this process, the first one that has the node, speaks for it.
    - `is_shared` (n,): whether other processes have the node too.
    """

    comm: Any
    plan: jm.Plan
    nodes: Int[np.ndarray, " n"]
    moving: Int[np.ndarray, " k"]
    rows: Int[np.ndarray, " k"]
    is_owner: Bool[np.ndarray, " n"]
    is_shared: Bool[np.ndarray, " n"]

    def deform(self, u: Real[ArrayLike, "k d"]) -> Float[np.ndarray, "n d"]:
        """Moves the piece: row i of `u` (k, d) displaces point `moving[i]`.

        Returns the piece's points (n, d). Nodes that processes share come from the one that owns
        them: they are equal bit for bit.

        Raises `ValueError`, in every process, for a `u` of another shape, and where processes
        displace a node that they share differently.
        """
        u = self.gathered(u)
        moved = np.array(together(self.comm, lambda: jm.deform(self.plan, u)))
        if self.comm.allreduce(int(self.is_shared.sum())):
            agree(self.comm, self.nodes, self.is_shared, self.is_owner, moved)
        return moved

    def pullback(self, u: Real[ArrayLike, "k d"], cotangent: Real[ArrayLike, "n d"]) -> Float[np.ndarray, "k d"]:
        """Pulls dJ/d(points) of the whole mesh back to this piece's moving nodes (k, d).

        `cotangent` (n, d) is the derivative by each node as a whole: processes that share a node
        give the same, and it counts once. It raises `ValueError` as `deform` does.
        """
        u = self.gathered(u)

        def of_piece() -> np.ndarray:
            check("cotangent", cotangent, ROWS, Piece.pullback)
            values = np.asarray(cotangent, dtype=float)
            if values.shape != self.plan.points.shape:
                raise ValueError(f"`cotangent` has shape {values.shape}; this piece has {self.plan.points.shape}.")
            return np.array(jm.pullback(self.plan, u, np.where(self.is_owner[:, None], values, 0)))

        total = together(self.comm, of_piece)
        self.comm.Allreduce(MPI.IN_PLACE, total)
        return total[self.rows]

    def pushforward(self, u: Real[ArrayLike, "k d"], tangent: Real[ArrayLike, "k d"]) -> Float[np.ndarray, "n d"]:
        """Pushes `tangent` (k, d), a change of `u` (k, d), forward to this piece's points (n, d).

        It is the derivative of `deform` in one direction. It raises `ValueError` as `deform` does.
        """
        u, tangent = self.gathered(u), self.gathered(tangent, "tangent")
        return np.array(together(self.comm, lambda: jm.velocity(self.plan, u, tangent)))

    def gathered(self, u: Real[ArrayLike, "k d"], name: str = "u") -> Float[np.ndarray, "m d"]:
        """Gathers all moving nodes' displacements from all processes; errors call them `name`."""

        def checked() -> np.ndarray:
            check(name, u, ROWS, Piece.deform)
            values = np.asarray(u, dtype=self.plan.points.dtype)
            expected = (len(self.moving), self.plan.points.shape[1])
            if values.shape != expected:
                raise ValueError(
                    f"`{name}` has shape {values.shape}; this piece moves {expected[0]} points: {expected}."
                )
            return values

        shares = self.comm.allgather((self.rows, together(self.comm, checked)))
        whole = np.full((self.plan.n_moving, self.plan.points.shape[1]), np.nan, self.plan.points.dtype)
        for rows, values in shares:
            whole[rows] = values
        torn = sum(int((whole[rows] != values).any(axis=1).sum()) for rows, values in shares)
        if torn and np.isfinite(whole).all():
            raise ValueError(f"{torn} moving nodes are displaced differently by the processes that share them.")
        return whole

    def summary(self, report: jm.QualityReport) -> "Summary":
        """Sums up reports, `quality(piece, points)`, of all pieces: each cell is in one."""
        together(self.comm, lambda: check("report", report, jm.QualityReport, Piece.summary))
        return _summed(self.comm, report)


@dataclasses.dataclass(frozen=True)
class Summary:
    """Sums up the quality of a mesh in pieces.

    Faces between two pieces are not judged: a piece's non-orthogonality is that of the faces inside
    it.

    - `cells`, `inverted`, `degenerate`: how many.
    - `smallest`, `largest`, `mean`: of each measure of `QualityReport`, means weighted by area or
      volume.
    """

    cells: int
    inverted: int
    degenerate: int
    smallest: dict[str, float]
    largest: dict[str, float]
    mean: dict[str, float]


def prepare(
    comm: Any,
    points: Real[ArrayLike, "n d"],
    nodes: Int[ArrayLike, " n"] | Sequence[int],
    moving: Int[ArrayLike, " k"] | Sequence[int],
    fixed: Int[ArrayLike, " f"] | Sequence[int] = (),
    *,
    method: jm.AbstractMethod | None = None,
    symmetry: jm.Plane | Sequence[jm.Plane] = (),
    is_open: bool = False,
) -> Piece:
    """Prepares the piece of a mesh that this process has; every process calls it together.

    The moving and fixed nodes of all pieces are gathered, and those on parallel symmetry planes.
    The first process prepares them, and all attach their points to equal bits: nodes that pieces
    share move alike.

    Pieces with cells, as a `Mesh`, give the boundary's faces: those that one cell of all pieces
    has. The points are then those of `jaxmorph.prepare(mesh, ...)` to round-off, however many
    processes there are. Without cells they are those of points alone.

    **Arguments:**

    - `comm`: the communicator, for example `MPI.COMM_WORLD`.
    - `points`: this piece of the mesh, a `Mesh`, or base coordinates (n, d) of its nodes; alike in
      every process. A cell may be in several pieces, as ghost cells are.
    - `nodes`: the whole mesh's id (n,) of each, from 0 on: nodes that several pieces share have one
      id.
    - `moving`, `fixed`: which of these points move (k,) and are fixed (f,); an empty list where
      there are none.
    - `method`, `symmetry`: as `jaxmorph.prepare` takes them, alike in every process.
    - `is_open`: whether the mesh has a side that is neither moving, fixed nor a symmetry plane.
      Default False. Faces show it: pieces with cells need it only to say that such sides are meant,
      and not to be warned of.

    **Returns:** a `Piece`.

    **Raises:** `ValueError`, in every process, for what `jaxmorph.prepare` refuses. Also for a node
    that two processes have at different places.
    """

    _check_comm(comm)
    piece = together(comm, lambda: _given(points, nodes, moving, fixed, symmetry, is_open))
    marks = owned(comm, piece.nodes)
    faces = faces_of(comm, piece.mesh, piece.nodes, marks[1])
    everything, names, m, count, total = _surface(comm, piece, faces)
    whole = comm.gather(faces)

    def half() -> jm.SurfaceHalf | None:
        if comm.rank:
            return None
        lists = np.arange(m), np.arange(m, count)
        known: dict[str, Any] = {"is_open": is_open}
        if faces is not None:
            known = {"faces": joined(whole, names), "free": np.arange(count, total if is_open else count)}
        try:
            return jm.prepare_surface(everything, *lists, nodes=names, method=method, symmetry=symmetry, **known)
        except jm.MeshError as error:
            raise error.renumbered(names) from None

    shared = comm.bcast(together(comm, half))
    assert shared is not None
    plan = together(comm, lambda: shared.attach(piece.points, piece.nodes))
    rows = np.searchsorted(names[:m], piece.nodes[piece.moving])
    return Piece(comm, plan, piece.nodes, piece.moving, rows, *marks)


def attach(
    comm: Any,
    half: jm.SurfaceHalf,
    points: Real[ArrayLike, "n d"],
    nodes: Int[ArrayLike, " n"] | Sequence[int],
) -> Piece:
    """Attaches this process' piece of a mesh to a prepared surface; all processes call it together.

    **Arguments:**

    - `comm`: the communicator.
    - `half`: what `prepare_surface` returned in one process, broadcast to all.
    - `points`, `nodes`: as `SurfaceHalf.attach` takes them. Each id is from 0 on.

    **Returns:** a `Piece`, whose `moving` are in the order of `points`.

    **Raises:** `ValueError`, in every process, as `SurfaceHalf.attach` does.
    """
    _check_comm(comm)
    together(comm, lambda: check("half", half, jm.SurfaceHalf, attach))
    plan = together(comm, lambda: half.attach(np.asarray(points), np.asarray(nodes)))
    ids = np.asarray(nodes)
    moving = np.flatnonzero(np.isin(ids, half.moving))
    return Piece(comm, plan, ids, moving, rows_in(half.moving, ids[moving]), *owned(comm, ids))


@dataclasses.dataclass(frozen=True)
class _Given:
    """Holds what one process gave of its piece, checked."""

    points: np.ndarray
    nodes: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    planes: list[jm.Plane]
    mesh: jm.Mesh | None


def _given(points: Any, nodes: Any, moving: Any, fixed: Any, symmetry: Any, is_open: Any) -> _Given:
    check("points", points, jm.Mesh | ROWS, prepare)
    check("symmetry", symmetry, jm.Plane | Sequence[jm.Plane], prepare)
    check("is_open", is_open, bool, prepare)
    mesh = points if isinstance(points, jm.Mesh) else None
    x, ids = np.asarray(points if mesh is None else mesh.points), np.asarray(nodes)
    if x.ndim != 2 or ids.shape != (len(x),) or ids.dtype.kind not in "iu" or len(np.unique(ids)) < len(ids):
        raise ValueError(f"`nodes` must be one id for each of {len(x)} points, no id twice.")
    if not len(x) or x.dtype.kind not in "fiu" or not np.isfinite(x).all() or (ids < 0).any():
        raise ValueError("a piece needs at least one point, finite coordinates, and ids from 0 on.")
    planes = [symmetry] if isinstance(symmetry, jm.Plane) else list(symmetry)
    check_dimension(planes, x.shape[1])
    return _Given(x, ids.astype(np.int64), _rows(moving, len(x)), _rows(fixed, len(x)), planes, mesh)


def _surface(
    comm: Any, piece: _Given, faces: dict[str, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray, int, int, int]:
    """Gathers the points that the surface's half needs, and their ids.

    The first m move, those up to `count` are fixed, those up to `total` are on parallel planes or
    on the boundary's `faces`. The outermost points, whose id is -1, are the last. All processes see
    the same, and raise together.
    """
    x, ids = piece.points, piece.nodes
    ends = np.unique([x.argmin(axis=0), x.argmax(axis=0)])
    extent = np.concatenate(comm.allgather(x[ends]))  # a plane holds nodes to a share of the whole mesh's size
    guided = on_facing(piece.planes, np.concatenate([x, extent]))[: len(x)]
    on_faces = np.isin(ids, np.concatenate([corners.ravel() for corners in (faces or {}).values()] or [ids[:0]]))
    kinds = piece.moving, piece.fixed, np.flatnonzero(guided | on_faces)
    shares = comm.allgather([(ids[rows], x[rows]) for rows in kinds])
    (moving, at_moving), (fixed, at_fixed), (further, at_further) = (
        _union(parts) for parts in zip(*shares, strict=True)
    )
    rest = ~np.isin(fixed, moving)
    others = ~np.isin(further, np.concatenate([moving, fixed]))
    outermost = np.concatenate(comm.allgather(x[ends[~(guided | on_faces)[ends]]]))
    everything = np.concatenate([at_moving, at_fixed[rest], at_further[others], outermost])
    names = np.concatenate([moving, fixed[rest], further[others], np.full(len(outermost), -1)])
    count = len(moving) + int(rest.sum())
    return everything, names, len(moving), count, count + int(others.sum())


def _check_comm(comm: Any) -> None:
    if not hasattr(comm, "allgather"):
        raise ValueError(f"`comm` must be a communicator of mpi4py, MPI.COMM_WORLD for example, not {shown(comm)}.")


def _rows(values: Any, n: int) -> np.ndarray:
    """Returns rows of the piece's points. Raises `ValueError` for what is no list of them."""
    rows = np.asarray(values)
    if rows.size == 0:
        return np.zeros(0, dtype=np.int64)
    if (
        rows.ndim != 1
        or rows.dtype.kind not in "iu"
        or rows.min() < 0
        or rows.max() >= n
        or len(np.unique(rows)) < len(rows)
    ):
        raise ValueError(f"`moving` and `fixed` are rows of the piece's {n} points, whole numbers from 0, none twice.")
    return rows.astype(np.int64)


def _union(shares: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Joins ids and coordinates, ascending. Raises `ValueError` for an id of several places."""
    ids, points = (np.concatenate([share[k] for share in shares]) for k in range(2))
    unique, first, back = np.unique(ids, return_index=True, return_inverse=True)
    mismatched = np.flatnonzero((points != points[first][back]).any(axis=1))
    if mismatched.size:
        raise ValueError(
            f"{mismatched.size} nodes lie at different places in different processes, first {ids[mismatched[0]]}."
        )
    return unique, points[first]


def _summed(comm: Any, report: jm.QualityReport) -> Summary:
    size = np.asarray(report.volume)[report.counted]
    names = ("skewness", "aspect_ratio", "non_orthogonality", "volume", "jacobian_ratio")
    values = {name: np.asarray(getattr(report, name))[report.counted] for name in names}
    counts = len(size), int(report.inverted), int(report.degenerate)
    least = {name: float(column.min(initial=np.inf)) for name, column in values.items()}
    most = {name: float(column.max(initial=-np.inf)) for name, column in values.items()}
    sums = {name: float((column * size).sum()) for name, column in values.items()}
    shares = comm.allgather((counts, least, most, sums, float(size.sum())))
    whole = sum(share[4] for share in shares)
    return Summary(
        *(sum(share[0][k] for share in shares) for k in range(3)),
        smallest={name: float(np.min([share[1][name] for share in shares])) for name in names},
        largest={name: float(np.max([share[2][name] for share in shares])) for name in names},
        mean={name: sum(share[3][name] for share in shares) / whole if whole else float("nan") for name in names},
    )
