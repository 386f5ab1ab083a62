"""The AGARD 445.6 wing's mesh, made by gmsh."""

import contextlib
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

try:
    import resource
except ImportError:  # Windows has no limit of the stack
    resource = None

from ._agard445_wing import ROOT_CHORD, SEMI_SPAN, TIP_CHORD, TIP_LEADING_EDGE, upper_contour

RADIUS = 8.0
CENTRE = ROOT_CHORD / 2
CONTOUR_INTERVALS = 400
DISTANCE_SAMPLES = 200


class Sizes(NamedTuple):
    """Edge lengths in metres.

    `wall` scales the wing's edges, `growth` adds length per metre of distance.
    """

    wall: float
    growth: float
    far: float
    leading_edge: float = 2.65e-3
    trailing_edge: float = 3.7e-3
    tip: float = 3.7e-3
    mid_chord: float = 9.4e-3
    ramp: float = 0.16


# Everything that a mesh depends on and that a caller, or a later gmsh, may have set otherwise.
OPTIONS = {
    "General.Terminal": 0,
    "General.AbortOnError": 2,
    "General.NumThreads": 1,
    "Geometry.AutoCoherence": 1,
    "Geometry.ScalingFactor": 1,
    "Geometry.Tolerance": 1e-8,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.AlgorithmSwitchOnFailure": 1,
    "Mesh.AllowSwapAngle": 10,
    "Mesh.AngleToleranceFacetOverlap": 0.1,
    "Mesh.AnisoMax": 1e33,
    "Mesh.CheckSurfaceNormalValidity": 1,
    "Mesh.Dual": 0,
    "Mesh.ElementOrder": 1,
    "Mesh.HighOrderOptimize": 0,
    "Mesh.LcIntegrationPrecision": 1e-9,
    "Mesh.MaxIterDelaunay3D": 0,
    "Mesh.MaxNumThreads1D": 1,
    "Mesh.MaxNumThreads2D": 1,
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.MeshOnlyEmpty": 0,
    "Mesh.MeshOnlyVisible": 0,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromParametricPoints": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0,
    "Mesh.MinimumCircleNodes": 7,
    "Mesh.MinimumCurveNodes": 3,
    "Mesh.Optimize": 1,
    "Mesh.OptimizeNetgen": 0,
    "Mesh.OptimizeThreshold": 0.3,
    "Mesh.QualityType": 2,
    "Mesh.RandomFactor": 1e-9,
    "Mesh.RandomFactor3D": 1e-12,
    "Mesh.RandomSeed": 2,
    "Mesh.Recombine3DAll": 0,
    "Mesh.RecombineAll": 0,
    "Mesh.RefineSteps": 10,
    "Mesh.Renumber": 1,
    "Mesh.Smoothing": 1,
    "Mesh.SmoothRatio": 1.8,
    "Mesh.SubdivisionAlgorithm": 0,
    "Mesh.ToleranceEdgeLength": 0,
    "Mesh.ToleranceInitialDelaunay": 1e-12,
    "Mesh.TransfiniteTri": 0,
}


def generate(gmsh: Any, sizes: Sizes) -> dict[str, np.ndarray]:
    """Makes `points` (n, 3), `tetra` (k, 4) and the patches' node ids by the module `gmsh`."""
    with _session(gmsh):
        geo = gmsh.model.geo
        wing, edges, root = _wing(geo)
        farfield, symmetry = _outside(geo, root)
        volume = geo.addVolume([geo.addSurfaceLoop([*wing, symmetry, *farfield])])
        geo.synchronize()
        _set_sizes(gmsh.model.mesh.field, sizes, wing, edges)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.optimize("Relocate3D")
        return _read(gmsh.model.mesh, volume, {"wing": wing, "symmetry": [symmetry], "farfield": farfield})


@contextlib.contextmanager
def _stack_limit_kept() -> Iterator[None]:
    """Restores the limit of the stack, which gmsh lifts for good.

    The threads of child processes would otherwise have 2 MiB, too few for OpenBLAS.
    """
    if resource is None:
        yield
        return
    limit = resource.getrlimit(resource.RLIMIT_STACK)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_STACK, limit)


@contextlib.contextmanager
def _session(gmsh: Any) -> Iterator[None]:
    """Opens a fresh model under OPTIONS.

    A caller's own session keeps its options, its models and its current model.

    Neither configuration files nor signal handlers are touched. An option that this gmsh does not
    have is left out.
    """
    ours = not gmsh.isInitialized()
    if ours:
        with _stack_limit_kept():
            gmsh.initialize(readConfigFiles=False, interruptible=False)
    terminal, current = gmsh.option.getNumber("General.Terminal"), gmsh.model.getCurrent()
    gmsh.option.setNumber("General.Terminal", 0)
    before = {"General.Terminal": terminal}
    name = next(n for n in map("jaxmorph-{}".format, itertools.count()) if n not in gmsh.model.list())
    try:
        for option, value in OPTIONS.items():
            with contextlib.suppress(Exception):
                before.setdefault(option, gmsh.option.getNumber(option))
                gmsh.option.setNumber(option, value)
        gmsh.model.add(name)
        yield
    finally:
        if ours:
            gmsh.finalize()
        else:
            if name in gmsh.model.list():
                gmsh.model.setCurrent(name)
                gmsh.model.remove()
            if current in gmsh.model.list():
                gmsh.model.setCurrent(current)
            for option, value in reversed(before.items()):
                gmsh.option.setNumber(option, value)


