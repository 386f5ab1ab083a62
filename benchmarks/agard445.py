"""The paper's second case: the half wing AGARD 445.6 in tetrahedra, and its mode shapes; lengths in metres.

    mesh = agard445.mesh(points=6_500)
    u = agard445.mode(mesh.points[mesh.patch("wing")], 1, 0.25)

E. Carson Yates, "AGARD standard aeroelastic configurations for dynamic response. Candidate configuration I.-wing 445.6",
NASA TM-100492, 1987, "weakened model 3". The mesh needs gmsh and platformdirs: `pip install 'jaxmorph[cases]'`.
"""

import contextlib
import functools
import hashlib
import os
import resource
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import jaxmorph as jm

INCH = 0.0254
ROOT_CHORD = 21.96 * INCH
TIP_CHORD = 14.496 * INCH
SEMI_SPAN = 30.0 * INCH
TIP_LEADING_EDGE = 31.866 * INCH

# NACA 65A004, percent of the chord: stations, and half thickness at each. NASA TM-100492, which
# repeats the NACA's own ordinates for this section. At the last station 0.009 is published; 0 here
# gives the sharp trailing edge, on the straight line (0.490, 0.249, 0.008) along which the section
# ends anyway.
STATIONS = (0, 0.5, 0.75, 1.25, 2.5, 5, 7.5, *range(10, 101, 5))
HALF_THICKNESS = (
    *(0, 0.311, 0.378, 0.481, 0.656, 0.877, 1.062, 1.216, 1.463, 1.649, 1.790, 1.894, 1.962, 1.996),
    *(1.996, 1.952, 1.867, 1.742, 1.584, 1.400, 1.193, 0.966, 0.728, 0.490, 0.249, 0),
)
LEADING_EDGE_RADIUS = 0.102


def half_thickness(x: np.ndarray) -> np.ndarray:
    """Computes the half thickness of the section at `x` along the chord, both in chords.

    A cubic spline through the published ordinates in t = sqrt(x), in which a round nose is smooth:
    z = t sqrt(2 r) at the leading edge, r its radius.
    """
    t = np.sqrt(np.asarray(STATIONS) / 100)
    ends: Any = ((1, np.sqrt(2 * LEADING_EDGE_RADIUS / 100)), "not-a-knot")
    spline = CubicSpline(t, np.asarray(HALF_THICKNESS) / 100, bc_type=ends)
    return spline(np.sqrt(x))


def upper_contour(intervals: int) -> np.ndarray:
    """Places (intervals + 1, 2) points evenly along the arc of the upper contour, in chords.

    They run from leading to trailing edge.
    """
    x = np.linspace(0, 1, 20_001) ** 2
    z = half_thickness(x)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
    even = np.interp(np.linspace(0, arc[-1], intervals + 1), arc, x)
    return np.column_stack([even, half_thickness(even)])


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

RESOLUTIONS = {
    # Edges at the sharp corner of tip and trailing edge: others leave slivers there, that bending makes worse.
    64_943: Sizes(wall=0.935, growth=0.155, far=0.755, trailing_edge=3.6e-3, tip=3.6e-3),
    16_000: Sizes(wall=2.3, growth=0.194, far=1.4),
    6_500: Sizes(wall=4.0, growth=0.257, far=2.0),
}
PATCHES = ("wing", "symmetry", "farfield")
REVISION = 1
"""Raised by whoever changes how the mesh is made in a way that the numbers above do not show."""


