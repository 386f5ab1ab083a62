"""Regions that gmsh fills with triangles or tetrahedra; their border stays as it is."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from .._host.cells.topology import Pair
from .._host.rows import Rows

try:
    import gmsh
except (ImportError, OSError) as error:  # OSError: a library of the system is missing
    raise ImportError(f"remeshing needs gmsh ({error}): pip install 'jaxmorph[remesh]'") from error

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
    "Mesh.OptimizeNetgen": 1,  # else flat tetrahedra are left, which the next moves invert
    "Mesh.RecombineAll": 0,
    "Mesh.SubdivisionAlgorithm": 0,
}


class Sizes(NamedTuple):
    """Lengths of edges to aim at: `values` (k, d + 1) at `corners` (k, d + 1, d) of simplices."""

    corners: ndarray
    values: ndarray


def fill_region(points: ndarray, border: ndarray, shells: ndarray, sizes: Sizes) -> Pair:
    """Fills the parts of a region within their borders: edges with the region on their left, or
    triangles. Returns new points (m, d), and simplices, whose ids count them after `points` (n, d).

    - `border` (f, d): node ids.
    - `shells` (f, 2): for each face, numbers of the part of the region, and of what lies behind.

    **Raises:** `ValueError` where gmsh fails.
    """
    n, d = points.shape
    nodes = np.unique(border)
    centre = points[nodes].mean(axis=0)
    extent = np.ptp(points[nodes], axis=0).max()  # gmsh has tolerances for sizes near 1
    places = np.zeros((n, 3))
    places[:, :d] = (points - centre) / extent
    scaled = Sizes((sizes.corners - centre) / extent, sizes.values / extent)
    added = [places[:0]]
    cells = [np.zeros((0, d + 1), int)]
    with _model(scaled):
        for number in np.unique(shells[:, 0]).tolist():
            rows = shells[:, 0] == number
            here = border[rows]
            new, simplices = _fill_part(places, here, shells[rows, 1])
            ids = np.append(np.unique(here), n + sum(map(len, added)) + np.arange(len(new)))
            added.append(new)
            cells.append(ids[simplices])
    return np.concatenate(added)[:, :d] * extent + centre, np.concatenate(cells)


def _fill_part(places: ndarray, border: ndarray, behind: ndarray) -> Pair:
    """Fills one part: new places, and simplices whose ids count them after the border's nodes."""
    d = border.shape[1]
    nodes = np.unique(border)
    mesher = gmsh.model.mesh
    gmsh.model.add("region of jaxmorph")
    try:
        mesher.field.add("PostView", 1)
        mesher.field.setNumber(1, "ViewIndex", gmsh.view.getIndex(gmsh.view.getTags()[-1]))
        mesher.field.setAsBackgroundMesh(1)
        if d == 2:
            _add_surface(places, border)
        else:
            _add_volume(places, border, behind)
        mesher.generate(d)
        tags, coordinates, _ = mesher.getNodes()
        _, corners = mesher.getElementsByType({2: 2, 3: 4}[d])
    except Exception as error:  # gmsh raises nothing more special
        raise ValueError(
            f"gmsh does not fill a region of {len(border)} border faces: {error}. Hand over "
            "earlier, with a larger `target`."
        ) from error
    finally:
        gmsh.model.remove()
    coordinates = np.asarray(coordinates).reshape(-1, 3)
    ids = _border_ids(coordinates, places[nodes])
    is_new = ids < 0
    ids[is_new] = len(nodes) + np.arange(is_new.sum())
    return coordinates[is_new], ids[Rows(np.asarray(tags, np.int64)).of(corners)].reshape(-1, d + 1)


def _border_ids(coordinates: ndarray, border: ndarray) -> ndarray:
    """The row of each point in the border's nodes, by all its bits; -1 for others."""
    places, which = np.unique(np.concatenate([border, coordinates]), axis=0, return_inverse=True)
    table = np.full(len(places), -1)
    table[which.ravel()[: len(border)]] = np.arange(len(border))
    return table[which.ravel()[len(border) :]]


@contextlib.contextmanager
def _model(sizes: Sizes) -> Iterator[None]:
    """Opens gmsh with a view of sizes; the caller's models and options stay."""
    is_own = not gmsh.isInitialized()
    if is_own:
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    current = gmsh.model.getCurrent()
    before = {name: gmsh.option.getNumber(name) for name in OPTIONS}
    view = gmsh.view.add("sizes")
    try:
        for name, value in OPTIONS.items():
            gmsh.option.setNumber(name, value)
        k, _, d = sizes.corners.shape
        rows = np.zeros((k, 4, d + 1))  # of each simplex x, y, z of all corners, then their sizes
        rows[:, :d] = sizes.corners.swapaxes(1, 2)
        rows[:, 3] = sizes.values
        gmsh.view.addListData(view, {2: "ST", 3: "SS"}[d], k, rows.ravel())
        yield
    finally:
        gmsh.view.remove(view)
        for name, value in before.items():
            gmsh.option.setNumber(name, value)
        if is_own:
            gmsh.finalize()
        elif current:
            gmsh.model.setCurrent(current)


def _add_surface(places: ndarray, border: ndarray) -> None:
    """Makes a surface between loops of straight lines of one element each."""
    geometry = gmsh.model.geo
    for node in np.unique(border).tolist():
        geometry.addPoint(*places[node].tolist(), tag=1 + node)
    for line, (first, last) in enumerate((1 + border).tolist(), start=1):
        geometry.addLine(first, last, line)
    loops = _loops(border)
    extents = [np.prod(np.ptp(places[border[loop, 0], :2], axis=0)) for loop in loops]
    tags = [geometry.addCurveLoop([1 + row for row in loop]) for loop in loops]
    geometry.addPlaneSurface([tags[k] for k in np.argsort(extents)[::-1].tolist()])
    geometry.synchronize()
    for line in range(1, 1 + len(border)):
        gmsh.model.mesh.setTransfiniteCurve(line, 2)


def _loops(border: ndarray) -> list[list[int]]:
    """Chains rows of edges, each begins where the last one ends; a node is in one loop."""
    following = {first: row for row, first in enumerate(border[:, 0].tolist())}
    loops = []
    while following:
        start = next(iter(following))
        loop = [following.pop(start)]
        while (end := int(border[loop[-1], 1])) != start:
            loop.append(following.pop(end))
        loops.append(loop)
    return loops


def _add_volume(places: ndarray, border: ndarray, behind: ndarray) -> None:
    """Makes a volume within given triangles, a surface for each thing behind them."""
    # gmsh knows a volume by its set of surfaces: a hole must not have the same set.
    nodes = np.unique(border)
    surfaces = []
    for number in np.unique(behind).tolist():
        surfaces.append(gmsh.model.addDiscreteEntity(2))
        gmsh.model.mesh.addNodes(2, surfaces[-1], 1 + nodes, places[nodes].ravel())
        corners = 1 + border[behind == number]
        gmsh.model.mesh.addElementsByType(surfaces[-1], 2, [], corners.ravel())
        nodes = nodes[:0]  # the first surface has all of them
    gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(surfaces)])
    gmsh.model.geo.synchronize()
