"""Links between control displacements as one matrix: frozen, linked, mirrored."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from .._host.cells.adjacency import parts_of
from .._host.package.arguments import whole


def link_matrix(
    free: Bool[np.ndarray, "..."], groups: Sequence[Sequence[tuple[int, ...]]], mirror: tuple[int, np.ndarray] | None
) -> Float[np.ndarray, "p q"]:
    """Builds the matrix from free parameters to the displacements of all controls, flattened.

    - `free` (*counts, d): True for components that may move.
    - `groups`: lists of controls that move alike.
    - `mirror`: the direction of the lattice that is reflected, and the signs (d,) of the
      reflection.
    """
    counts, d = free.shape[:-1], free.shape[-1]
    ids = np.arange(free.size).reshape(free.shape)
    pairs = [(ids[group[0]], ids[control], np.ones(d, int)) for group in groups for control in group[1:]]
    if mirror is not None:
        axis, signs = mirror
        images = np.flip(ids, axis=axis).reshape(-1, d)
        pairs += [(row, image, signs) for row, image in zip(ids.reshape(-1, d), images, strict=True)]
    a, b, sign = (np.concatenate([np.asarray(pair[k]) for pair in pairs] or [np.zeros(0, int)]) for k in range(3))
    # each displacement stands twice, as itself and as its opposite (+ count); what is linked to its
    # own opposite is zero
    count = int(np.prod(counts)) * d
    opposite = np.where(sign < 0, count, 0)
    rows, columns = np.concatenate([a, a + count]), np.concatenate([b + opposite, b + count - opposite])
    labels = parts_of(rows, columns, 2 * count)
    itself, other = labels[:count], labels[count:]
    rests = np.concatenate([itself[~free.ravel()], other[~free.ravel()]])
    moves = (itself != other) & ~np.isin(itself, rests)
    least = np.minimum(itself, other)
    names, column = np.unique(least[moves], return_inverse=True)
    matrix = np.zeros((count, len(names)))
    matrix[np.flatnonzero(moves), column] = np.where(itself < other, 1.0, -1.0)[moves]
    first = np.array([matrix[np.flatnonzero(matrix[:, k])[0], k] for k in range(len(names))])
    return matrix * first if len(names) else matrix


def check_groups(groups: Sequence[Sequence[tuple[int, ...]]], counts: tuple[int, ...]) -> None:
    """Raises `ValueError` for entries of `groups` that are no control points of a lattice."""

    def is_control(control: tuple[int, ...]) -> bool:
        return len(control) == len(counts) and all(0 <= i < count for i, count in zip(control, counts, strict=True))

    bad = [control for group in groups for control in group if not is_control(control)]
    if bad:
        raise ValueError(f"{len(bad)} entries of `groups` are no control of {counts}, first {bad[0]}.")


def reflection(axes: Float[np.ndarray, "d d"], mirror: int) -> tuple[int, np.ndarray]:
    """Returns the mirrored direction of a lattice, and the signs (d,) of its reflection.

    Raises `ValueError` for an edge of the box that is along no axis.
    """
    if whole("mirror", mirror, 0) >= len(axes):
        raise ValueError(f"`mirror` is {mirror}; the lattice has directions 0 to {len(axes) - 1}.")
    edge = np.abs(axes[mirror])
    signs = np.where(edge > 1e-9 * edge.max(), -1, 1)
    if (signs < 0).sum() != 1:
        raise ValueError(f"edge {mirror} of the box is along no axis: its controls cannot be mirrored.")
    return mirror, signs
