"""Nodes of a wall on a CAD model: found once, and evaluated on models built anew. On the host."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy import ndarray

from jaxmorph import MeshError
from jaxmorph.extend import cad_model

from ._arguments import shown_place
from ._cad_cells import BorderPlaces, ParameterMesh, lengths_of
from ._tolerances import SAME_LENGTH, UNIT_RATIOS

ON_MODEL = 0.01  # share of the shortest edge at a node by which it may be off the model
TRIED = 50
MOST = 0.9
"""Nodes that are tried, and the share of them that lie on the model then."""

SHARES = np.arange(8) / 8  # places on an edge by which the border of a face is followed


class Builder(NamedTuple):
    """A user's `build` of numbers (p,), which have a structure and shapes."""

    build: Callable[[Any], Any]
    structure: Any
    shapes: Sequence[tuple[int, ...]]

    def numbers(self, x: ndarray) -> Any:
        sizes = [int(np.prod(shape)) for shape in self.shapes]
        parts = np.split(x.astype(float), np.cumsum(sizes)[:-1])
        leaves = [
            part.reshape(shape) if shape else part.item()
            for part, shape in zip(parts, self.shapes, strict=True)
        ]
        return jax.tree.unflatten(self.structure, leaves)

    def told(self, x: ndarray) -> str:
        """Numbers (p,) for a message, by their names if they have any."""
        numbers = self.numbers(x)
        return shown_place(x) if isinstance(numbers, ndarray | float) else str(numbers)

    def __call__(self, x: ndarray) -> Any:
        """Builds the model at numbers (p,). Raises `ValueError` where there is none."""
        try:
            return cad_model(self.build(self.numbers(x)))
        except ImportError:
            raise
        except Exception as error:  # whatever the kernel of a user's model raises
            said = f"{type(error).__name__}: {error}"
            raise ValueError(f"no model at x = {self.told(x)}: {said}") from error


@dataclasses.dataclass(frozen=True, eq=False)
class WallOnModel:
    """Nodes (m, 3) of a wall on a model, as `Located` has them.

    `inner` (k,) are rows of nodes that are carried with the `borders` of their faces, in parameters
    that `scale` (f, 2) turns into lengths. `samples` follow the borders of all faces.
    """

    builder: Builder
    topology: Any
    points: ndarray
    dimension: ndarray
    number: ndarray
    at: ndarray
    scale: ndarray
    samples: BorderPlaces
    borders: BorderPlaces
    inner: ndarray

    def build(self, x: ndarray) -> Any:
        model = self.builder(x)
        change = self.topology.change(model.topology)
        if change is not None:
            raise ValueError(
                f"another topology at x = {self.builder.told(x)}: {change}. Nodes stay on faces "
                "and edges that are there at `x0` too: keep x where the model has the same ones."
            )
        return model

    def evaluate(self, model: Any, carried: ndarray) -> tuple[ndarray, ndarray]:
        """Places (m, 3) of the nodes, of which the inner ones are `carried` (k, 2); and what they
        are to be carried by, at the borders (b, 2).
        """
        maps = self._maps(model)
        places = np.empty(self.points.shape)
        rows = np.flatnonzero(self.dimension == 0)
        places[rows] = model.vertices[self.number[rows]]
        rows = np.flatnonzero(self.dimension == 1)
        low, high = model.ranges[self.number[rows]].T
        along = low + self.at[rows, 0] * (high - low)
        places[rows] = model.on_edges(self.number[rows], along)[:, 0]
        rows, at = self._parameters(maps, carried)
        places[rows] = model.on_faces(self.number[rows], at)[:, 0]
        face = self.borders.face
        left = self.borders.on(model) - self._mapped(maps, face, self.borders.at)
        return places, left * self.scale[face]

    def values(self, model: Any, carried: ndarray) -> ndarray:
        """Places and borders in one row (3 m + 2 b,)."""
        return np.concatenate([*map(np.ravel, self.evaluate(model, carried))])

    def values_or_reason(self, x: ndarray, carried: ndarray) -> ndarray | str:
        try:
            return self.values(self.build(x), carried)
        except ValueError as error:
            return str(error)

    def sides(self, model: Any, carried: ndarray) -> ndarray:
        """Derivatives (k, 2, 3) of inner nodes' places by what they are carried by."""
        rows, at = self._parameters(self._maps(model), carried)
        at = at[np.searchsorted(rows, self.inner)]
        face = self.number[self.inner]
        return model.on_faces(face, at, 1)[:, 1:] / self.scale[face][:, :, None]

    def _parameters(self, maps: ndarray, carried: ndarray) -> tuple[ndarray, ndarray]:
        rows = np.flatnonzero(self.dimension == 2)
        at = self._mapped(maps, self.number[rows], self.at[rows])
        at[np.searchsorted(rows, self.inner)] += carried / self.scale[self.number[self.inner]]
        return rows, at

    def _maps(self, model: Any) -> ndarray:
        """The affine change (f, 3, 2) of parameters that follows each face's border best."""
        change = self.samples.on(model) - self.samples.at
        maps = np.zeros((len(self.scale), 3, 2))
        for face, (rows, inverse) in self._fits.items():
            maps[face] = inverse @ change[rows]
        return maps

    @functools.cached_property
    def _fits(self) -> dict[int, tuple[ndarray, ndarray]]:
        faces = np.unique(self.samples.face)
        rows = [np.flatnonzero(self.samples.face == face) for face in faces]
        base = [self._base(self.samples.face[ids], self.samples.at[ids]) for ids in rows]
        inverses = [np.linalg.pinv(columns, rcond=1e-9) for columns in base]
        return dict(zip(faces.tolist(), zip(rows, inverses, strict=True), strict=True))

    def _base(self, face: ndarray, at: ndarray) -> ndarray:
        return np.column_stack([at * self.scale[face], np.ones(len(at))])

    def _mapped(self, maps: ndarray, face: ndarray, at: ndarray) -> ndarray:
        return at + np.einsum("mk,mkd->md", self._base(face, at), maps[face])


