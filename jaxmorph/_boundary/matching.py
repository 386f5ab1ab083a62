"""The nodes of periodic patches are paired, and the pairs checked."""

import contextlib
import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from .._host.package.errors import MeshError, place_of, worst_first
from .._host.package.rounding import Tree, spacing
from .pairing import ALONG_AXIS, Pairing
from .periodic import Periodic
from .symmetry import Plane, tolerance

MISMATCH = 1e-4
"""Largest allowed distance of a node from its partner's image, relative to the node spacing."""


def paired(
    periodic: Periodic, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " l"], points: Float[np.ndarray, "n d"]
) -> Pairing:
    """Pairs nodes of two patches. Raises `ValueError`, with the worst node, if they do not fit."""
    try:
        return _paired(periodic, first, second, points)
    except ValueError:
        if periodic.translation is None and not periodic.is_rotation:
            sides, copies = (periodic.patch, periodic.partner), periodic.copies
            axes = [{"axis": axis} for axis in np.eye(3)] if points.shape[1] == 3 else [{"about": (0, 0)}]
            for axis in axes:
                with contextlib.suppress(ValueError):
                    return _paired(Periodic(*sides, copies=copies, **axis), first, second, points)
        raise


def across_one_layer(planes: Sequence[Plane], points: Float[np.ndarray, "n d"]) -> tuple[Pairing, ...]:
    """Pairs the nodes of two parallel planes that hold all nodes, around one layer of cells.

    The pairs move alike, and make no images. There are none where the planes' nodes do not match.
    """
    nodes = [np.flatnonzero(plane.holds(points)) for plane in planes]
    for k, other in itertools.combinations(range(len(planes)), 2):
        normal, first, second = planes[k].normal, nodes[k], nodes[other]
        if len(first) != len(second) or len(first) + len(second) != len(points):
            continue
        if abs(normal @ planes[other].normal) > 0.5:
            translation = (planes[other].origin - planes[k].origin) @ normal * normal
            with contextlib.suppress(ValueError):
                found = _paired(Periodic(first, second, translation=translation), first, second, points)
                return (dataclasses.replace(found, copies=0),)
    return ()


def _paired(
    periodic: Periodic, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " l"], points: Float[np.ndarray, "n d"]
) -> Pairing:
    exact = points.astype(float)
    if not len(first) or not len(second):
        raise ValueError(f"{periodic.name}: one of them has no nodes.")
    matrix, shift, angle = _transform(periodic, exact[first].mean(axis=0), exact[second].mean(axis=0))
    images = exact[first] @ matrix.T + shift
    distance, nearest = map(np.asarray, Tree(exact[second]).query(images))
    gaps = np.minimum(spacing(exact[second]), np.ptp(exact, axis=0).max())
    allowed = np.maximum(MISMATCH * gaps[nearest], 2 * tolerance(points))
    unmatched = worst_first(distance, allowed)
    if unmatched.size:
        place = place_of(points[first[unmatched[0]]])
        raise MeshError(
            f"{periodic.name} do not match: {len(unmatched)} of {len(first)} nodes of the first have no partner, the worst is "
            f"node {{node}} at ({place}): {distance[unmatched[0]]:.3g} from the nearest after the transform. Check "
            "`translation`, or `rotation`, `about` and `axis`; they lead from the first patch to the second.",
            first[unmatched],
        )
    single = second[np.setdiff1d(np.arange(len(second)), nearest)]
    if single.size:
        raise MeshError(
            f"{periodic.name} do not match: {len(single)} of {len(second)} nodes of the second have no partner, first node "
            f"{{node}} at ({place_of(points[single[0]])}). Both patches need equal nodes: mesh one as the copy of the other.",
            single,
        )
    is_alone = first == second[nearest]
    sectors = 2 * np.pi / abs(angle) if angle else 0
    turn = round(sectors) if abs(sectors - round(sectors)) < 1e-6 * sectors else 0
    copies = periodic.copies if turn or not angle else max(1, min(periodic.copies, int((sectors - 1) / 2)))
    pairs = first[~is_alone].astype(np.int32), second[nearest][~is_alone].astype(np.int32)
    if not periodic.is_rotation and periodic.translation is None:
        shift = _sharp(np.median(exact[pairs[1]] - exact[pairs[0]], axis=0))  # most pairs have it bit for bit
    keeps = np.eye(len(shift))
    if periodic.is_rotation:  # the direction of the axis alone
        keeps = keeps - _generator(periodic.axis, len(shift))[1]
    return Pairing(*pairs, first[is_alone].astype(np.int32), matrix, shift, keeps, turn, copies, periodic.is_rotation)


def _transform(periodic: Periodic, middle: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns matrix, shift and angle (0 for a translation) of the transform."""
    dimension = len(middle)
    for name in ("translation", "about", "axis"):
        value = getattr(periodic, name)
        if value is not None and value.shape != (dimension,):
            raise ValueError(f"{periodic.name}: `{name}` has shape {value.shape}; the mesh has {dimension} dimensions.")
    if not periodic.is_rotation:
        shift = other - middle if periodic.translation is None else periodic.translation
        shift = _sharp(shift) if periodic.translation is None else shift
        if not np.abs(shift).max() > 0:
            raise ValueError(f"{periodic.name}: the translation is zero; give `rotation`, `about` or `axis`.")
        return np.eye(dimension), shift, 0.0
    if dimension == 3 and (periodic.axis is None or not np.linalg.norm(periodic.axis) > 0):
        raise ValueError(f"{periodic.name}: a rotation in 3-D needs an `axis` that is not zero.")
    if dimension == 2 and periodic.axis is not None:
        raise ValueError(f"{periodic.name}: a rotation in 2-D has no `axis`; give `about`.")
    about = np.zeros(dimension) if periodic.about is None else periodic.about
    cross, plane = _generator(periodic.axis, dimension)
    angle = periodic.rotation
    if angle is None:
        start, end = plane @ (middle - about), plane @ (other - about)
        angle = float(np.arctan2(end @ cross @ start, end @ start))
    if not abs(np.sin(angle / 2)) > 1e-12:
        raise ValueError(f"{periodic.name}: the angle of the rotation is zero.")
    matrix = np.eye(dimension) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return matrix, about - matrix @ about, angle


def _sharp(shift: np.ndarray) -> np.ndarray:
    """Clears components of a translation that are round-off: their coordinates stay bit for bit."""
    return np.where(np.abs(shift) < ALONG_AXIS * np.abs(shift).max(), 0, shift)


def _generator(axis: np.ndarray | None, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the matrix of the cross product with the axis, and the projection across the axis."""
    if axis is None:
        return np.array([[0.0, -1.0], [1.0, 0.0]]), np.eye(dimension)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return cross, -cross @ cross