def mesh(points: int = 64_943, directory: str | os.PathLike | None = None) -> jm.Mesh:
    """Makes the half wing of the paper's section 3.2, or reads it from its cache.

    x is streamwise, the span runs along +y from the plane y = 0, z is up. Sections are NACA 65A004 with a sharp trailing
    edge. The root chord is 0.558, the tip chord 0.368, the semi-span 0.762; the tip is flat. The far field is a hemisphere
    of 8 m round the middle of the root chord. Patches are `wing`, `symmetry` and `farfield`; a node where two of them meet
    is in both.

    The paper's mesh has 64,943 points, 334,861 cells, 16,285 nodes on the wing and 923 on the far field. Its aspect ratio
    is 1.546 in the mean and 7.223 at most: longest edge over 2 sqrt(6) inscribed radii, 1 for a regular cell. With gmsh 4.15:

    | `points` | points | cells | wing | far field | aspect ratio: mean, largest |
    |---|---|---|---|---|---|
    | 64_943 | 64,764 | 342,728 | 16,230 | 917 | 1.527, 7.15 |
    | 16_000 | 16,230 | 83,452 | 4,187 | 288 | 1.554, 6.70 |
    | 6_500 | 6,592 | 32,247 | 1,966 | 163 | 1.585, 6.59 |

    Equal meshes, bit for bit, with one version of gmsh. The finest takes 15 to 25 s, once: it is then in `directory`, by
    default the user's cache, under its parameters and gmsh's version.
    """
    import gmsh
    import platformdirs

    directory = Path(directory or platformdirs.user_cache_path("jaxmorph"))
    file = directory / _file_name(points, gmsh.__version__)
    if not file.exists():
        directory.mkdir(parents=True, exist_ok=True)
        arrays: dict[str, Any] = generate(gmsh, RESOLUTIONS[points])
        with tempfile.TemporaryDirectory(dir=directory) as folder:
            np.savez_compressed(Path(folder, file.name), **arrays)
            Path(folder, file.name).replace(file)
    with np.load(file) as stored:
        patches = {name: stored[name] for name in PATCHES}
        return jm.Mesh(stored["points"], {"tetra": stored["tetra"]}, patches)


def _file_name(points: int, gmsh_version: str) -> str:
    shape = (STATIONS, HALF_THICKNESS, LEADING_EDGE_RADIUS, ROOT_CHORD, TIP_CHORD)
    shape += (SEMI_SPAN, TIP_LEADING_EDGE, RADIUS, CENTRE, CONTOUR_INTERVALS, DISTANCE_SAMPLES)
    parameters = repr((REVISION, RESOLUTIONS[points], shape, sorted(OPTIONS.items())))
    return f"agard445-{points}-gmsh{gmsh_version}-{hashlib.sha256(parameters.encode()).hexdigest()[:12]}.npz"


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
        return _read(
            gmsh.model.mesh, volume, {"wing": wing, "symmetry": [symmetry], "farfield": farfield}
        )


@contextlib.contextmanager
def _session(gmsh: Any) -> Iterator[None]:
    """Opens and closes a session of gmsh under OPTIONS; an option that this gmsh does not have is left out."""
    limit = resource.getrlimit(resource.RLIMIT_STACK)
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    # gmsh lifts the limit for good; threads of child processes would then have too little for OpenBLAS
    resource.setrlimit(resource.RLIMIT_STACK, limit)
    try:
        for option, value in OPTIONS.items():
            with contextlib.suppress(Exception):
                gmsh.option.setNumber(option, value)
        yield
    finally:
        gmsh.finalize()


def _wing(geo: Any) -> tuple[list[int], dict[str, list[int]], list[int]]:
    """Makes the wing's surfaces, the curves that refine the mesh, and the root's contour."""
    root_front, root_back, root_upper, root_lower = _section(geo, 0.0, 0.0, ROOT_CHORD)
    tip_front, tip_back, tip_upper, tip_lower = _section(
        geo, TIP_LEADING_EDGE, SEMI_SPAN, TIP_CHORD
    )
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
        inner = [
            geo.addPoint(front + chord * x, y, side * chord * z) for x, z in contour[1:-1].tolist()
        ]
        curves.append(geo.addSpline([nose, *inner, back]))
    return nose, back, curves[0], curves[1]