def wall_on_model(
    builder: Builder, x0: ndarray, points: ndarray, faces: ndarray, tolerance: float | None
) -> tuple[WallOnModel, ParameterMesh]:
    """Finds nodes (m, 3) on the model at `x0`; `faces` (t, 3) are triangles of the wall."""
    model = builder(x0)
    sides = points[faces] - points[np.roll(faces, 1, axis=1)]
    shortest = np.full(len(points), np.inf)
    lengths = np.linalg.norm(sides, axis=2)
    np.minimum.at(shortest, faces, lengths)
    np.minimum.at(shortest, np.roll(faces, 1, axis=1), lengths)
    shortest[np.isinf(shortest)] = np.median(lengths)
    least = SAME_LENGTH * np.ptp(points, axis=0).max()  # two nodes may stand at one place
    allowed = (
        np.maximum(ON_MODEL * shortest, least)
        if tolerance is None
        else np.full(len(points), tolerance)
    )
    located = model.locate(points, allowed)
    _check_distance(model, points, located.distance, allowed)
    scale = lengths_of(model)
    cells = ParameterMesh.of(model, located, points, faces, scale)
    samples = [(use, share) for use in range(len(model.uses)) for share in SHARES]
    return WallOnModel(
        builder=builder,
        topology=model.topology,
        points=points,
        dimension=located.dimension,
        number=located.number,
        at=located.at,
        scale=scale,
        samples=BorderPlaces.of(model, samples),
        borders=cells.borders,
        inner=cells.inner,
    ), cells


def _check_distance(model: Any, points: ndarray, distance: ndarray, allowed: ndarray) -> None:
    off = np.flatnonzero(distance > allowed)
    if not len(off):
        return
    worst = off[distance[off].argmax()]
    corners = model.facets.points
    low = corners.min(axis=0) - ON_MODEL * model.size
    high = corners.max(axis=0) + ON_MODEL * model.size
    some = slice(None, None, max(1, len(points) // TRIED))
    hints = []
    for factor in (*UNIT_RATIOS, *(1 / ratio for ratio in UNIT_RATIOS)):
        places = factor * points[some]
        if ((places >= low) & (places <= high)).all():
            is_on = model.closest(places).distance <= factor * allowed[some]
            hints += [factor] if is_on.mean() > MOST else []
    hint = (
        f"Times {hints[0]:.6g} the nodes lie on it: give mesh and model one unit."
        if hints
        else "Was the mesh made from this model, at `x0`? Else give a larger `tolerance`."
    )
    raise MeshError(
        f"{len(off)} of {len(points)} nodes are off the CAD model by more than their tolerance, at "
        f"most by {distance[worst]:.3g}, row {{node}} of the wall at {shown_place(points[worst])}. "
        f"{hint}",
        np.append(worst, off[off != worst]),
    )
