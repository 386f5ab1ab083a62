"""A mesh prepared and moved some nodes at a time: memory is that of the surface and of one chunk, not that of all nodes."""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Int, Integer, Real

from .._boundary.boundary import Boundary, boundary
from .._boundary.outer_faces import FreeFaces
from .._boundary.periodic import Periodic
from .._boundary.slide import Slide
from .._boundary.symmetry import Plane
from .._host.package.arguments import checked, whole
from .._host.package.errors import MeshError
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, check_kind
from .halves import SurfaceHalf, half_of
from .plan import Plan, deform
from .prepare import between_planes, plan_of
from .steps import march


@dataclasses.dataclass(frozen=True)
class Chunks:
    """A mesh to be moved in parts.

    - `points`, `moving`, `fixed`, `method`, `symmetry`, `periodic`, `sliding`: those of `prepare_in_chunks`.
    - `nodes`: the ids of each part's nodes, ascending: the surface, and with it some of the other nodes. All parts have one
      length, so that they share compiled code; some nodes are in two of them.
    """

    named: Boundary
    method: AbstractMethod | None
    nodes: tuple[Int[np.ndarray, " c"], ...]

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def free_faces(self) -> FreeFaces | None:
        """The boundary faces that no list names, and the patches that hold them; None where cells are not known."""
        return self.named.left

    @checked
    def plan(self, k: int) -> Plan:
        """Prepares part `k`, and returns its `Plan`.

        **Raises:** `ValueError` as `prepare` does; a `MeshError` names nodes of the whole mesh.
        """
        if not 0 <= k < len(self):
            raise ValueError(f"`k` is {k}; there are {len(self)} parts, 0 to {len(self) - 1}.")
        nodes = self.nodes[k]
        if len(self) == 1:
            return plan_of(self.named, self.method)
        half = self._half
        try:
            return half.attach(self.named.points[nodes], nodes)
        except MeshError as error:
            raise error.renumbered(nodes) from None

    @functools.cached_property
    def _half(self) -> SurfaceHalf:
        return half_of(self.named, self.method, np.arange(len(self.named.points)))

    @checked
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
        path, points = np.asarray(path), np.array(self.named.points)
        shape = len(self.named.moving), points.shape[1]
        if path.ndim != 3 or path.shape[1:] != shape or not len(path):
            raise ValueError(f"`path` has shape {path.shape}; expected (k, {shape[0]}, {shape[1]}), one step or more.")
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
    mesh: Mesh | Real[ArrayLike, "n d"] | Sequence[Any],
    moving: str | Sequence[str] | Integer[ArrayLike, " m"] | Sequence[int | np.integer],
    fixed: str | Sequence[str] | Integer[ArrayLike, " f"] | Sequence[int | np.integer] = (),
    *,
    size: int | None = None,
    method: AbstractMethod | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
    periodic: Periodic | Sequence[Periodic] = (),
    sliding: Slide | str | Sequence[Slide | str] = (),
    free: str | Sequence[str] | Integer[ArrayLike, " k"] | Sequence[int | np.integer] = (),
) -> Chunks:
    """Divides a mesh into parts that are prepared and moved one after the other.

    The displacement field comes from the surface alone, which is prepared once, so the moved points are those of the whole mesh.
    Each part has the surface, and every K-th of the other nodes.

    **Arguments:**

    - `mesh`, `moving`, `fixed`, `method`, `symmetry`, `periodic`, `sliding`, `free`: as `prepare` takes them.
    - `size`: how many inner nodes each part has; None makes one part.

    **Returns:** `Chunks`; nothing is prepared yet.

    **Raises:** `ValueError` for a size below 1, and for lists as `prepare` does.
    """
    if size is not None:
        whole("size", size)
    if method is not None:
        check_kind(method, AbstractMethod, "method", "jm.RBF()")
    named = between_planes(boundary(mesh, moving, fixed, symmetry, free, periodic, sliding), method)
    points, always = named.points, np.unique(named.nodes)
    others = np.setdiff1d(np.arange(len(points)), always, assume_unique=True)
    count = 1 if size is None else max(1, -(-len(others) // size))
    steps = count * np.arange(-(-len(others) // count))
    # the last ones may begin anew: all parts have one length
    rows = [(k + steps) % max(1, len(others)) for k in range(count)]
    nodes = tuple(np.sort(np.concatenate([always, others[each]])) for each in rows)
    return Chunks(named, method, nodes)
