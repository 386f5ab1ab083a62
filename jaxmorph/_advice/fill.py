"""Regions that gmsh fills with triangles or tetrahedra; their border stays as it is."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from .._host.package.errors import place_of
from .._host.rows import Rows

try:
    import gmsh
except (ImportError, OSError) as error:  # OSError: a library of the system is missing
    raise ImportError(
        f"remeshing needs gmsh ({error}): pip install 'jaxmorph[remesh]'"
    ) from error

OPTIONS = {
    "General.Terminal": 0,
    "Mesh.Algorithm": 6,  # Frontal-Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.ElementOrder": 1,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0,
    "Mesh.Optimize": 1,
    "Mesh.RecombineAll": 0,
    "Mesh.SubdivisionAlgorithm": 0,
}


class Sizes(NamedTuple):
    """Lengths of edges to aim at: at the `corners` (k, d + 1, d) of simplices `values` (k, d + 1)."""

    corners: ndarray
    values: ndarray


def fill(
    points: ndarray, border: ndarray, part: ndarray, sizes: Sizes
) -> tuple[ndarray, ndarray]:
    """Fills each part of a region within its border: edges with the region on their left, or
    triangles. Returns new points (m, d), and simplices, whose ids count them after `points` (n, d).

    - `border` (f, d): node ids. `part` (f,): the part of the region that has each face.

    **Raises:** `ValueError` where gmsh fails, or would change the border.
    """
    n, d = points.shape
    nodes = np.unique(border)
    places = np.zeros((n, 3))
    places[:, :d] = points
    with _model(sizes):
        try:
            (_in_plane if d == 2 else _in_space)(places, border, part)
            gmsh.model.mesh.generate(d)
        except Exception as error:  # gmsh raises nothing more special
            where = place_of(points[nodes].mean(axis=0))
            raise ValueError(
                f"gmsh does not fill the region of {len(border)} border faces around {where}: "
                f"{error}."
            ) from error
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[d])
    coordinates = coordinates.reshape(-1, 3)
    ids = _border_ids(coordinates, places[nodes], nodes)
    is_new = ids < 0
    ids[is_new] = n + np.arange(is_new.sum())
    cells = ids[Rows(tags.astype(np.int64)).of(corners)].reshape(-1, d + 1)
    return coordinates[is_new, :d], cells


def _border_ids(coordinates: ndarray, border: ndarray, nodes: ndarray) -> ndarray:
    """The id of each point that is a border node, to the last bit; -1 for others."""
    places, which = np.unique(np.concatenate([border, coordinates]), axis=0, return_inverse=True)
    table = np.full(len(places), -1)
    which = which.ravel()
    table[which[: len(border)]] = nodes
    return table[which[len(border) :]]


@contextlib.contextmanager
def _model(sizes: Sizes) -> Iterator[None]:
    """Opens a model of gmsh with a field of sizes; the caller's models and options stay."""
    is_own = not gmsh.isInitialized()
    if is_own:
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    current = gmsh.model.getCurrent()
    before = {name: gmsh.option.getNumber(name) for name in OPTIONS}
    gmsh.model.add("region of jaxmorph")
    view = gmsh.view.add("sizes")
    try:
        for name, value in OPTIONS.items():
            gmsh.option.setNumber(name, value)
        k, _, d = sizes.corners.shape
        rows = np.zeros((k, 4, d + 1))  # of each simplex x, y, z of all corners, then their sizes
        rows[:, :d] = sizes.corners.swapaxes(1, 2)
        rows[:, 3] = sizes.values
        gmsh.view.addListData(view, {2: "ST", 3: "SS"}[d], k, rows.ravel())
        field = gmsh.model.mesh.field.add("PostView")
        gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
        gmsh.model.mesh.field.setAsBackgroundMesh(field)
        yield
    finally:
        gmsh.view.remove(view)
        gmsh.model.remove()
        for name, value in before.items():
            gmsh.option.setNumber(name, value)
        if is_own:
            gmsh.finalize()
        elif current:
            gmsh.model.setCurrent(current)


def _in_plane(places: ndarray, border: ndarray, part: ndarray) -> None:
    """Makes surfaces between loops of straight lines of one element each."""
    geometry = gmsh.model.geo
    for node in np.unique(border).tolist():
        geometry.addPoint(*places[node].tolist(), tag=1 + node)
    for line, (first, last) in enumerate((1 + border).tolist(), start=1):
        geometry.addLine(first, last, line)
    for number in np.unique(part).tolist():
        loops = _loops(border, np.flatnonzero(part == number))
        extents = [np.prod(np.ptp(places[border[loop, 0], :2], axis=0)) for loop in loops]
        tags = [geometry.addCurveLoop((1 + loop).tolist()) for loop in loops]
        geometry.addPlaneSurface([tags[k] for k in np.argsort(extents)[::-1].tolist()])
    geometry.synchronize()
    for line in range(1, 1 + len(border)):
        gmsh.model.mesh.setTransfiniteCurve(line, 2)


def _loops(border: ndarray, rows: ndarray) -> list[ndarray]:
    """Chains edges, each begins where the last one ends; a node is in one loop."""
    following = dict(zip(border[rows, 0].tolist(), rows.tolist(), strict=True))
    loops = []
    while following:
        start = next(iter(following))
        loop = [following.pop(start)]
        while (end := int(border[loop[-1], 1])) != start:
            loop.append(following.pop(end))
        loops.append(np.array(loop))
    return loops


def _in_space(places: ndarray, border: ndarray, part: ndarray) -> None:
    """Makes volumes within surfaces of given triangles."""
    nodes = np.unique(border)
    for number in np.unique(part).tolist():
        surface = gmsh.model.addDiscreteEntity(2)
        if len(nodes):  # of all surfaces, since two may touch
            gmsh.model.mesh.addNodes(2, surface, 1 + nodes, places[nodes].ravel())
            nodes = nodes[:0]
        corners = 1 + border[part == number]
        gmsh.model.mesh.addElementsByType(surface, 2, [], corners.ravel())
        gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop([surface])])
    gmsh.model.geo.synchronize()
