"""Nonsense of every kind, and the table of every public callable with arguments that are good: what `test_nonsense.py` mixes."""

import dataclasses
import functools
import inspect
import pathlib
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import foam
import numpy as np
from small import bricks

import jaxmorph as jm
from jaxmorph import cases, io, plot, shapes

MODULES = {"jm": jm, "io": io, "shapes": shapes, "plot": plot, "cases": cases}

BUILT = {
    *(
        "jm.BoundaryQuality",
        "jm.Choice",
        "jm.Chunks",
        "jm.Estimate",
        "jm.FaceQuality",
        "jm.FreeFaces",
        "jm.Improvement",
    ),
    *("jm.Inspection", "jm.LargestStep", "jm.Plan", "jm.QualityReport", "jm.SmoothQuality", "jm.Steps", "jm.Surface"),
    *("jm.SurfaceHalf", "jm.WallQuality", "jm.MeshError", "shapes.Fit", "shapes.Stations", "plot.SurfaceErrors"),
    *("io.Box", "shapes.QualityRows"),
}
"""Classes whose constructors the library alone calls."""

CONTRACT = {
    *(
        "__call__",
        "at",
        "beside",
        "boxes",
        "carry",
        "carry_place",
        "check",
        "closest",
        "connect",
        "dense_count",
        "entries",
    ),
    *(
        "equals",
        "evaluate",
        "field",
        "fit",
        "fixed_reduction",
        "given",
        "height",
        "holds",
        "iterative",
        "local",
        "masses",
        "matched",
        "neutral",
    ),
    *("offset", "pairs", "place", "reduction", "rows", "slope", "sources", "RBF.through", "value", "check_surface"),
    *("of_surface", "init", "step", "guarded", "altered", "among", "reduced", "with_faces", "coordinates", "weights"),
    *(
        "lattice",
        "anchors",
        "apply",
        "sensitivities",
        "renumbered",
        "raise_if_inverted",
        "raise_if_singular",
        "reach",
        "walls",
        "chosen",
        "once",
    ),
}
"""Methods that the driver calls, or that take no argument, or an array that `at` takes as well."""


class Lazy:
    """A value that is made once, when it is needed."""

    def __init__(self, make: Callable[[], Any]):
        self.make = functools.cache(make)

    def __call__(self) -> Any:
        return self.make()