def _wing(geo: Any) -> tuple[list[int], dict[str, list[int]], list[int]]:
    """Makes the wing's surfaces, the curves that refine the mesh, and the root's contour."""
    root_front, root_back, root_upper, root_lower = _section(geo, 0.0, 0.0, ROOT_CHORD)
    tip_front, tip_back, tip_upper, tip_lower = _section(geo, TIP_LEADING_EDGE, SEMI_SPAN, TIP_CHORD)
    leading, trailing = geo.addLine(root_front, tip_front), geo.addLine(root_back, tip_back)
    surfaces = [
        geo.addSurfaceFilling([geo.addCurveLoop([root, trailing, -tip, -leading])])
        for root, tip in ((root_upper, tip_upper), (root_lower, tip_lower))
    ]
    surfaces.append(geo.addPlaneSurface([geo.addCurveLoop([tip_upper, -tip_lower])]))
    edges = {"leading_edge": [leading], "trailing_edge": [trailing], "tip": [tip_upper, tip_lower]}
    return surfaces, edges, [root_upper, root_lower]


def _section(geo: Any, front: float, y: float, chord: float) -> tuple[int, int, int, int]:
    """Makes a section: leading and trailing edge (points), upper and lower contour (curves).

    Its nose is at `front`.

    Points are even along the arc. Surfaces are meshed in their parameters, and uneven parameters
    give bad cells.
    """
    contour = upper_contour(CONTOUR_INTERVALS)
    nose, back = geo.addPoint(front, y, 0.0), geo.addPoint(front + chord, y, 0.0)
    curves = []
    for side in (1, -1):
        inner = [geo.addPoint(front + chord * x, y, side * chord * z) for x, z in contour[1:-1].tolist()]
        curves.append(geo.addSpline([nose, *inner, back]))
    return nose, back, curves[0], curves[1]


def _outside(geo: Any, root: list[int]) -> tuple[list[int], int]:
    """Makes four patches of the hemisphere, and the symmetry plane up to the root."""
    centre, pole = geo.addPoint(CENTRE, 0.0, 0.0), geo.addPoint(CENTRE, RADIUS, 0.0)
    rim = [geo.addPoint(CENTRE + RADIUS * x, 0.0, RADIUS * z) for x, z in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    arcs = [geo.addCircleArc(rim[k], centre, rim[(k + 1) % 4]) for k in range(4)]
    ribs = [geo.addCircleArc(rim[k], centre, pole) for k in range(4)]
    sphere = [
        geo.addSurfaceFilling([geo.addCurveLoop([arcs[k], ribs[(k + 1) % 4], -ribs[k]])], sphereCenterTag=centre)
        for k in range(4)
    ]
    upper, lower = root
    return sphere, geo.addPlaneSurface([geo.addCurveLoop(arcs), geo.addCurveLoop([upper, -lower])])


def _set_sizes(field: Any, sizes: Sizes, wing: list[int], edges: dict[str, list[int]]) -> None:
    """Sets the sizes of edges.

    They are min(far, min(mid chord, edge + ramp x distance to it, ...) + growth x distance to the
    wing).
    """

    def distance(kind: str, tags: list[int]) -> str:
        tag = field.add("Distance")
        field.setNumbers(tag, kind, tags)
        field.setNumber(tag, "Sampling", DISTANCE_SAMPLES)
        return f"F{tag}"

    on_wing = repr(sizes.wall * sizes.mid_chord)
    for name, curves in edges.items():
        edge = sizes.wall * getattr(sizes, name)
        on_wing = f"min({on_wing}, {edge!r} + {sizes.ramp!r} * {distance('CurvesList', curves)})"
    total = field.add("MathEval")
    away = distance("SurfacesList", wing)
    field.setString(total, "F", f"min({sizes.far!r}, {on_wing} + {sizes.growth!r} * {away})")
    field.setAsBackgroundMesh(total)


def _read(mesh: Any, volume: int, patches: dict[str, list[int]]) -> dict[str, np.ndarray]:
    """Reads coordinates and ids of nodes that tetrahedra use."""
    tags, coordinates, _ = mesh.getNodes()
    tetra = mesh.getElementsByType(4, volume)[1].astype(np.int64).reshape(-1, 4)
    place = np.full(int(tags.max()) + 1, -1)
    place[tags.astype(np.int64)] = np.arange(len(tags))
    used, corners = np.unique(place[tetra], return_inverse=True)
    new_id = np.full(len(tags), -1)
    new_id[used] = np.arange(len(used))
    result = {"points": coordinates.reshape(-1, 3)[used], "tetra": corners.reshape(-1, 4)}
    for name, surfaces in patches.items():
        nodes = np.concatenate([mesh.getElementsByType(2, tag)[1] for tag in surfaces])
        result[name] = np.unique(new_id[place[nodes.astype(np.int64)]])
    return result
