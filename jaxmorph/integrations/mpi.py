"""A mesh whose pieces lie in the processes of an MPI run, none of which holds all (extra `mpi`)."""

try:
    from mpi4py import MPI
except (ImportError, RuntimeError) as error:  # RuntimeError: mpi4py is there, and no MPI library
    raise ImportError(
        "pieces over MPI need mpi4py and an MPI library: pip install 'jaxmorph[mpi]' mpich, or "
        "the machine's own MPI"
    ) from error

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int, Real
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import Agreement, real_array, together

from ._pieces import check_comm, faces_of_piece, gather_surface, mark_owned


@dataclasses.dataclass(frozen=True)
class Piece:
    """Moves the piece of a mesh that this process has.

    `prepare` makes it; every process calls its functions together.

    - `comm`: the communicator.
    - `plan`: the plan of this piece's n points; it takes displacements of all moving nodes.
    - `nodes` (n,): the whole mesh's ids of the points.
    - `moving` (k,): the points that move, as `prepare` was given them.
    - `rows` (k,): the row of each in the displacement of all moving nodes.
    - `is_owner` (n,): whether this process, the first one that has the node, speaks for it.
    - `is_shared` (n,): whether other processes have the node too.
    """

    comm: Any
    plan: jm.Plan
    nodes: Int[ndarray, " n"]
    moving: Int[ndarray, " k"]
    rows: Int[ndarray, " k"]
    is_owner: Bool[ndarray, " n"]
    is_shared: Bool[ndarray, " n"]

    def deform(self, u: Real[ArrayLike, "k d"]) -> Float[ndarray, "n d"]:
        """Moves the piece's points (n, d): row i of `u` (k, d) displaces point `moving[i]`.

        Nodes that processes share are equal bit for bit. Raises `ValueError`, in every process, for
        a `u` of another shape, and where processes displace a shared node differently.
        """
        u = self.gathered(u)
        moved = np.array(together(self.comm, lambda: jm.deform(self.plan, u)))
        if self.comm.allreduce(int(self.is_shared.sum())):
            moved[self.is_shared] = Agreement(self.comm)(
                self.nodes[self.is_shared], moved[self.is_shared]
            )
        return moved

    def pullback(
        self, u: Real[ArrayLike, "k d"], cotangent: Real[ArrayLike, "n d"]
    ) -> Float[ndarray, "k d"]:
        """Pulls dJ/d(points) of the whole mesh, `cotangent` (n, d), back to moving nodes (k, d).

        Processes that share a node give equal derivatives, which count once. It raises `ValueError`
        as `deform` does.
        """
        u = self.gathered(u)

        def of_piece() -> ndarray:
            values = real_array("cotangent", cotangent, self.plan.points.shape)
            return np.array(jm.pullback(self.plan, u, np.where(self.is_owner[:, None], values, 0)))

        total = together(self.comm, of_piece)
        self.comm.Allreduce(MPI.IN_PLACE, total)
        return total[self.rows]

    def pushforward(
        self, u: Real[ArrayLike, "k d"], tangent: Real[ArrayLike, "k d"]
    ) -> Float[ndarray, "n d"]:
        """Pushes a change of `u` (k, d) forward to points (n, d); errors as of `deform`."""
        u = self.gathered(u)
        tangent = self.gathered(tangent, "tangent")
        return np.array(together(self.comm, lambda: jm.velocity(self.plan, u, tangent)))

    def gathered(self, u: Real[ArrayLike, "k d"], name: str = "u") -> Float[ndarray, "m d"]:
        """Gathers the displacements of all moving nodes; errors call them `name`."""
        shape = (len(self.moving), self.plan.points.shape[1])
        dtype = self.plan.points.dtype
        own = together(self.comm, lambda: real_array(name, u, shape).astype(dtype))
        shares = self.comm.allgather((self.rows, own))
        whole = np.full((self.plan.n_moving, shape[1]), np.nan, dtype)
        for rows, values in shares:
            whole[rows] = values
        torn = sum(int((whole[rows] != values).any(axis=1).sum()) for rows, values in shares)
        if torn and np.isfinite(whole).all():
            raise ValueError(
                f"{torn} moving nodes are displaced differently by the processes that share them."
            )
        return whole

    def judge(
        self,
        mesh: jm.Mesh,
        points: Real[ArrayLike, "n d"] | None = None,
        limits: jm.Limits | None = None,
    ) -> jm.Verdict:
        """Judges all pieces, each cell of which is in one: the same `Verdict` in every process.

        Arguments and errors are as of `jaxmorph.judge`, of this piece. Faces between two pieces are
        not judged.
        """
        verdict = together(self.comm, lambda: jm.judge(mesh, points, limits, part=self.comm.rank))
        return jm.Verdict.together(self.comm.allgather(verdict))