def _outside(geo: Any, root: list[int]) -> tuple[list[int], int]:
    """Makes four patches of the hemisphere, and the symmetry plane up to the root."""
    centre, pole = geo.addPoint(CENTRE, 0.0, 0.0), geo.addPoint(CENTRE, RADIUS, 0.0)
    rim = [
        geo.addPoint(CENTRE + RADIUS * x, 0.0, RADIUS * z)
        for x, z in ((1, 0), (0, 1), (-1, 0), (0, -1))
    ]
    arcs = [geo.addCircleArc(rim[k], centre, rim[(k + 1) % 4]) for k in range(4)]
    ribs = [geo.addCircleArc(rim[k], centre, pole) for k in range(4)]
    sphere = [
        geo.addSurfaceFilling(
            [geo.addCurveLoop([arcs[k], ribs[(k + 1) % 4], -ribs[k]])], sphereCenterTag=centre
        )
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


# Deflections of 11 x 11 structural nodes, row by row from root to tip, each from leading to trailing edge. The unit of a mode
# is its own; only the component normal to the wing counts. The others are 1e-10 (mode 1) or 4e-6 (mode 2) of it.
# The nodes lie at tenths of the semi-span and of the chord, but for the sixth of each row: its x in
# inches.
SIXTH_NODE = (10.75, 13.65, 16.6, 19.5, 22.3, 25.2, 28.1, 30.9, 33.7, 36.7, 39.5)

DEFLECTIONS = {
    1: (
        (-0.0405, -0.0153, 0, 0, 0, 0, 0, 0, 0, -0.0524, -0.107),
        (0.00638, 0.0352, 0.069, 0.113, 0.166, 0.225, 0.306, 0.402, 0.538, 0.697, 0.914),
        (0.195, 0.317, 0.462, 0.628, 0.816, 1.03, 1.27, 1.56, 1.88, 2.25, 2.68),
        (0.815, 1.08, 1.38, 1.7, 2.05, 2.45, 2.86, 3.32, 3.84, 4.41, 5.03),
        (2.01, 2.42, 2.87, 3.35, 3.86, 4.43, 5, 5.63, 6.3, 7.03, 7.8),
        (3.8, 4.36, 4.95, 5.57, 6.22, 6.97, 7.63, 8.39, 9.19, 10, 10.9),
        (6.16, 6.85, 7.56, 8.29, 9.06, 9.96, 10.7, 11.5, 12.4, 13.3, 14.3),
        (9.05, 9.82, 10.6, 11.4, 12.3, 13.3, 14, 14.9, 15.9, 16.9, 17.9),
        (12.4, 13.2, 14, 14.9, 15.8, 16.8, 17.6, 18.5, 19.5, 20.5, 21.5),
        (16, 16.8, 17.7, 18.6, 19.5, 20.6, 21.3, 22.2, 23.2, 24.2, 25.1),
        (19.8, 20.6, 21.5, 22.4, 23.2, 24.4, 25, 26, 26.9, 27.8, 28.8),
    ),
    2: (
        (-0.315, -0.128, 0, 0, 0, 0, 0, 0, 0, -0.686, -2.28),
        (0.137, 0.335, 0.514, 0.668, 0.767, 0.778, 0.636, 0.238, -0.719, -2.35, -4.79),
        (1.62, 2.16, 2.59, 2.83, 2.83, 2.5, 1.74, 0.444, -1.5, -4.11, -7.53),
        (5.22, 5.84, 6.13, 6.03, 5.48, 4.35, 2.76, 0.476, -2.47, -6.1, -10.6),
        (10.5, 10.7, 10.4, 9.51, 8.05, 5.9, 3.28, -0.0744, -4.09, -8.8, -14.4),
        (16.5, 15.8, 14.4, 12.5, 9.91, 6.41, 2.86, -1.61, -6.72, -12.5, -19.2),
        (22, 20, 17.4, 14.3, 10.5, 5.47, 1.16, -4.39, -10.5, -17.3, -24.9),
        (25.9, 22.6, 18.7, 14.3, 9.4, 3.17, -2.01, -8.48, -15.5, -23, -31.3),
        (27.4, 22.9, 17.9, 12.4, 6.52, -0.653, -6.5, -13.6, -21.2, -29.2, -37.9),
        (26.3, 20.7, 14.8, 8.64, 2.11, -6.59, -11.9, -19.4, -27.3, -35.6, -44.5),
        (22.6, 16.5, 10.2, 3.58, -3.28, -12.4, -17.8, -25.6, -33.7, -42.3, -52.6),
    ),
}

SPAN_POWERS = range(2, 7)
CHORD_POWERS = range(4)


def structural_nodes() -> np.ndarray:
    """Returns the (121, 3) nodes of the table in metres, on the plane z = 0."""
    eta, xi = np.meshgrid(np.arange(11) / 10, np.arange(11) / 10, indexing="ij")
    x = TIP_LEADING_EDGE * eta + (ROOT_CHORD + (TIP_CHORD - ROOT_CHORD) * eta) * xi
    x[:, 5] = np.asarray(SIXTH_NODE) * INCH
    return np.column_stack([x.ravel(), SEMI_SPAN * eta.ravel(), np.zeros(eta.size)])


def deflections(mode: int) -> np.ndarray:
    """Returns the (121,) deflections of the table along z, 1 at the tip's trailing edge."""
    table = np.asarray(DEFLECTIONS[mode], dtype=float).ravel()
    return table / table[-1]


def planform_coordinates(points):
    """Computes `eta` along the span and `xi` along the chord (m,) of points (m, 3).

    They are 0 to 1 on the wing.
    """
    eta = points[:, 1] / SEMI_SPAN
    xi = (points[:, 0] - TIP_LEADING_EDGE * eta) / (ROOT_CHORD + (TIP_CHORD - ROOT_CHORD) * eta)
    return eta, xi


@functools.cache
def coefficients(mode: int) -> tuple[tuple[float, ...], ...]:
    """Fits a_ij of sum a_ij eta^i xi^j, i = 2..6, j = 0..3, to the table by least squares.

    The sum is 1 at the tip's trailing edge.

    There eta = xi = 1, so the coefficients add up to 1: the first is eliminated by it.
    """
    eta, xi = planform_coordinates(structural_nodes())
    terms = np.column_stack([eta**i * xi**j for i in SPAN_POWERS for j in CHORD_POWERS])
    rest = np.linalg.lstsq(
        terms[:, 1:] - terms[:, :1], deflections(mode) - terms[:, 0], rcond=None
    )[0]
    alpha = np.concatenate([[1 - rest.sum()], rest]).reshape(len(SPAN_POWERS), len(CHORD_POWERS))
    return tuple(tuple(float(value) for value in row) for row in alpha)


def mode(points, number: int, amplitude: float = 1.0):
    """Computes displacements (m, 3) of points (m, 3) by the first (bending) or second (torsion) mode, for NumPy or JAX.

    They are along z alone. The tip's trailing edge moves up, by `amplitude` in semi-spans; the published sign of mode 2, up at
    the tip's leading edge, is the opposite.

    The shape is sum a_ij eta^i xi^j, i = 2..6, j = 0..3, with eta along the span and xi along the chord from 0 to 1. Value and
    slope vanish at the root. The a_ij are least squares to the 121 published deflections, 1 at the tip's trailing edge. In
    that unit the root mean square of what is left, off the root, is 0.0007 in mode 1 and 0.0042 in mode 2. Most of it is next
    to the aft end of the root, which is free in the table: 0.0028 and 0.033 at a tenth of the span.
    """
    points = points if hasattr(points, "dtype") else np.asarray(points, dtype=float)
    eta, xi = planform_coordinates(points)
    along_span = 0.0
    for row in reversed(coefficients(number)):
        along_chord = 0.0
        for value in reversed(row):
            along_chord = along_chord * xi + value
        along_span = along_span * eta + along_chord
    upwards = np.array([0, 0, 1], dtype=points.dtype)
    return (amplitude * SEMI_SPAN * eta**2 * along_span)[:, None] * upwards[None]
