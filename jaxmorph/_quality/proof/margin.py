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
from ..quality import places, signs_of
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

    It is the least Bernstein coefficient, `Proof.margin` but for round-off. A cell that is folded
    on the undeformed mesh has a negative margin until it is unfolded. Traced: `jit`, `grad` and
    `vmap` work over `points` and `base`. All cells are cut alike, since what is traced cannot
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
        means = _means(kinds, cells, jnp.asarray(mesh.points, now.dtype))
        signs = signs_of(mesh).values()
        sizes = tuple(abs(mean) * sign for mean, sign in zip(means, signs, strict=True))
    if on_host(cells, sizes, ends, sharpness):
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():
            cells, sizes, ends = jax.tree.map(np.asarray, (cells, sizes, ends))
            return as_jax(_joined(kinds, cells, sizes, ends, depth, sharpness))
    return _measured(kinds, cells, sizes, ends, depth, None if sharpness is None else jnp.asarray(sharpness))


def _means(kinds: tuple[str, ...], cells: tuple[Any, ...], points: Float[Array, "n d"]) -> tuple[Either, ...]:
    """Computes the mean of det J over each undeformed cell, here and not in the caller's program.

    Else XLA would compute it from constants while it compiles, which takes many seconds.
    """
    xp, d, x = np if on_host(cells, points) else jnp, points.shape[1], points
    if xp is np:
        cells, x = jax.tree.map(np.asarray, (cells, points))

    def mean(kind: str, ids: Any) -> Either:
        form = form_of(kind)
        size = max(64, (ROOM if xp is np else TRACED_ROOM) // bernstein.count(form.space))
        return in_blocks(xp, lambda ids: form.mean(form.coefficients(nodes_of(x, ids))), ids.T, size=size)

    none = functools.partial(xp.ones, dtype=points.dtype)
    means = (
        mean(kind, ids) if DIMENSION[kind] == d else none(len(ids)) for kind, ids in zip(kinds, cells, strict=True)
    )
    return tuple(xp.where(size == 0, 1, size) for size in means)


def _joined(
    kinds: tuple[str, ...],
    cells: tuple[Any, ...],
    sizes: tuple[Either, ...],
    ends: tuple[Either, ...],
    depth: int,
    sharpness: Any,
) -> Float[Either, " k"]:
    xp, (_, d), margins = namespace(ends[0]), ends[0].shape, []
    for kind, ids, own in zip(kinds, cells, sizes, strict=True):
        if DIMENSION[kind] != d:
            margins.append(xp.full(len(ids), np.inf, ends[0].dtype))
            continue
        form = form_of(kind, len(ends) == 2)
        parts = bernstein.count(form.space) * 2 ** (depth * sum(m for m, _ in form.space))
        size = max(64, (ROOM if xp is np else TRACED_ROOM) // parts)
        margins.append(in_blocks(xp, functools.partial(_margin, kind, ends, depth, sharpness), ids.T, own, size=size))
    return xp.concatenate(margins)


_measured = compiled(_joined)


def _margin(
    kind: str,
    ends: tuple[Either, ...],
    depth: int,
    sharpness: Any,
    ids: Int[Either, "c k"],
    size: Float[Either, " k"],
) -> Float[Either, " k"]:
    xp, form = namespace(ends[0]), form_of(kind, len(ends) == 2)
    parts = zip(*(nodes_of(end, ids) for end in ends), strict=True)
    values = form.coefficients([xp.concatenate(part) for part in parts]) / size[None]
    for _ in range(depth):
        values = bernstein.halved(form.space, values)
    values = values.reshape(-1, ids.shape[1])
    if sharpness is None:
        return smallest(values)
    least = constant(smallest(values))
    return least - xp.log(xp.sum(xp.exp(-sharpness * (values - least[None])), axis=0)) / sharpness
