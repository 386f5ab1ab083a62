"""The Delaunay graph of a surface (section 2.3 of the paper, step 1).

Real surfaces are full of cospherical and coplanar nodes, which qhull turns into simplices without
volume. So the coordinates for qhull are moved by 1e-8 of the local spacing, by a fixed function of
place. Everything computed from the graph uses the true coordinates, and all weights are checked
against them.
"""

import contextlib
import dataclasses
import functools

import numpy as np
from scipy.spatial import Delaunay, QhullError

from ..package.cores import by_blocks
from ..package.orders import BETWEEN, canonical_order
from ..package.rounding import roundoff, spacing
from ..sources.separation import drop_close
from . import simplices
from .simplices import cofactors, smallest_height

JITTER = 1e-8
"""Relative to the nearest node's distance: at 1e-9 location is slow, at 1e-7 weights go wrong."""

SNAP = 2e-9
"""Rounding of coordinates for qhull, relative to the nearest node; well below `JITTER`."""

TRIALS = 4
"""Most jitters tried: qhull now and then ends with a precision error on good nodes."""

OPTIONS = "Qbb Qc Qz Q12 Q5"
"""SciPy's options of qhull, without a last check of outer planes, which simplices do not use."""

FLAT = 64
"""A simplex lower than this times the round-off of the coordinates holds no point."""


@dataclasses.dataclass(frozen=True, eq=False)
class Graph:
    """The Delaunay graph of a surface, in which any number of points can be located.

    `graph_of` makes it.

    - `unit` (b, d): the surface's nodes relative to `centre`, over `size`.
    - `unique` (k,), `nodes` (k, d): ids of the distinct nodes, and their places.
    - `delaunay`: the simplices between the distinct nodes.
    - `flat`: the height below which a simplex holds no point; `slack`: round-off of the
      coordinates.
    """

    centre: np.ndarray
    size: float
    unit: np.ndarray
    unique: np.ndarray
    nodes: np.ndarray
    delaunay: Delaunay
    flat: float
    slack: float

    def smallest_weight(self, simplex: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Computes least barycentric coordinates (k,) of points (k, d) in simplices (k,)."""
        return simplices.smallest_weight(self.nodes, self.delaunay.simplices, simplex, points, self.flat)


def graph_of(surface: np.ndarray) -> Graph:
    """Builds the Delaunay graph of a surface (b, d). Raises `ValueError` for a flat one."""
    dimension, slack = surface.shape[1], roundoff(surface)
    surface = surface.astype(np.float64, copy=False)
    centre, size = surface.min(axis=0), np.ptp(surface, axis=0).max() or 1.0
    unit = (surface - centre) / size
    unique = _without_coincident(unit, roundoff(surface) / size)
    nodes = unit[unique]
    if len(nodes) <= dimension:
        raise ValueError(
            f"a Delaunay graph in {dimension}-D needs {dimension + 1} distinct surface nodes, got {len(nodes)}."
        )
    flat = FLAT * roundoff(surface) / size
    return Graph(centre, size, unit, unique, nodes, _graph(nodes, flat), flat, slack)


class _Graph(Delaunay):
    """A triangulation with a closed form of the barycentric transforms.

    SciPy calls LAPACK for every simplex, whose threads cost twenty times more than the work. It
    fails for the flattest simplices, and then `find_simplex` searches through all simplices.
    """

    @functools.cached_property
    def transform(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Inverse of the edges from the last corner, and that corner: (k, d + 1, d)."""
        transform = np.empty((len(self.simplices), self.ndim + 1, self.ndim))

        def invert(part: slice) -> None:
            corners = self.points[self.simplices[part]]
            last = corners[:, -1]
            edges = [corners[:, i] - last for i in range(self.ndim)]
            rows = cofactors(edges)
            volume = np.einsum("kd,kd->k", rows[0], edges[0])
            with np.errstate(divide="ignore", invalid="ignore"):
                np.stack([*(row / volume[:, None] for row in rows), last], axis=1, out=transform[part])

        by_blocks(invert, len(transform))
        return transform


def _graph(nodes: np.ndarray, flat: float) -> Delaunay:
    graph, snapped = None, _snapped(nodes)
    for phase in range(TRIALS):
        with contextlib.suppress(QhullError):
            graph = _Graph(_jittered(snapped, phase), qhull_options=OPTIONS)
            break
    if graph is None or not _has_volume(nodes, graph.simplices, flat):
        raise ValueError(
            f"the {len(nodes)} surface nodes lie in one {'line' if nodes.shape[1] == 2 else 'plane'}, so no Delaunay graph "
            "spans the mesh. Add the other boundaries (far field, walls) as fixed nodes."
        )
    return graph


def _has_volume(nodes: np.ndarray, simplices: np.ndarray, flat: float) -> bool:
    """Checks whether any simplex is higher than `flat`; mostly one of the first is."""
    parts = np.split(simplices, range(4096, len(simplices), 4096))
    return any(bool((smallest_height(nodes[part]) > flat).any()) for part in parts)


def _without_coincident(unit: np.ndarray, closest: float) -> np.ndarray:
    """Lists distinct nodes in canonical order: of coincident ones the first, or a moving one."""
    rows = drop_close(unit, np.arange(len(unit)), closest)
    return rows[canonical_order(unit[rows])]


def _snapped(nodes: np.ndarray) -> np.ndarray:
    """Rounds coordinates to about `SNAP` of the distance of the nearest node.

    So the last bits of the mesh do not reach qhull. Jitter alone separates nodes on one sphere by
    no more than qhull's own round-off.
    """
    step = 2 ** np.floor(np.log2(SNAP * spacing(nodes)) + BETWEEN)[:, None]
    return np.floor(nodes / step + BETWEEN) * step


def _jittered(nodes: np.ndarray, phase: int) -> np.ndarray:
    """Moves nodes by `JITTER` of the distance of their nearest nodes, by a function of place alone.

    The function is a sine of very short wave length. Unlike random numbers, it does not depend on
    the order of the nodes, on units, or on the place of the mesh.
    """
    dimension = nodes.shape[1]
    waves = 1e6 * np.sqrt(np.array([[2.0, 3.0, 5.0], [7.0, 11.0, 13.0], [17.0, 19.0, 23.0]]))[:dimension, :dimension]
    # a sum of products has equal bits on every processor, a product of matrices has not
    angle = sum(column[:, None] * wave for column, wave in zip(nodes.T, waves, strict=True))
    return nodes + JITTER * spacing(nodes)[:, None] * np.sin(angle + np.arange(dimension) + phase)