def prepare(
    comm: Any,
    points: jm.Mesh | Real[ArrayLike, "n d"],
    nodes: Int[ArrayLike, " n"] | Sequence[int],
    moving: Int[ArrayLike, " k"] | Sequence[int],
    fixed: Int[ArrayLike, " f"] | Sequence[int] = (),
    *,
    method: jm.AbstractMethod | None = None,
    symmetry: jm.Plane | Sequence[jm.Plane] = (),
    is_open: bool = False,
) -> Piece:
    """Prepares the piece of a mesh that this process has; every process calls it together.

    The first process prepares the moving and fixed nodes of all pieces, and all attach their points
    to equal bits. A piece with cells, as a `Mesh`, moves as with a plan of
    `jaxmorph.prepare(mesh, ...)`, to round-off, however many processes there are. Without cells it
    moves as with a plan of points alone.

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
      Default False. With cells, which show it, True only keeps the warning away.

    **Returns:** a `Piece`.

    **Raises:** `ValueError`, in every process, for what `jaxmorph.prepare` refuses, and for a node
    at different places in two processes.
    """
    check_comm(comm)
    mesh = points if isinstance(points, jm.Mesh) else None
    own, ids, planes = together(comm, lambda: _own(points, nodes, moving, fixed, symmetry))
    marks = mark_owned(comm, ids)
    faces = faces_of_piece(comm, mesh, ids, marks[1])
    surface = gather_surface(comm, own, ids, faces, planes)
    shares = comm.gather(faces)

    def half() -> jm.SurfaceHalf | None:
        return None if shares is None else surface.half(planes, shares, method, is_open)

    shared: Any = comm.bcast(together(comm, half))
    plan = together(comm, lambda: shared.attach(own.points, ids))
    rows = np.searchsorted(surface.names[: surface.moving], ids[own.moving])
    return Piece(comm, plan, ids, own.moving, rows, *marks)


def _own(
    points: Any, nodes: Any, moving: Any, fixed: Any, symmetry: Any
) -> tuple[jm.Boundary, ndarray, list[jm.Plane]]:
    """Returns the boundary of a piece, the ids (n,) of its points, and the symmetry planes."""
    x = points.points if isinstance(points, jm.Mesh) else points
    boundary = jm.Boundary(x, moving, fixed)
    planes: list[Any] = [symmetry] if isinstance(symmetry, jm.Plane | str) else list(symmetry)
    wrong = [plane for plane in planes if not isinstance(plane, jm.Plane)]
    if wrong:
        raise ValueError(
            f"`symmetry` holds {wrong[0]!r}: pass jm.Plane(normal=(0, 1), origin=(0, 0))."
        )
    ids = np.asarray(nodes)
    n = len(boundary.points)
    if (
        ids.shape != (n,)
        or ids.dtype.kind not in "iu"
        or (ids < 0).any()
        or len(np.unique(ids)) < n
    ):
        raise ValueError(f"`nodes` must be one id for each of {n} points, from 0 on, no id twice.")
    return boundary, ids.astype(np.int64), planes


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
    check_comm(comm)

    def attached() -> jm.Plan:
        if not isinstance(half, jm.SurfaceHalf):
            raise ValueError(f"`half` must be what prepare_surface returned, not {half!r}.")
        return half.attach(np.asarray(points), np.asarray(nodes))

    plan = together(comm, attached)
    ids = np.asarray(nodes)
    moving = np.flatnonzero(np.isin(ids, half.moving))
    return Piece(comm, plan, ids, moving, half.rows(ids[moving]), *mark_owned(comm, ids))
