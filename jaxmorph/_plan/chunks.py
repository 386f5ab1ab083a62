"""A mesh prepared and moved some nodes at a time: memory is that of the surface and of one chunk, not that of all nodes."""

import dataclasses
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from .._host.errors import MeshError
from .._methods.base import AbstractMethod
from .plan import Plan, deform
from .prepare import prepare
from .steps import march
from .symmetry import Plane


@dataclasses.dataclass(frozen=True)
class Chunks:
    """A mesh to be moved in parts.

    - `points`, `moving`, `fixed`, `method`, `symmetry`: those of `prepare_in_chunks`.
    - `nodes`: the ids of each part's nodes, ascending: the surface, and with it some of the other nodes. All parts have one
      length, so that they share compiled code; some nodes are in two of them.
    """

    points: Float[np.ndarray, "n d"]
    moving: Int[np.ndarray, " m"]
    fixed: Int[np.ndarray, " f"]
    method: AbstractMethod | None
    symmetry: tuple[Plane, ...]
    nodes: tuple[Int[np.ndarray, " c"], ...]

    def __len__(self) -> int:
        return len(self.nodes)

    def plan(self, k: int) -> Plan:
        """Prepares part `k`, and returns its `Plan`.

        **Raises:** `ValueError` as `prepare` does; a `MeshError` names nodes of the whole mesh.
        """
        nodes = self.nodes[k]
        moving, fixed = np.searchsorted(nodes, self.moving), np.searchsorted(nodes, self.fixed)
        try:
            return prepare(self.points[nodes], moving, fixed, method=self.method, symmetry=self.symmetry)
        except MeshError as error:
            raise error.renumbered(nodes) from None

    def march(
        self, path: Float[ArrayLike, "k m d"], *, first: Plan | None = None, done: Callable[[float], None] | None = None
    ) -> Float[np.ndarray, "n d"]:
        """Moves the mesh along a path of total surface displacements, one part after the other.

        **Arguments:**

        - `path`: displacements (k, m, d) of the moving nodes at the end of each step, as `march` takes them.
        - `first`: the plan of part 0, where it is already there.
        - `done`: called with the share of the parts that is done, from 0 to 1.

        **Returns:** points (n, d), on the host, in the precision of the mesh.
        """
        path, points = np.asarray(path), np.array(self.points)
        for k, nodes in enumerate(self.nodes):
            with warnings.catch_warnings():
                if k > 0:
                    warnings.simplefilter("ignore")  # each is about the surface, and part 0 has given it
                plan = first if k == 0 and first is not None else self.plan(k)
            points[nodes] = deform(plan, path[0]) if len(path) == 1 else march(plan, path)[1]
            if done is not None:
                done((k + 1) / len(self))
        return points


def prepare_in_chunks(
    points: Float[ArrayLike, "n d"],
    moving: Int[ArrayLike, " m"] | Sequence[int],
    fixed: Int[ArrayLike, " f"] | Sequence[int] = (),
    *,
    size: int | None = None,
    method: AbstractMethod | None = None,
    symmetry: Plane | Sequence[Plane] = (),
) -> Chunks:
    """Divides a mesh into parts that are prepared and moved one after the other.

    The displacement field comes from the surface alone, so the moved points are those of the whole mesh. Each part has the
    surface, the outermost nodes and one node of each symmetry plane, for the tolerances; and every K-th of the other nodes.

    **Arguments:**

    - `points`, `moving`, `fixed`, `method`, `symmetry`: as `prepare` takes them.
    - `size`: how many inner nodes each part has; None makes one part.

    **Returns:** `Chunks`; nothing is prepared yet.

    **Raises:** `ValueError` for a size below 1.
    """
    if size is not None and size < 1:
        raise ValueError(f"`size` must be 1 or more, not {size}.")
    points = np.asarray(points)
    moving, fixed = np.asarray(moving, dtype=np.int64), np.asarray(fixed, dtype=np.int64)
    planes = (symmetry,) if isinstance(symmetry, Plane) else tuple(symmetry)
    surface, outermost = np.union1d(moving, fixed), [points.argmin(axis=0), points.argmax(axis=0)]
    always = np.unique(
        np.concatenate([surface, *outermost, *(np.flatnonzero(plane.holds(points))[:1] for plane in planes)])
    )
    others = np.setdiff1d(np.arange(len(points)), always, assume_unique=True)
    count = 1 if size is None else max(1, -(-len(others) // size))
    steps = count * np.arange(-(-len(others) // count))
    # the last ones may begin anew: all parts have one length
    rows = [(k + steps) % max(1, len(others)) for k in range(count)]
    nodes = tuple(np.sort(np.concatenate([always, others[each]])) for each in rows)
    return Chunks(points, moving, fixed, method, planes, nodes)
