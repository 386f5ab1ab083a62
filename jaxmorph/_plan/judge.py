"""Moved boundaries: how far nodes are off planes and surfaces, and how well periodic pairs match."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int, Real

from .._host.package.arguments import checked, finite_array
from .._host.package.errors import place_of
from .plan import Plan


@dataclasses.dataclass(frozen=True)
class BoundaryQuality:
    """Result of `boundary_quality`: the largest distances in the mesh's unit, zero where a plan has no such nodes.

    - `off_plane`: of nodes from their symmetry plane.
    - `off_surface`: of sliding nodes from their surface.
    - `mismatch`: of the second node of a periodic pair from where the transform leads the first.
    - `nodes`: the id of the worst node, by the name of the distance; only for distances of the plan.
    - `ended`: ids (k,) of sliding nodes that have come to the end of their surface.
    """

    off_plane: float
    off_surface: float
    mismatch: float
    nodes: dict[str, int]
    ended: Int[np.ndarray, " k"]

    def renumbered(self, ids: np.ndarray) -> "BoundaryQuality":
        """Renumbers the nodes for a larger mesh, in which node k is node `ids[k]`."""
        ids = np.asarray(ids)
        nodes = {name: int(ids[node]) for name, node in self.nodes.items()}
        return dataclasses.replace(self, nodes=nodes, ended=ids[self.ended])

    def __str__(self) -> str:
        """Prints the distances that the plan has, in one line."""
        words = {
            "off_plane": "nodes of symmetry planes at most {:.2g} off",
            "off_surface": "sliding nodes at most {:.2g} off their surface",
            "mismatch": "periodic pairs match to {:.2g}",
        }
        parts = [f"{words[name].format(getattr(self, name))} (node {node})" for name, node in self.nodes.items()]
        parts += [f"{len(self.ended)} at its end"] if len(self.ended) else []
        return "; ".join(parts) or "no planes, sliding or periodic patches"


@checked
def boundary_quality(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> BoundaryQuality:
    """Measures, on the host, how well moved points keep symmetry planes, surfaces to slide on, and periodic pairs.

    It judges points from anywhere: `deform`, the last step of a `march`, `improve`, another tool.

    **Arguments:**

    - `plan`: what `prepare` returned, or the first plan of a `march`.
    - `points`: where the nodes are now (n, d), in the unit of the plan.

    **Returns:** a `BoundaryQuality`; `str` of it is a line.

    **Raises:** `ValueError` when the shape of `points` differs from the plan's. Also for a plan of a piece that lacks nodes of
    the surface: judge `half.plan`.
    """
    plan.check_surface("boundary_quality")
    points = finite_array("points", points, tuple(plan.points.shape))
    off: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"off_plane": [], "off_surface": [], "mismatch": []}
    if plan.images is not None:
        for plane, is_on in zip(plan.images.planes, np.asarray(plan.volume.on_plane)[: len(points)].T, strict=True):
            off["off_plane"].append((np.flatnonzero(is_on), np.abs(plane.height(points[is_on]))))
    guide, surface = plan.surface.guide, np.asarray(plan.surface_nodes)
    for track in () if guide is None else guide.tracks:
        nodes = surface[np.asarray(track.rows)]
        off["off_surface"] += [(nodes, np.asarray(wall.distance(jnp.asarray(points[nodes])))) for wall in track.walls]
    for pairing in () if guide is None else jax.tree.map(np.asarray, guide.pairings):
        off["mismatch"].append((surface[pairing.first], pairing.misses(points[surface].astype(float))))
    largest, worst = dict.fromkeys(off, 0.0), {}
    for name, parts in off.items():
        nodes = np.concatenate([np.zeros(0, int), *(ids for ids, _ in parts)])
        if len(nodes):
            distances = np.concatenate([each for _, each in parts])
            row = int(np.argmax(distances))
            largest[name], worst[name] = float(distances[row]), int(nodes[row])
    return BoundaryQuality(**largest, nodes=worst, ended=surface[ended(plan, points[surface])])


def ended(plan: Plan, places: Float[np.ndarray, "o d"]) -> Int[np.ndarray, " k"]:
    """Lists the surface's own rows that `places` has at or beyond an end of the surface on which they slide.

    Rows that were at an end in the base mesh do not count, nor do rows between two walls.
    """
    guide = plan.surface.guide
    base, rows = np.asarray(plan.surface_points), [np.zeros(0, dtype=int)]
    for track in () if guide is None else guide.tracks:
        if len(track.walls) == 1:
            here, wall = np.asarray(track.rows), track.walls[0]
            rows.append(here[wall.has_end(places[here]) & ~wall.has_end(base[here])])
    return np.concatenate(rows)


def ends(nodes: np.ndarray, points: np.ndarray) -> str:
    """Counts the nodes at the end of their surface, in two sentences; empty without such nodes."""
    if not len(nodes):
        return ""
    return (
        f"{len(nodes)} sliding nodes come to the end of their surface, first node {nodes[0]} at ({place_of(points[0])}): they pile "
        "up there or leave it. Move less, or slide on a surface that goes on, jm.Slide(patch, jm.Revolution(...))."
    )