def square(k: int = 3) -> jm.Mesh:
    """A square of k by k quads with the patches `wall` (bottom), `far` (the three other sides) and `left`."""
    x, y = np.meshgrid(*[np.linspace(0, 1, k + 1)] * 2, indexing="ij")
    ids = np.arange((k + 1) ** 2).reshape(k + 1, k + 1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(-1, 4)
    far = np.unique(np.concatenate([ids[0, 1:], ids[-1, 1:], ids[:, -1]]))
    patches = {"wall": ids[:, 0], "far": far, "left": ids[0]}
    return jm.Mesh(np.stack([x.ravel(), y.ravel()], axis=1), {"quad": quads}, patches)


MESH, BRICKS = square(), bricks(2)
POINTS, PLACES = np.asarray(MESH.points), np.asarray(BRICKS.points)
N, M = len(POINTS), len(MESH.patch("wall"))
U, X = np.zeros((M, 2)), np.array([[0.0, 0.0], [0.5, -0.1], [1.0, 0.0], [0.5, 0.1]])
FOLDER = pathlib.Path(tempfile.mkdtemp(prefix="jaxmorph-nonsense-"))
CHORD = shapes.Chord()
(FOLDER / "moves.dat").write_text("".join(f"{node} 0.0 0.0\n" for node in MESH.patch("wall")))
np.savez(FOLDER / "moves.npz", displacement=U, ids=MESH.patch("wall"))
np.savez(FOLDER / "every.npz", sensitivity=POINTS)
BOX = shapes.FreeForm([-1.0, -1.0], 3 * np.eye(2), (3, 3))


@Lazy
def plan() -> jm.Plan:
    return jm.prepare(MESH, "wall", "far", method=jm.DelaunayGraph())


@Lazy
def reduced() -> jm.Plan:
    return jm.prepare(MESH, "wall", "far", method=jm.RBF(reduction=jm.AllPoints()))


@Lazy
def report() -> jm.QualityReport:
    return jm.quality(MESH, POINTS)


@dataclasses.dataclass(frozen=True)
class Argument:
    """A good value, or a function without arguments that makes it, and nonsense by name."""

    good: Any
    nonsense: dict[str, Any]

    def __sub__(self, names: str) -> "Argument":
        """Leaves out kinds that are sense here."""
        return Argument(self.good, {name: value for name, value in self.nonsense.items() if name not in names.split()})

    def __add__(self, more: dict[str, Any]) -> "Argument":
        return Argument(self.good, self.nonsense | more)


def instance(good: Any, cls: type) -> Argument:
    """An object of a class."""
    others = {"none": None, "word": "word", "number": 3, "list": [1, 2], "array": np.zeros(3), "class": cls}
    return Argument(good, others | {"object": object()})


def reals(good: Any, **more: Any) -> Argument:
    """An array of real numbers of one shape."""
    array = np.asarray(good, dtype=float)
    masked = np.ma.masked_array(array, mask=np.ones(array.shape, bool))
    return Argument(
        array,
        {
            "none": None,
            "word": "word",
            "words": array.astype(str),
            "objects": np.full(array.shape, None),
            "dates": np.zeros(array.shape, "M8[s]"),
            "complex": array + 1j,
            "masked": masked,
            "ragged": [[1.0, 2.0], [3.0]],
            "axis": array[None],
            "scalar": 0.1,
            "class": np.ndarray,
            **more,
        },
    )


def finite(good: Any, **more: Any) -> Argument:
    """The same where the values are read."""
    array = np.asarray(good, dtype=float)
    return reals(good, nan=np.full(array.shape, np.nan), infinite=np.full(array.shape, np.inf), **more)


def ids(good: Any, count: int, **more: Any) -> Argument:
    """Rows of `count` points."""
    array = np.asarray(good)
    return Argument(
        array,
        {
            "none": None,
            "word": "word",
            "objects": np.full(3, None),
            "dates": np.zeros(3, "M8[s]"),
            "complex": array + 1j,
            "floats": array + 0.5,
            "below": np.array([-1]),
            "beyond": np.array([count]),
            "huge": np.array([2**62]),
            "axis": array[None],
            "mask": np.ones(count, bool),
            "class": np.ndarray,
            **more,
        },
    )


def count(good: int, least: int = 1, **more: Any) -> Argument:
    """A whole number."""
    values = {"none": None, "word": "4", "half": 2.5, "nan": np.nan, "complex": 2j, "list": [1, 2], "less": least - 1}
    return Argument(good, values | {"flag": True, "array": np.ones(3, int), "class": int, **more})


def number(good: float, **more: Any) -> Argument:
    """A real number."""
    values = {"none": None, "word": "0.5", "complex": 1j, "list": [0.5, 0.6], "nan": np.nan, "object": object()}
    return Argument(good, values | {"array": np.ones(3), "class": float, **more})


def positive(good: float, **more: Any) -> Argument:
    return number(good, negative=-1.0, zero=0.0, infinite=np.inf, **more)


def flag(good: bool) -> Argument:
    return Argument(good, {"none": None, "word": "yes", "number": 2, "array": np.ones(3, bool), "class": bool})


def path(name: str) -> Argument:
    values = {"none": None, "number": 3, "list": ["a"], "mesh": MESH, "ending": FOLDER / "a.nonsense"}
    return Argument(FOLDER / name, values | {"folder": FOLDER / "nowhere" / name, "class": pathlib.Path})


def function(good: Callable) -> Argument:
    return Argument(good, {"none": None, "word": "word", "number": 3, "array": np.zeros(3)})


def mapping(good: dict) -> Argument:
    values = {"none": None, "word": "word", "number": 3, "list": [1], "empty": {}, "class": dict}
    return Argument(good, values | {"contents": {"a": 3}})


def mesh(good: jm.Mesh = MESH) -> Argument:
    return instance(good, jm.Mesh) + {"plan": plan, "empty": Lazy(lambda: jm.Mesh(np.zeros((0, 2))))}


def a_plan() -> Argument:
    return instance(plan, jm.Plan) + {"mesh": MESH}


def one_of(good: Any, *, optional: bool = False) -> Argument:
    """An object of one of the classes that a user extends."""
    base = next(each for each in type(good).__mro__ if each.__name__.startswith("Abstract"))
    made = instance(good, type(good)) + {"base": base}
    return made - "none" if optional else made


def word(good: str) -> Argument:
    return Argument(good, {"none": None, "number": 3, "list": [1], "word": "nonsense", "empty": "", "class": str})


NODES = {"moving": ids(MESH.patch("wall"), N), "fixed": ids(MESH.patch("far"), N)}
BOUNDARIES = {
    "symmetry": Argument((), {"none": None, "number": 3, "word": "nonsense", "list": [3], "class": jm.Plane}),
    "periodic": Argument((), {"none": None, "number": 3, "word": "nonsense", "list": [3], "class": jm.Periodic}),
    "sliding": Argument((), {"number": 3, "word": "nonsense", "list": [3], "class": jm.Slide}),
}
METHOD = {"method": one_of(jm.DelaunayGraph(), optional=True)}
FREE = {"free": ids([0], N)}
MOVED = finite(POINTS, short=POINTS[:3], wide=np.zeros((N, 3)))
MOTION = reals(U, short=U[:-1], wide=np.zeros((M, 3)))
KNOWN_MOTION = finite(U, short=U[:-1], wide=np.zeros((M, 3)))
PATH = reals(np.zeros((2, M, 2)), short=np.zeros((2, M - 1, 2)))
SHAPE = {"shape": one_of(BOX)}
LOOP = ids([0, 1, 2, 3], 4)
WALL = LOOP - "none"
AIRFOIL = reals(X, wide=np.zeros((4, 4)))
RATIO = number(0.1, below=-0.1, beyond=1.5)
LENGTH = positive(0.5)
WIDTH = {"support_radius": LENGTH}
CASE = {"points": count(400, 1)}
FIRST = {"first_cell": positive(1e-3)}

TABLE: dict[str, dict[str, Argument]] = {
    "jm.AllPoints": {},
    "jm.Biharmonic": {},
    "jm.ByDistance": {"exponent": number(1.0)},
    "jm.ByVolume": {"exponent": number(1.0)},
    "jm.Centre": {},
    "jm.Chunks.march": {"path": PATH},
    "jm.Chunks.plan": {"k": count(0, 0, beyond=99)},
    "jm.CompactC0": WIDTH,
    "jm.CompactC1": WIDTH,
    "jm.CompactC2a": WIDTH,
    "jm.CompactC2b": WIDTH,
    "jm.CompactRBF": {"radius": LENGTH - "none"},
    "jm.Corners": {},
    "jm.CubicSpline": {},
    "jm.DelaunayGraph": {},
    "jm.FarthestPoints": {"count": count(4), "separation": RATIO, "extremes": flag(True)},
    "jm.FittedRBF": {"rbf": instance(jm.RBF(), jm.RBF), "ell": LENGTH - "none", "mu": LENGTH - "none"},
    "jm.GaussPoints": {},
    "jm.Gaussian": {"radius": LENGTH},
    "jm.Graded": {"share": LENGTH - "none", "most": count(8), "separation": RATIO},
    "jm.Greedy": {
        "sources": count(4),
        "motions": finite(np.zeros((1, M, 2))) - "none",
        "tolerance": number(0.1, negative=-1.0),
        "group": RATIO,
        "separation": RATIO,
    },
    "jm.InverseDistance": {
        "far": number(3.0),
        "near": number(5.0),
        "alpha": number(0.1),
        "rotations": flag(False),
    },
    "jm.InverseMultiquadric": {"radius": LENGTH},
    "jm.InverseQuadratic": {"radius": LENGTH},
    "jm.KDTree": {
        "leaves": count(4) - "none",
        "search_points": one_of(jm.Corners()),
        "points_per_leaf": count(4) - "none",
        "smallest_box": number(0.1, negative=-1.0),
        "largest_box": number(1.0, negative=-1.0),
        "separation": RATIO,
        "extremes": flag(False),
        "crowded": count(4) - "none",
    },
    "jm.KDTree.with_sources": {"count": count(4), "points": finite(POINTS)},
    "jm.Laplacian": {"diffusivity": one_of(jm.ByVolume())},
    "jm.LinearElasticity": {"stiffening": one_of(jm.ByVolume()), "poisson": number(0.1, beyond=0.5, below=-1.0)},
    "jm.LinearSpline": {},
    "jm.Direct": {},
    "jm.Iterative": {
        "tolerance": positive(1e-8, beyond=1.5),
        "neighbours": count(20, 8),
        "dense": count(20, 8) - "none",
    },
    "jm.Mesh": {
        "points": reals(POINTS, wide=np.zeros((N, 4)), flags=np.zeros((N, 2), bool)),
        "cells": mapping({"quad": np.asarray(MESH.cells["quad"])}) - "none empty",
        "patches": mapping({"a": [0, 1]}) - "none empty contents",
    },
    "jm.Mesh.from_meshio": {"mesh": instance(Lazy(lambda: MESH.to_meshio()), object)},
    "jm.Mesh.from_pyvista": {"grid": instance(Lazy(lambda: MESH.to_pyvista()), object)},
    "jm.Mesh.moved": {"points": reals(POINTS, short=POINTS[:3], wide=np.zeros((N, 3)))},
    "jm.Mesh.patch": {"*": word("wall")},
    "jm.Mesh.patch_names": {"*": word("wall")},
    "jm.Mesh.to_meshio": {
        "point_data": mapping({"a": np.zeros(N)}) - "none empty",
        "cell_data": mapping({}) - "none empty",
    },
    "jm.Mesh.to_pyvista": {
        "point_data": mapping({"a": np.zeros(N)}) - "none empty",
        "cell_data": mapping({}) - "none empty",
    },
    "jm.Multiquadric": {"radius": LENGTH},
    "jm.LocalCorrection": {"radius": LENGTH - "none"},
    "jm.Multiscale": {},
    "jm.Multiscale.whole": {"radius": LENGTH, "fraction": positive(0.1, beyond=1.5)},
    "jm.NearWall": {"correction": one_of(jm.DelaunayGraph()), "width": LENGTH - "none"},
    "jm.PGreedy": {"count": count(4), "separation": RATIO},
    "jm.Periodic": {
        "patch": ids([0], N) - "word below beyond huge",
        "partner": ids([1], N) - "word below beyond huge",
        "translation": finite([0.0, 1.0]) - "none",
        "copies": count(1),
    },
    "jm.Plane": {"normal": finite([0.0, 1.0], zero=np.zeros(2), wide=np.ones(3)), "origin": finite([0.0, 0.0])},
    "jm.Plane.through": {"points": finite(POINTS), "nodes": ids(MESH.patch("wall"), N)},
    "jm.QualityReport.max": {"name": word("skewness")},
    "jm.QualityReport.mean": {"name": word("skewness"), "weighted": flag(True)},
    "jm.QualityReport.min": {"name": word("skewness")},
    "jm.QualityReport.worst": {"k": count(3, 0), "by": word("skewness") - "none"},
    "jm.RBF": {
        "basis": one_of(jm.ThinPlateSpline()),
        "reduction": one_of(jm.AllPoints()),
        "fixed_reduction": one_of(jm.AllPoints()),
        "degree": count(1, 0, beyond=2) - "none",
        "ridge": number(0.1, negative=-1.0, infinite=np.inf),
    },
    "jm.RBF.classic": {"basis": one_of(jm.ThinPlateSpline(), optional=True), "degree": count(1, 0, beyond=2) - "none"},
    "jm.Revolution": {
        "axis": finite([0.0, 0.0, 1.0], zero=np.zeros(3), short=np.ones(2)) - "none",
        "origin": finite(np.zeros(3)) - "none",
        "profile": finite([[0.0, 1.0], [1.0, 1.0]], back=[[1.0, 1.0], [0.0, 1.0]]) - "none",
    },
    "jm.RigidBlend": {"inner": number(0.1, negative=-1.0, infinite=np.inf), "outer": LENGTH},
    "jm.Slide": {
        "patch": ids([0], N) - "word below beyond huge",
        "on": instance(jm.Plane([0.0, 1.0], [0.0, 0.0]), jm.Plane) - "none",
    },
    "jm.SpringAnalogy": {"exponent": number(1.0)},
    "jm.SurfaceHalf.attach": {"points": finite(POINTS), "nodes": ids(np.arange(N), N) - "beyond huge"},
    "jm.SurfaceReconstruction": {"coarse": one_of(jm.RBF()), "correction": one_of(jm.DelaunayGraph())},
    "jm.SurfaceReconstruction.published": {"leaves": count(4), "fixed_leaves": count(4)},
    "jm.ThinPlateSpline": {},
    "jm.TorsionalSprings": {"lineal": number(0.1)},
    "jm.ValidSteps": {
        "plan": a_plan(),
        "mesh": mesh(),
        "displacement": function(lambda y: U),
        "min_jacobian_ratio": RATIO,
        "share": RATIO,
        "slope": RATIO,
        "decrease": RATIO,
    },
    "jm.WendlandC0": WIDTH,
    "jm.WendlandC2": WIDTH,
    "jm.WendlandC4": WIDTH,
    "jm.WendlandC6": WIDTH,
    "jm.boundary_quality": {"plan": a_plan(), "points": MOVED},
    "jm.choose": {
        "mesh": mesh(),
        **NODES,
        "motions": finite(np.ones((1, M, 2)), short=np.zeros((1, M - 1, 2))),
        **BOUNDARIES,
        "leaves": Argument((4,), {"none": None, "empty": (), "word": "4", "number": 4, "half": (2.5,), "less": (0,)}),
        "tolerance": number(0.01, negative=-1.0),
    },
    "jm.deform": {"plan": a_plan(), "u": MOTION},
    "jm.distortion": {
        "mesh": mesh(),
        "points": reals(POINTS, short=POINTS[:3], wide=np.zeros((N, 3))) - "none",
        "ideal": flag(False),
        "size_weight": RATIO,
        "softness": positive(1e-3),
    },
    "jm.estimate": {
        "mesh": mesh(),
        **NODES,
        **METHOD,
        "steps": count(1),
        "chunk": count(4) - "none",
    },
    "jm.face_quality": {"mesh": mesh(), "points": MOVED - "none nan infinite"},
    "jm.fewest_steps": {
        "plan": a_plan(),
        "mesh": mesh(),
        "motion": function(lambda t: t * U),
        "min_jacobian_ratio": RATIO,
        "max_steps": count(4),
    },
    "jm.improve": {
        "mesh": mesh(),
        "points": MOVED,
        "fixed": ids(MESH.patch("far"), N) - "none",
        "symmetry": BOUNDARIES["symmetry"],
        "periodic": BOUNDARIES["periodic"],
        "sliding": BOUNDARIES["sliding"],
        "ideal": flag(False),
        "size_weight": RATIO,
        "tolerance": number(0.03, negative=-1.0),
        "max_steps": count(2),
        "progress": function(lambda *_: None) - "none",
    },
    "jm.inspect": {
        "plan": a_plan(),
        "u": KNOWN_MOTION,
        "mesh": mesh() - "none",
        "nodes": ids(np.arange(N), N) - "none beyond huge",
    },
    "jm.inverted": {"mesh": mesh(), "points": MOVED - "nan infinite"},
    "jm.largest_step": {
        "plan": a_plan(),
        "u": KNOWN_MOTION,
        "direction": KNOWN_MOTION,
        "mesh": mesh(),
        "min_jacobian_ratio": RATIO,
        "max_step": positive(1.0),
    },
    "jm.load": {"path": path("a.npz") - "ending folder"},
    "jm.march": {"plan": a_plan(), "path": PATH, "rebuild": flag(False)},
    "jm.prepare": {"mesh": finite(POINTS, far=POINTS + 1e300), **NODES, **METHOD, **BOUNDARIES, **FREE},
    "jm.prepare_in_chunks": {
        "mesh": finite(POINTS, far=POINTS + 1e300),
        **NODES,
        "size": count(4) - "none",
        **METHOD,
        **BOUNDARIES,
        **FREE,
    },
    "jm.prepare_surface": {
        "mesh": finite(POINTS, far=POINTS + 1e300),
        **NODES,
        "nodes": ids(np.arange(N), N) - "none beyond huge",
        **METHOD,
        **BOUNDARIES,
        **FREE,
    },
    "jm.pullback": {"plan": a_plan(), "u": MOTION, "cotangent": reals(POINTS, short=POINTS[:3])},
    "jm.quality": {"mesh": mesh(), "points": MOVED - "none nan infinite"},
    "jm.refit": {"plan": a_plan(), "points": reals(POINTS, short=POINTS[:3])},
    "jm.replay": {
        "plans": Argument(Lazy(lambda: (plan(),)), {"none": None, "empty": (), "word": "a", "number": 3, "list": [3]}),
        "path": PATH,
    },
    "jm.save": {"path": path("a.npz") - "ending folder", "plan": a_plan()},
    "jm.shard": {
        "plan": a_plan(),
        "devices": Argument((), {"none": None, "empty": (), "word": "cpu", "number": 1, "list": [1]}),
    },
    "jm.smooth_quality": {
        "mesh": mesh(),
        "points": MOVED - "none nan infinite",
        "sharpness": LENGTH,
        "softness": LENGTH,
    },
    "jm.soft_maximum": {
        "values": reals([1.0, 2.0]) - "axis scalar",
        "sharpness": LENGTH,
        "axis": count(0, 0, beyond=3) - "none less",
    },
    "jm.velocity": {"plan": a_plan(), "u": MOTION, "u_dot": MOTION},
    "jm.untangle": {"mesh": mesh(), "points": MOVED},
    "jm.wall_quality": {
        "mesh": mesh(),
        "wall": ids(MESH.patch("wall"), N, name="nonsense"),
        "points": MOVED - "none nan infinite",
        "softness": LENGTH - "none",
    },
    "io.XDMFSeries.add": {"time": number(0.0), "moved": mesh(), "report": instance(report, jm.QualityReport)},
    "io.Decomposed": {"path": path("case") - "folder"},
    "io.Decomposed.check_output": {"path": path("new") - "ending"},
    "io.Decomposed.folder": {"k": count(0, 0, beyond=2)},
    "io.Decomposed.read": {"k": count(0, 0, beyond=2)},
    "io.Decomposed.side": {"k": count(0, 0, beyond=2)},
    "io.Decomposed.surface": {
        "sides": Argument(
            Lazy(lambda: [decomposed().side(k) for k in (0, 1)]), {"word": "a", "number": 3, "list": [1], "empty": []}
        )
    },
    "io.Decomposed.writing": {
        "path": path("new") - "ending folder",  # the folder is looked for on entering
        "ranks": Argument(None, {"number": 3, "word": "a", "list": [1]}),
    },
    "io.Ranges": {
        "path": Argument(Lazy(lambda: ranges().path), (path("box.su2") - "folder").nonsense),
        "rows": count(9),
        "folder": Argument(FOLDER, (path("folder") - "none").nonsense),
    },
    "io.Ranges.cells": {},
    "io.Ranges.surface": {},
    "io.Ranges.check_output": {"path": path("new.su2")},
    "io.Ranges.nodes": {"k": count(0, 0, beyond=3)},
    "io.Ranges.put": {
        "k": count(0, 0, beyond=3),
        "points": Argument(
            np.ones((9, 3)), {"none": None, "word": "a", "fewer": np.ones((3, 3)), "nan": np.full((9, 3), np.nan)}
        ),
    },
    "io.Ranges.read": {"k": count(0, 0, beyond=3)},
    "io.Ranges.write": {"path": path("new.su2")},
    "io.XDMFSeries": {"path": path("a.xdmf"), "mesh": mesh()},
    "io.cell_arrays": {"report": instance(report, jm.QualityReport)},
    "io.check_gradient_output": {"path": path("a.csv")},
    "io.check_lattice_output": {"file": path("a.vts")},
    "io.check_output": {"path": path("a.vtu"), "mesh": mesh() - "empty"},
    "io.check_sensitivity_output": {"path": path("a.csv")},
    "io.global_nodes": {"mesh": instance(Lazy(lambda: decomposed().read(0)), jm.Mesh) + {"another": MESH}},
    "io.boxes": {"mesh": mesh() - "empty"},
    "io.with_boxes": {"mesh": mesh() - "empty", "new": Argument([], {"number": 3, "none": None, "class": dict})},
    "io.periodic": {"mesh": mesh() - "empty"},
    "io.symmetry": {"mesh": mesh() - "empty"},
    "io.read": {"path": path("a.vtu") - "folder"},
    "io.read_box": {
        "source": Argument(
            {"low": [0, 0], "high": [1, 1], "points": [2, 2], "moved": []},
            {"none": None, "number": 3, "list": [1], "empty": {}, "class": dict},
        ),
        "dimensions": count(2, 2, beyond=4),
    },
    "io.read_displacement": {
        "path": path("moves.npz") - "ending folder",
        "mesh": mesh() - "empty",
        "moving": ids(MESH.patch("wall"), N) - "axis",
        "is_position": flag(True),
    },
    "io.read_sensitivity": {
        "path": path("every.npz") - "ending folder",
        "mesh": mesh(),
        "moving": ids([0, 1], N) - "empty",
    },
    "io.read_surface": {"path": path("moves.dat") - "ending folder", "d": count(2, 2, beyond=4)},
    "io.write": {
        "path": path("a.vtu"),
        "mesh": mesh(),
        "point_data": mapping({"a": np.zeros(N)}) - "none empty",
        "cell_data": mapping({"a": np.zeros(9)}) - "none empty",
    },
    "io.write_gradient": {
        "path": path("a.csv"),
        "parameters": Argument({"a": 1.0}, {"word": "word", "object": object()}),
        "gradient": Argument({"a": 1.0}, {"none": None, "word": "word", "other": {"b": 1.0}}),
    },
    "io.write_lattice": {"file": path("a.vts"), "points": reals(np.zeros((2, 2, 2)))},
    "io.write_moved": {
        "path": path("a.vtu"),
        "mesh": mesh(),
        "moved": mesh(),
        "report": instance(report, jm.QualityReport),
    },
    "io.write_pvd": {
        "path": path("a.pvd"),
        "files": Argument(("a.vtu",), {"none": None, "number": 3, "word": "a", "list": [3]}),
        "times": Argument(
            (0.0,), {"none": None, "number": 3, "word": "a", "words": ["a"], "nan": [np.nan], "longer": [0.0, 1.0]}
        ),
    },
    "io.write_sensitivity": {
        "path": path("a.csv"),
        "ids": ids(np.arange(3), 3) - "beyond huge",
        "values": reals(np.zeros((3, 2)), short=np.zeros((2, 2))),
    },
    "shapes.BSplineCurve": {"points": finite(X), "count": count(3, 2), "degree": count(2)},
    "shapes.CST": {"order": count(3), "chord": instance(CHORD, shapes.Chord) - "none"},
    "shapes.Chain": {"shapes": mapping({"a": BOX})},
    "shapes.Child": {"child": one_of(BOX), "parent": one_of(BOX)},
    "shapes.Chord": {
        "nose": finite([0.0, 0.0]),
        "tail": finite([1.0, 0.0], same=[0.0, 0.0]),
        "up": finite([0.0, 1.0]) - "none",
    },
    "shapes.Chord.along": {"points": finite(X)},
    "shapes.FreeForm": {
        "origin": finite([0.0, 0.0]),
        "axes": finite(np.eye(2), flat=np.ones((2, 2))),
        "counts": Argument(
            (3, 3),
            {
                "none": None,
                "word": "33",
                "number": 3,
                "half": (2.5, 3),
                "less": (1, 3),
                "longer": (3, 3, 3),
                "flags": (True, True),
            },
        ),
        "degree": count(1) - "none list",
        "continuity": count(0, 0) - "none",
    },
    "shapes.FreeForm.around": {
        "points": finite(X),
        "counts": Argument((3, 3), {"none": None, "word": "33", "number": 3, "half": (2.5, 3), "less": (1, 3)}),
        "margin": number(0.1, infinite=np.inf, negative=-1.0),
        "degree": count(1) - "none list",
        "continuity": count(0, 0) - "none",
    },
    "shapes.FreeForm.linked": {
        "free": Argument(
            np.ones((3, 3), bool), {"word": "a", "number": 3, "shape": np.ones(3, bool), "floats": np.ones((3, 3))}
        ),
        "groups": Argument((), {"none": None, "number": 3, "word": "a", "list": [3], "beyond": [[(0, 0), (9, 9)]]}),
        "mirror": count(0, 0, beyond=2) - "none",
    },
    "shapes.FreeForm.raise_if_outside": {"x": finite(X)},
    "shapes.FreeForm.raise_if_torn": {"x": finite(X), "control": reals(np.zeros((3, 3, 2)))},
    "shapes.Function": {"function": function(lambda x, p: x), "rest": Argument(0.0, {})},
    "shapes.HicksHenne": {
        "centres": finite([0.3, 0.5], beyond=[1.5], twice=[0.5, 0.5]) - "scalar",
        "widths": positive(3.0) - "list array",
        "chord": instance(CHORD, shapes.Chord) - "none",
    },
    "shapes.Linked": {**SHAPE, "matrix": finite(np.ones((18, 1)))},
    "shapes.Modes": {"fields": finite(np.zeros((1, 4, 2)))},
    "shapes.NACA4": {
        "camber": number(0.02, infinite=np.inf),
        "place": number(0.4, below=0.0, beyond=1.0),
        "thickness": positive(0.12),
        "chord": instance(CHORD, shapes.Chord) - "none",
    },
    "shapes.OnRows": {**SHAPE, "rows": ids([0, 1], 4) - "beyond huge"},
    "shapes.Part": {
        **SHAPE,
        "kept": Argument(np.ones(4, bool), {"none": None, "word": "a", "floats": np.ones(4), "scalar": True}),
    },
    "shapes.ReferenceAxis": {
        "points": finite([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], one=np.zeros((1, 3))),
        "chordwise": finite([1.0, 0.0, 0.0]),
        "spanwise": finite([0.0, 1.0, 0.0]),
        "cubic": flag(False),
    },
    "shapes.Smoother": {
        "points": finite(X),
        "faces": ids([[0, 1], [1, 2], [2, 3], [3, 0]], 4),
        "length": number(0.1, negative=-1.0, infinite=np.inf),
        "held": ids([0], 4),
    },
    "shapes.Smoother.on": {
        "mesh": mesh(),
        "patch": word("wall"),
        "length": number(0.1, negative=-1.0),
        "held": ids([0], 4),
    },
    "shapes.Stations.on": {
        "x": finite(X),
        "faces": ids([[0, 1], [1, 2], [2, 3], [3, 0]], 4),
        "points": finite([[0.5, 0.0]]),
        "direction": finite([0.0, 1.0]) - "axis",
    },
    "shapes.Together": {"*": one_of(BOX)},
    "shapes.area": {"x": AIRFOIL, "loop": LOOP},
    "shapes.bend": {
        "x": reals(X),
        "angle": number(0.1),
        "about": finite([0.0, 0.0]),
        "along": finite([1.0, 0.0]),
        "length": positive(1.0),
        "axis": Argument(None, {"plane": [0.0, 0.0, 1.0]}),
    },
    "shapes.centroid": {"x": AIRFOIL, "loop": LOOP},
    "shapes.chord": {
        "x": AIRFOIL,
        "nose": count(0, 0, beyond=9) - "list array",
        "tail": count(2, 0, beyond=9) - "list array",
    },
    "shapes.curvature": {"x": AIRFOIL, "loop": LOOP},
    "shapes.displacement": {
        "shape": function(BOX),
        "plan": a_plan(),
        "parameters": Argument(Lazy(lambda: BOX.neutral()), {"none": None, "word": "a", "shape": np.zeros(3)}),
    },
    "shapes.fit": {**SHAPE, "points": finite(X), "targets": finite(X), "max_steps": count(2)},
    "shapes.fit_cst": {
        "points": finite(X),
        "order": count(3),
        "chord": instance(CHORD, shapes.Chord) - "none",
        "wall": WALL,
    },
    "shapes.leading_edge_radius": {"x": AIRFOIL, "loop": LOOP, "tail": count(2, 0, beyond=9), "around": count(1)},
    "shapes.names": {"parameters": Argument({"a": 1.0}, {"word": "word", "object": object()})},
    "shapes.path": {
        "shape": function(BOX),
        "x": reals(X),
        "parameters": Argument(Lazy(lambda: BOX.neutral()), {"word": "a", "shape": np.zeros(3)}),
        "steps": count(2),
    },
    "shapes.project": {
        "shape": function(BOX),
        "x": finite(X),
        "parameters": Argument(Lazy(lambda: BOX.neutral()), {"word": "a"}),
        "gradient": reals(X),
    },
    "shapes.pullback": {
        "shape": function(BOX),
        "plan": a_plan(),
        "parameters": Argument(Lazy(lambda: BOX.neutral()), {"word": "a"}),
        "cotangent": reals(POINTS),
    },
    "shapes.rotate": {
        "x": reals(X),
        "angle": number(0.1) - "list array",
        "about": finite([0.0, 0.0]),
        "axis": Argument(None, {"plane": [0.0, 0.0, 1.0]}),
    },
    "shapes.scale": {"x": reals(X), "factors": finite([1.0, 2.0]) - "scalar", "about": finite([0.0, 0.0])},
    "shapes.thickness": {
        "x": AIRFOIL,
        "stations": instance(
            Lazy(lambda: shapes.Stations.on(X, [[0, 1], [1, 2], [2, 3], [3, 0]], [[0.5, 0.0]], [0.0, 1.0])),
            shapes.Stations,
        ),
    },
    "shapes.trailing_edge_angle": {"x": AIRFOIL, "upper": ids([3, 2], 4), "lower": ids([1, 2], 4)},
    "shapes.translate": {"x": reals(X), "by": finite([0.0, 0.0])},
    "shapes.twist": {
        "x": reals(PLACES),
        "angle": number(0.1),
        "about": finite(np.zeros(3)),
        "axis": finite([0.0, 0.0, 1.0]),
        "length": positive(1.0),
    },
    "shapes.upper_side": {"points": finite(X), "chord": instance(CHORD, shapes.Chord) - "none", "wall": WALL},
    "shapes.varied": {
        "parameters": Argument({"a": 1.0}, {"word": "word"}),
        "changes": mapping({"a": 1.0}) - "empty contents",
    },
    "shapes.volume": {"x": reals(PLACES), "faces": ids([[0, 1, 2]], 27), "plane": finite(np.zeros(3)) - "none"},
    "shapes.Hexahedron": {
        "corners": finite([[0.0, 0], [1, 0], [1, 1], [0, 1]]),
        "counts": Argument((3, 3), {"number": 3, "none": None, "small": (1, 3), "long": (3, 3, 3), "word": "a"}),
        "degree": count(1, 1, beyond=3),
        "continuity": count(0, 0, beyond=2),
    },
    "shapes.Hexahedron.coordinates": {"x": finite(X)},
    "shapes.MeshGuard": {
        "plan": a_plan(),
        "mesh": mesh(),
        "displacement": function(lambda y: U),
        "min_jacobian_ratio": RATIO,
        "sharpness": positive(50.0),
    },
    "shapes.MeshGuard.smallest": {"design": finite([0.1])},
    "shapes.MeshGuard.value": {"design": finite([0.1])},
    "shapes.MeshGuard.gradient": {"design": finite([0.1])},
    "shapes.MeshGuard.quality_rows": {"design": finite([0.1]), "count": count(2, 1, beyond=10**6)},
    "shapes.MeshGuard.constraint": {"count": count(2) - "none"},
    "shapes.MeshGuard.guarded": {"objective": function(lambda y: (0.0, y))},
    "shapes.History": {
        "path": Argument(
            FOLDER / "new.jsonl", {"none": None, "number": 3, "list": ["a"], "folder": FOLDER / "nowhere" / "a"}
        )
    },
    "shapes.History.add": {
        "design": finite([0.1]),
        "value": number(1.0) - "none list nan array",
        "constraints": Argument({"a": 1.0}, {"word": "word", "number": 3, "contents": {"a": "word"}}),
        "measures": Argument({"a": 1.0}, {"word": "word", "number": 3, "contents": {"a": "word"}}),
    },
    "shapes.History.column": {"name": word("a")},
    "shapes.wall_normals": {"mesh": mesh(BRICKS), "*": word("floor")},
    "shapes.wall_faces": {"mesh": mesh(BRICKS), "patch": word("floor")},
    "shapes.wall_loop": {"mesh": mesh(), "patch": word("wall")},
    "plot.animate": {
        "path": path("a.gif"),
        "draw": function(lambda x: plot.mesh(MESH, x)),
        "frames": finite(np.stack([POINTS, POINTS])),
        "rate": positive(12.0),
    },
    "plot.before_after": {"mesh": mesh(), "points": MOVED},
    "plot.before_after_3d": {"mesh": mesh(BRICKS), "points": finite(PLACES), "patch": word("floor") - "none"},
    "plot.convergence": {"errors": mapping({"a": plot.SurfaceErrors(np.array([3]), np.array([0.1]), np.array([0.1]))})},
    "plot.cut": {
        "mesh": mesh(BRICKS),
        "points": finite(PLACES) - "none",
        "plane": instance(jm.Plane([0.0, 0.0, 1.0], [0.0, 0.0, 0.3]), jm.Plane),
        "values": reals(np.zeros(8)) - "none",
        "limits": finite([0.0, 1.0]) - "none",
        "bar": flag(True),
    },
    "plot.graph": {"plan": a_plan(), "u": KNOWN_MOTION - "none", "interior": flag(False)},
    "plot.histogram": {"reports": mapping(Lazy(lambda: {"a": report()})), "measure": word("skewness")},
    "plot.mesh": {
        "mesh": mesh(),
        "points": MOVED - "none",
        "values": reals(np.zeros(9)) - "none",
        "limits": finite([0.0, 1.0]) - "none",
        "bar": flag(True),
    },
    "plot.page": {
        "path": path("a.html"),
        "mesh": mesh(BRICKS),
        "points": finite(PLACES),
        "values": reals(np.zeros(8)) - "none",
        "limits": finite([0.0, 1.0]) - "none",
        "patch": word("floor") - "none",
    },
    "plot.picture": {"path": path("a.png"), "before": mesh(), "points": MOVED, "moving": ids(MESH.patch("wall"), N)},
    "plot.sources": {
        "surface": a_plan(),
        "reduction": one_of(jm.AllPoints(), optional=True),
        "fixed": flag(False),
        "search_points": flag(False),
    },
    "plot.sources_3d": {"surface": finite(PLACES), "reduction": one_of(jm.AllPoints())},
    "plot.surface": {
        "mesh": mesh(BRICKS),
        "points": finite(PLACES) - "none",
        "values": reals(np.zeros(8)) - "none",
        "limits": finite([0.0, 1.0]) - "none",
        "patch": word("floor") - "none",
    },
    "plot.surface_errors": {
        "plan": instance(reduced, jm.Plan),
        "u": finite(np.ones((M, 2)), short=U[:-1]),
        "reductions": Argument(
            (jm.AllPoints(),), {"none": None, "empty": (), "word": "a", "number": 3, "list": [3], "class": jm.AllPoints}
        ),
    },
    "plot.swing": {"points": finite(POINTS), "extreme": finite(POINTS, short=POINTS[:3]), "frames": count(4, 2)},
    "plot.whole": {"points": finite(POINTS)},
    "cases.agard445": {"points": count(5000)},
    "cases.agard445_mode": {"points": reals(PLACES), "mode": count(1, 1, beyond=9), "amplitude": number(1.0)},
    "cases.blade_tip": {"gap": positive(0.01), "layers": count(5)},
    "cases.bodies": {
        "boxes": mapping({"a": [-1.0, 1.0, -1.0, 1.0]}) - "empty",
        "box": finite([-4.0, 4.0, -4.0, 4.0], short=[0.0, 1.0], back=[4.0, -4.0, -4.0, 4.0]),
        "spacing": positive(0.5),
    },
    "cases.bricks": {"kind": word("tetra"), "cells": count(3), "first_cell": positive(0.1) - "none"},
    "cases.cascade": {
        "around": count(40, 4),
        "layers": count(8, 2),
        **FIRST,
        "pitch": positive(1.0),
        "periodic": flag(False),
    },
    "cases.channel": {"columns": count(6, 2), "rows": count(4, 2), "gap": positive(0.2), **FIRST},
    "cases.naca0015": CASE,
    "cases.naca4": {"code": word("2412"), **CASE, **FIRST, "sharp": flag(False)},
    "cases.sharp_o_grid": {
        "around": count(16, 4),
        "layers": count(8, 2),
        **FIRST,
        "camber": number(0.0),
        "edge": positive(12.0),
    },
    "cases.valve": {"lift": positive(0.1), "layers": count(5)},
    "cases.wing": {"code": word("6409"), **CASE, "stations": count(3, 2), "span": positive(2.0), **FIRST},
}


@functools.cache
def chunks() -> jm.Chunks:
    return jm.prepare_in_chunks(MESH, "wall", "far", size=8, method=jm.InverseDistance())


@functools.cache
def half() -> jm.SurfaceHalf:
    return jm.prepare_surface(MESH, "wall", "far", method=jm.InverseDistance())


@functools.cache
def series() -> io.XDMFSeries:
    return io.XDMFSeries(FOLDER / "series.xdmf", MESH)


@functools.cache
def decomposed() -> io.Decomposed:
    """A case of two parts, of four hexahedra each."""
    sides = np.array([(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)])
    cells = np.asarray(BRICKS.cells["hexahedron"])[:, sides].tolist()
    foam.write_parts(FOLDER / "case", PLACES, cells, [("all", "wall", lambda face: True)], np.arange(8) // 4)
    return io.Decomposed(FOLDER / "case")


@functools.cache
def ranges() -> io.Ranges:
    """The bricks in three ranges, all of their boundary in one marker."""
    outside = np.flatnonzero(((PLACES.min(axis=0) == PLACES) | (PLACES.max(axis=0) == PLACES)).any(axis=1))
    io.write(FOLDER / "box.su2", jm.Mesh(PLACES, BRICKS.cells, {"all": outside}))
    return io.Ranges(FOLDER / "box.su2", 9)


@functools.cache
def a_history() -> shapes.History:
    """A history of one iteration."""
    history = shapes.History(FOLDER / "history.jsonl")
    history.add([0.1], 1.0, measures={"a": 0.5})
    return history


OWNERS: dict[str, Callable[[], Any]] = {
    "io.Ranges": ranges,
    "io.Decomposed": decomposed,
    "io.XDMFSeries": series,
    "jm.Chunks": chunks,
    "jm.Mesh": lambda: MESH,
    "jm.Plan": plan,
    "jm.QualityReport": report,
    "jm.SurfaceHalf": half,
    "shapes.FreeForm": lambda: BOX,
    "shapes.Hexahedron": lambda: shapes.Hexahedron([[0.0, 0], [1, 0], [1, 1], [0, 1]], (3, 3)),
    "shapes.History": a_history,
    "shapes.MeshGuard": lambda: shapes.MeshGuard(plan(), MESH, lambda y: y[0] * U),
}
"""What the methods of a class are called on."""


def callable_of(name: str) -> Callable:
    """The callable of a name in the table; a method is that of its owner."""
    module, first, *rest = name.split(".")
    owner = f"{module}.{first}"
    found = OWNERS[owner]() if rest and owner in OWNERS else getattr(MODULES[module], first)
    return functools.reduce(getattr, rest, found)


def public() -> Iterator[str]:
    """Yields the names of all public callables: functions, classes that users build, and methods outside of `CONTRACT`."""
    for module, found in MODULES.items():
        for name in sorted(found.__all__ if hasattr(found, "__all__") else vars(found)):
            each = getattr(found, name)
            if name.startswith(("_", "Abstract")) or not callable(each) or not each.__module__.startswith("jaxmorph"):
                continue
            if f"{module}.{name}" not in BUILT:
                yield f"{module}.{name}"
            for member, value in vars(each).items() if inspect.isclass(each) else ():
                is_method = isinstance(value, staticmethod | classmethod) or inspect.isroutine(value)
                if (
                    (is_method or hasattr(value, "method"))
                    and not member.startswith("_")
                    and not {member, f"{name}.{member}"} & CONTRACT
                ):
                    yield f"{module}.{name}.{member}"


def made(value: Any) -> Any:
    """Calls what is to be made when it is needed."""
    return value() if isinstance(value, Lazy) else value
