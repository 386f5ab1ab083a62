"""Quality of moved boundaries: distances from planes and surfaces, and periodic mismatch."""

import dataclasses
from collections.abc import Iterator, Sequence
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
    """Result of `boundary_quality`: largest distances in the mesh's unit, zero without such nodes.

    - `off_plane`: distance of nodes from their symmetry plane.
    - `off_surface`: distance of sliding nodes from their surface.
    - `mismatch`: distance of the second node of a periodic pair from the image of the first node.
    - `nodes`: id of the worst node, by the name of the distance; only for distances of the plan.
    - `ended`: ids (k,) of sliding nodes that have come to the end of their surface.
    """

    off_plane: float
    off_surface: float
    mismatch: float
    nodes: dict[str, int]
    ended: Int[np.ndarray, " k"]

    def renumbered(self, ids: np.ndarray) -> "BoundaryQuality":
        """Renumbers the nodes for a larger mesh: node k becomes `ids[k]`."""
        ids = np.asarray(ids)
        nodes = {name: int(ids[node]) for name, node in self.nodes.items()}
        return dataclasses.replace(self, nodes=nodes, ended=ids[self.ended])

    def __str__(self) -> str:
        words = {
            "off_plane": "nodes of symmetry planes at most {:.2g} off",
            "off_surface": "sliding nodes at most {:.2g} off their surface",
            "mismatch": "periodic pairs match to {:.2g}",
        }
        parts = [
            f"{words[name].format(getattr(self, name))} (node {node})"
            for name, node in self.nodes.items()
        ]
        parts += [f"{len(self.ended)} at its end"] if len(self.ended) else []
        return "; ".join(parts) or "no planes, sliding or periodic patches"


@checked
def boundary_quality(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> BoundaryQuality:
    """Measures, on the host, how well moved points keep planes, sliding surfaces and pairs.

    The points (n, d) come from `deform`, the last step of a `march` (with its first plan),
    `improve`, or another tool.

    **Raises:** `ValueError` for another shape of `points`, and for a plan of a piece that lacks
    nodes of the surface: judge `half.plan`.
    """
    plan.check_surface("boundary_quality")
    points = finite_array("points", points, tuple(plan.points.shape))
    surface = np.asarray(plan.surface_nodes)
    largest = {"off_plane": 0.0, "off_surface": 0.0, "mismatch": 0.0}
    worst: dict[str, int] = {}
    for name, nodes, distance in deviations(plan, points):
        if len(nodes) and (name not in worst or distance.max() > largest[name]):
            largest[name], worst[name] = float(distance.max()), int(nodes[distance.argmax()])
    return BoundaryQuality(**largest, nodes=worst, ended=surface[ended(plan, points[surface])])


def deviations(plan: Plan, points: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields distances of moved points by plane, wall and pairing: field, nodes, distances."""
    for plane, is_on in zip(
        plan.images.planes, np.asarray(plan.volume.on_plane)[: len(points)].T, strict=True
    ):
        yield "off_plane", np.flatnonzero(is_on), np.abs(plane.height(points[is_on]))
    surface = np.asarray(plan.surface_nodes)
    for track in plan.surface.tracks:
        nodes = surface[np.asarray(track.rows)]
        for wall in track.walls:
            yield "off_surface", nodes, np.asarray(wall.distance(jnp.asarray(points[nodes])))
    for pairing in jax.tree.map(np.asarray, plan.surface.pairings):
        if pairing.copies:  # others are not periodic: they make one layer of cells move alike
            yield "mismatch", surface[pairing.first], pairing.misses(points[surface].astype(float))


def ended(plan: Plan, places: Float[np.ndarray, "o d"]) -> Int[np.ndarray, " k"]:
    """Sliding rows newly at or beyond an end of their only wall."""
    base = np.asarray(plan.surface_points)
    rows = [np.zeros(0, dtype=int)]
    for track in plan.surface.tracks:
        if len(track.walls) == 1:
            here = np.asarray(track.rows)
            wall = track.walls[0]
            rows.append(here[wall.has_end(places[here]) & ~wall.has_end(base[here])])
    return np.concatenate(rows)


def ends(nodes: np.ndarray, points: np.ndarray) -> str:
    if not len(nodes):
        return ""
    return (
        f"{len(nodes)} sliding nodes come to the end of their surface, first node {nodes[0]} at "
        f"({place_of(points[0])}): they pile "
        "up there or leave it. Move less, or slide on a larger surface, jm.Slide(patch, "
        "jm.Revolution(...))."
    )
