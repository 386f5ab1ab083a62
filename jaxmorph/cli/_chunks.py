"""The nodes of a mesh, some at a time: memory is that of the surface and of one chunk, not that of all nodes."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Int

from jaxmorph import Mesh


@dataclasses.dataclass(frozen=True)
class Chunks:
    """Ascending ids of nodes: those of `always`, and with them `size` of the `others` at a time.

    Of K chunks each takes every K-th node, so that they are alike, and of one length, some nodes being in two of them: compiled
    code then serves them all.
    """

    always: Int[np.ndarray, " b"]
    others: Int[np.ndarray, " i"]
    size: int

    def __len__(self) -> int:
        return max(1, -(-len(self.others) // self.size))

    def __iter__(self) -> Iterator[Int[np.ndarray, " c"]]:
        steps = len(self) * np.arange(-(-len(self.others) // len(self)))
        for k in range(len(self)):
            rows = (k + steps) % max(1, len(self.others))  # the last one may begin anew
            yield np.sort(np.concatenate([self.always, self.others[rows]]))


def chunks(mesh: Mesh, surface: Int[np.ndarray, " b"], symmetry: list[str], size: int | None) -> Chunks:
    """The chunks of a mesh for `prepare`, of so many inner nodes each; one of all nodes where `size` is None.

    The map comes from the surface alone. Tolerances come from the extent of the points, and a plane must hold one of them: the
    outermost nodes and one of each symmetry patch are in every chunk too.
    """
    points = np.asarray(mesh.points)
    outermost = np.concatenate([points.argmin(axis=0), points.argmax(axis=0)])
    always = np.unique(np.concatenate([surface, outermost, *(mesh.patch(name)[:1] for name in symmetry)]))
    others = np.setdiff1d(np.arange(len(points)), always, assume_unique=True)
    return Chunks(always, others, size or max(1, len(others)))
