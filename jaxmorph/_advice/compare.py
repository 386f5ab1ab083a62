"""Methods compared on the motions that a mesh is to bear."""

import dataclasses
import functools
import math
import operator
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from .._boundary.boundary import Boundary
from .._host.package.arguments import checked, finite_array, shown
from .._host.package.rounding import extent_of
from .._host.sources.reduction import KDTree
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, check_kind
from .._methods.inverse_distance import InverseDistance
from .._methods.rbf.rbf import RBF
from .._methods.reconstruction import SurfaceReconstruction
from .._plan.deform import deform
from .._plan.plan import Plan
from .._plan.prepare import plan_of
from .._quality.verdict import judge
from .._quality.wall_quality import wall_quality
from .methods import METHODS, MOST_POINTS

# points times nodes of the surface up to which inverse distances are tried
MOST_PAIRS = 300_000_000
COLUMNS = ("sources", "inverted", "ratio", "angle", "seconds")
NUMBERS = operator.attrgetter(*COLUMNS)


@dataclasses.dataclass(frozen=True)
class Trial:
    """One row of a `Comparison`: a method on all motions."""

    method: str
    sources: int | None = None  # number of control points, None for a method without any
    inverted: int | None = None  # cells that the motions invert, in all of them
    ratio: float = math.nan  # the smallest Jacobian ratio in any motion
    angle: float = (
        math.nan
    )  # mean degrees by which first grid lines leave their angle to the wall; NaN without lines
    seconds: float = math.nan  # CPU time of one compiled `deform`
    # why the method was refused or left out, or None. Numbers are then None or NaN.
    refused: str | None = None

    @property
    def badness(self) -> tuple[float | int, float]:
        """Key by which trials are sorted: inverted cells, then the ratio; refused ones last."""
        ratio = math.inf if math.isnan(self.ratio) else -self.ratio
        return (math.inf if self.inverted is None else self.inverted, ratio)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Result of `compare`, the best method first. `str` of it is a table.

    - `rows`: a `Trial` for each method, by inverted cells, then by the smallest Jacobian ratio.
    - `plans`: the plan of each row, None for a method that was refused.
    """

    rows: tuple[Trial, ...]
    plans: tuple[Plan | None, ...]

    def __str__(self) -> str:
        width = max(len("method"), *(len(row.method) for row in self.rows))
        lines = [f"{'method':<{width}}" + "".join(f"{name:>10}" for name in COLUMNS)]
        for row in self.rows:
            cells = (
                "-" if x is None else f"{x:.3g}" if isinstance(x, float) else x
                for x in NUMBERS(row)
            )
            lines.append(f"{row.method:<{width}}" + "".join(f"{cell:>10}" for cell in cells))
        return "\n".join(
            [*lines, *(f"{row.method}: {row.refused}" for row in self.rows if row.refused)]
        )


@checked
def compare(
    boundary: Boundary,
    motions: Real[ArrayLike, "s m d"] | Sequence[Any],
    methods: Mapping[str, AbstractMethod] | None = None,
) -> Comparison:
    """Compares methods on a family of motions: inverted cells, Jacobian ratio, wall angle, time.

    **Arguments:**

    - `boundary`: the boundary of a mesh.
    - `motions`: displacements (s, m, d) of the moving nodes that the mesh is to bear: modes, or
      samples. Each is deformed and judged once by each method.
    - `methods`: methods by their names in the table. Default: the default method, `interpolated`
      (the same without the fit: `SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True)))`),
      `DelaunayGraph`, `Multiscale.whole`, `Biharmonic`, `LinearElasticity`, `TorsionalSprings` and
      `InverseDistance(rotations=True)`, which is not linear in `u`. Methods on the cells are left
      out beyond 100,000 points in 2-D and 40,000 in 3-D, and inverse distances beyond 3e8 pairs of
      a point and a node of the surface. The table says so.

    **Raises:** `ValueError` when `motions` is not (s, m, d), is zero or not finite, for a boundary
    of points alone, and for `methods` that are no methods by name. Also what `prepare` raises where
    it refuses every method.
    """
    if (mesh := boundary.mesh) is None:
        raise ValueError(
            "compare judges cells: give it the boundary of a mesh, compare(jm.Boundary(mesh, "
            "...), motions)."
        )
    boundary.warn_of_free_faces()
    motions = finite_array(
        "motions", motions, (None, len(boundary.moving), boundary.points.shape[1])
    ).astype(float)
    if not motions.any():
        raise ValueError(
            "`motions` is zero: no method moves a node. Give what the mesh is to bear, (s, m, d)."
        )
    makers = _makers(boundary, methods)
    pairs = [_try(boundary, make, mesh, motions, name) for name, make in makers.items()]
    rows, plans = zip(*sorted(pairs, key=lambda pair: pair[0].badness), strict=True)
    if plans[0] is None:
        raise ValueError(f"every method is refused. {rows[0].method}: {rows[0].refused}")
    return Comparison(rows, plans)


def _makers(boundary: Boundary, methods: Mapping[str, AbstractMethod] | None) -> dict[str, Any]:
    if methods is None:
        size = float(extent_of(boundary.points[boundary.moving]))
        listed = {name: entry.make for name, entry in METHODS.items() if entry.is_tried}
        makers = {
            name: functools.partial(_small_enough, make, size, boundary)
            for name, make in listed.items()
        }
        interpolated = functools.partial(
            SurfaceReconstruction, RBF(reduction=KDTree(64, extremes=True))
        )
        return {"default": SurfaceReconstruction, "interpolated": interpolated} | makers
    if not methods:
        raise ValueError(
            "`methods` is empty: name at least one, as in methods={'graph': jm.DelaunayGraph()}."
        )
    for name, method in methods.items():
        if not isinstance(name, str):
            raise ValueError(
                f"a name in `methods` is {shown(name)}; names are words, as in methods={{'soft': "
                f"...}}."
            )
        check_kind(method, AbstractMethod, f'methods["{name}"]', "jm.LinearElasticity()")
    return {name: lambda method=method: method for name, method in methods.items()}


def _small_enough(make: Any, size: float, boundary: Boundary) -> AbstractMethod:
    method = make(size)
    n, d = boundary.points.shape
    if method.needs_cells and n > MOST_POINTS[d]:
        raise ValueError(
            f"skipped: {n} points; a solve on the cells is tried up to {MOST_POINTS[d]}"
        )
    if isinstance(method, InverseDistance) and n * len(boundary.nodes) > MOST_PAIRS:
        nodes = len(boundary.nodes)
        raise ValueError(
            f"skipped: {n} points times {nodes} nodes of the surface; tried up to {MOST_PAIRS} "
            "pairs"
        )
    return method


def _try(
    boundary: Boundary, make: Any, mesh: Mesh, motions: np.ndarray, name: str
) -> tuple[Trial, Plan | None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a bad condition: the table shows what comes of it
        try:
            plan = plan_of(boundary, make())
        except (ValueError, ImportError) as error:  # ImportError: no solver for large 3-D meshes
            return Trial(name, refused=str(error) or repr(error)), None
    return _measure_motions(mesh, plan, motions, name), plan


def _measure_motions(
    mesh: Mesh, plan: Plan, motions: Float[np.ndarray, "s m d"], name: str
) -> Trial:
    vectors = [jnp.asarray(u, plan.points.dtype) for u in motions]
    moved = [deform(plan, u) for u in vectors]
    jax.block_until_ready(moved)
    began = time.process_time()
    jax.block_until_ready(deform(plan, vectors[0]))
    seconds = time.process_time() - began
    before = judge(mesh)
    verdicts = [judge(mesh, points, before=before) for points in moved]
    ratio = min(verdict.judged.ratio for verdict in verdicts if verdict.judged is not None)
    try:
        angle = float(
            np.mean(
                [wall_quality(mesh, np.asarray(plan.moving), points).mean_angle for points in moved]
            )
        )
    except ValueError:  # no cell has a side on the wall
        angle = math.nan
    inverted = sum(verdict.spoilt for verdict in verdicts)
    return Trial(name, len(plan.sources) or None, inverted, ratio, angle, seconds)
