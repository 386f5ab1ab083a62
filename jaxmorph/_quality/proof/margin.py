"""The margin by which cells are proven to fold nowhere, traced."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from ..._host.cells.topology import DIMENSION
from ..._host.package.arguments import between, checked, whole
from ..._kernels.compile import compiled
from ..._kernels.values import Either, as_jax, constant, is_known, namespace, on_host, smallest
from ..._mesh.mesh import Mesh
from ..batches import in_blocks
from ..quality import places
from . import bernstein
from .form import form_of, nodes_of
from .proof import check_solid
from .search import ROOM

TRACED_ROOM = 1 << 22
"""Coefficients that JAX computes together."""


@checked
def proven_margin(
    mesh: Mesh,
    points: Real[ArrayLike, "n d"] | Sequence[Any],
    *,
    base: Real[ArrayLike, "n d"] | Sequence[Any] | None = None,
    depth: int = 0,
    sharpness: float | None = None,
) -> Float[Array, " k"]:
    """Bounds det J of whole cells from below, over its undeformed mean: above 0 no cell folds.

    It is the least Bernstein coefficient, `Proof.margin` but for round-off. Traced: `jit`, `grad`
    and `vmap` work over `points` and `base`. All cells are cut alike, since what is traced cannot
    depend on the sign.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`.
    - `base`: where they came from (n, d). The bound then holds during the whole straight motion.
      Default: none.
    - `depth`: how often each cell is cut, default 0. A cut makes 8 parts in 3-D, 4 in 2-D, with
      `base` twice as many.
    - `sharpness`: makes the bound smooth in the points. It is then lower, by log(coefficients) /
      sharpness at most, so above 0 it still is a proof. A hexahedron has 27 coefficients. Default
      None: the least coefficient itself.

    **Returns:** one number for each cell (k,), one type of cells after another. Boundary elements
    have infinity.

    **Raises:** `ValueError` as `proof` does, and for a `sharpness` that is not positive.
    """
    now, start = places(mesh, points), None if base is None else places(mesh, base, "base")
    whole("depth", depth, 0)
    if sharpness is not None and is_known(sharpness):
        between("sharpness", sharpness, 0)
    check_solid(mesh)
    kinds, cells = tuple(mesh.cells), tuple(mesh.cells.values())
    ends = (now,) if start is None else (start, now)
    with jax.ensure_compile_time_eval():
        reference = jnp.asarray(mesh.points, now.dtype)
    if on_host(cells, reference, ends, sharpness):
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():
            cells, reference, ends = jax.tree.map(np.asarray, (cells, reference, ends))
            return as_jax(_joined(kinds, cells, reference, ends, depth, sharpness))
    return _measured(kinds, cells, reference, ends, depth, None if sharpness is None else jnp.asarray(sharpness))


def _joined(
    kinds: tuple[str, ...],
    cells: tuple[Any, ...],
    reference: Either,
    ends: tuple[Either, ...],
    depth: int,
    sharpness: Any,
) -> Float[Either, " k"]:
    xp, d, margins = namespace(reference), reference.shape[1], []
    for kind, ids in zip(kinds, cells, strict=True):
        if DIMENSION[kind] != d:
            margins.append(xp.full(len(ids), np.inf, reference.dtype))
            continue
        form = form_of(kind, len(ends) == 2)
        parts = bernstein.count(form.space) * 2 ** (depth * sum(m for m, _ in form.space))
        size = max(64, (ROOM if xp is np else TRACED_ROOM) // parts)
        margin = functools.partial(_margin, kind, reference, ends, depth, sharpness)
        margins.append(in_blocks(xp, margin, ids.T, size=size))
    return xp.concatenate(margins)


_measured = compiled(_joined)


def _margin(
    kind: str, reference: Either, ends: tuple[Either, ...], depth: int, sharpness: Any, ids: Int[Either, "c k"]
) -> Float[Either, " k"]:
    xp, still, form = namespace(reference), form_of(kind), form_of(kind, len(ends) == 2)
    mean = still.mean(still.coefficients(nodes_of(reference, ids)))
    parts = zip(*(nodes_of(end, ids) for end in ends), strict=True)
    values = form.coefficients([xp.concatenate(part) for part in parts]) / xp.where(mean == 0, 1, mean)[None]
    for _ in range(depth):
        values = bernstein.halved(form.space, values)
    values = values.reshape(-1, ids.shape[1])
    if sharpness is None:
        return smallest(values)
    least = constant(smallest(values))
    return least - xp.log(xp.sum(xp.exp(-sharpness * (values - least[None])), axis=0)) / sharpness
