"""Nonsense for every argument of every public callable, made from signatures and from one good value of each argument."""

import functools
import importlib.util
import inspect
import pathlib
import re
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import foam
import numpy as np
from meshes import bricks, square

import jaxmorph as jm
from jaxmorph import cases, io, plot, shapes

MODULES = {"jm": jm, "io": io, "shapes": shapes, "plot": plot, "cases": cases}


def words(text: str) -> set[str]:
    return {*text.split()}


def each(names: str, value: Any) -> dict[str, Any]:
    return dict.fromkeys(names.split(), value)


BUILT = words("""
io.Box jm.BoundaryQuality jm.Comparison jm.Control jm.Cure jm.FaceQuality jm.FreeFaces jm.Improvement jm.Inspection
jm.LargestStep jm.MeshError jm.Plan jm.Proof jm.QualityReport jm.Remeshed jm.SmoothQuality jm.Steps jm.Surface jm.SurfaceHalf jm.Turn jm.Verdict
jm.WallQuality shapes.Fit shapes.QualityRows shapes.Stations
""")
"""Classes whose constructors the library alone calls."""
if importlib.util.find_spec("OCP") is None:
    BUILT.add("shapes.CAD")

CONTRACT = words("""
__call__ altered among apply at beside boxes carry carry_place check check_mesh check_surface chosen closest connect control correct
coordinates dense_count DesignedMesh.points DesignedMesh.ratios
entries equals evaluate field fit fixed_reduction given guarded has_free_sides height heights holds init iterative
lattice local masses matched neutral of_surface offset once pairs place places_of raise_if_inverted raise_if_singular raise_if_unproven
judged reach reduced reduction renumbered rows RBF.through sensitivities slope sources step type_of value walls weights with_faces
""")
"""Methods that the driver calls, or that take no argument, or an array that `at` takes as well."""


class Lazy:
    """A value that is made once, when it is needed."""

    def __init__(self, make: Callable[[], Any]):
        self.make = functools.cache(make)

    def __call__(self) -> Any:
        return self.make()


MESH, BRICKS = square(), bricks(2)
POINTS, PLACES = np.asarray(MESH.points), np.asarray(BRICKS.points)
N, WALL, FAR = len(POINTS), MESH.patch("wall"), MESH.patch("far")
U, X = np.zeros((len(WALL), 2)), np.array([[0.0, 0.0], [0.5, -0.1], [1.0, 0.0], [0.5, 0.1]])
LOOP = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
FOLDER = pathlib.Path(tempfile.mkdtemp(prefix="jaxmorph-nonsense-"))
(FOLDER / "moves.dat").write_text("".join(f"{node} 0.0 0.0\n" for node in WALL))
np.savez(FOLDER / "moves.npz", displacement=U, ids=WALL)
np.savez(FOLDER / "curve.npz", points=X, lines=LOOP)
FACETS = jm.Facets(X, LOOP)
np.savez(FOLDER / "every.npz", sensitivity=POINTS)
SPACE = {"mesh": BRICKS, "points": PLACES, "values": np.zeros(8)}
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
BOX = shapes.FreeForm([-1.0, -1.0], 3 * np.eye(2), (3, 3))


plan = Lazy(lambda: jm.prepare(MESH, "wall", "far", method=jm.DelaunayGraph()))
DESIGN = Lazy(lambda: jm.DesignedMesh(plan(), MESH, lambda y: y[0] * U))


report = Lazy(lambda: jm.quality(MESH, POINTS))


@Lazy
def decomposed() -> io.Decomposed:
    """A case of two parts, of four hexahedra each."""
    cells = [foam.cell(foam.HEXAHEDRON, *row) for row in BRICKS.cells["hexahedron"].tolist()]
    foam.write_parts(
        FOLDER / "case", PLACES, cells, [("all", "wall", lambda face: True)], np.arange(8) // 4
    )
    return io.Decomposed(FOLDER / "case")


@Lazy
def zones() -> tuple[jm.Mesh, ...]:
    """A file of one zone, as its meshes."""
    io.write(FOLDER / "zone.su2", BRICKS)
    return io.read_zones(FOLDER / "zone.su2")


@Lazy
def history() -> shapes.History:
    """A history of one iteration."""
    new = shapes.History(FOLDER / "history.jsonl")
    new.add([0.1], 1.0, measures={"a": 0.5})
    return new


OWNERS: dict[str, Callable[[], Any]] = {
    "io.Decomposed": decomposed,
    "jm.Boundary": Lazy(lambda: jm.Boundary(MESH, "wall", "far")),
    "jm.Facets": lambda: FACETS,
    "shapes.Onto": Lazy(lambda: shapes.Onto(FACETS, FACETS)),
    "shapes.Offset": Lazy(lambda: shapes.Offset(FACETS)),
    "jm.FaceQuality": Lazy(lambda: jm.face_quality(BRICKS, PLACES)),
    "jm.Mesh": lambda: MESH,
    "jm.Plan": plan,
    "jm.Proof": Lazy(lambda: jm.proof(MESH)),
    "jm.QualityReport": report,
    "jm.Steps": Lazy(lambda: jm.fewest_steps(plan(), MESH, U)),
    "jm.Turn": Lazy(lambda: jm.Turn.of(np.asarray(MESH.points)[WALL], U)),
    "jm.Verdict": Lazy(lambda: jm.judge(MESH)),
    "jm.Relay": Lazy(lambda: jm.Relay(plan(), MESH)),
    "jm.Remeshed": Lazy(lambda: jm.remesh(MESH, POINTS)),
    "jm.SurfaceHalf": Lazy(
        lambda: jm.prepare_surface(jm.Boundary(MESH, "wall", "far"), method=jm.InverseDistance())
    ),
    "shapes.FreeForm": lambda: BOX,
    "shapes.Hexahedron": lambda: shapes.Hexahedron(SQUARE, (3, 3)),
    "shapes.History": history,
    "shapes.MeshGuard": Lazy(lambda: shapes.MeshGuard(DESIGN())),
}
"""What the methods of a class are called on."""


GOOD: dict[str, dict[str, Any]] = {
    "": {
        **{
            "plan": plan,
            "report": report,
            "plans": Lazy(lambda: (plan(),)),
            "shape": BOX,
            "parent": BOX,
            "child": BOX,
        },
        **{"mesh": MESH, "moved": MESH, "points": POINTS, "u": U, "u_dot": U, "direction": U},
        **{
            "moving": WALL,
            "fixed": FAR,
            "boundary": Lazy(lambda: jm.Boundary(MESH, "wall", "far")),
        },
        **{"nodes": np.arange(N), "cotangent": POINTS},
        **{
            "path": np.zeros((2, len(WALL), 2)),
            "motions": np.ones((1, len(WALL), 2)),
            "wall": WALL,
        },
        **{"motion": lambda t: t * U, "displacement": lambda y: U, "k": 0, "nose": 0},
        **each("radius support_radius ell mu width exponent alpha lineal poisson", 0.5),
        **{
            "inner": 0.1,
            "outer": 0.5,
            "leaves": 4,
            "points_per_leaf": 4,
            "crowded": 4,
            "count": 4,
            "sources": 4,
        },
        **{
            "values": np.array([1.0, 2.0]),
            "name": "skewness",
            "parameters": Lazy(BOX.neutral),
            "steps": 2,
        },
        **{
            "patch": "wall",
            "x": X,
            "angle": 0.1,
            "length": 0.5,
            "about": np.zeros(2),
            "degree": 1,
            "tail": 2,
        },
        **{"file": FOLDER / "a.vts", "time": 0.0, "d": 2, "dimensions": 2, "order": 3},
        **{"methods": {"a": jm.DelaunayGraph()}},
    },
    "shapes": {"points": X, "faces": LOOP, "loop": np.arange(4), "wall": np.arange(4)},
    "plot": {"path": FOLDER / "a.png", "patch": "floor", "reduction": jm.AllPoints()},
    "io": {"path": FOLDER / "a.vtu"},
    "jm.curve": {
        "mesh": Lazy(lambda: jm.elevate(MESH, 2)),
        "surface": np.asarray(MESH.points)[WALL],
    },
    **each(
        "jm.Facets.closest jm.Facets.face jm.Facets.distance jm.Facets.at",
        {"points": X, "facing": np.ones((4, 2))},
    ),
    "jm.Facets": {"points": X, "faces": LOOP, "sides": np.ones((4, 2))},
    "jm.Facets.of": {"*": "wall"},
    "io.read_facets": {"path": FOLDER / "curve.npz"},
    **each("shapes.onto shapes.Onto", {"wall": FACETS, "target": FACETS}),
    "shapes.Offset": {"wall": FACETS, "field": np.ones(4)},
    "jm.Mesh": {"cells": {"quad": np.asarray(MESH.cells["quad"])}, "patches": {"a": [0, 1]}},
    "jm.Mesh.from_meshio": {"mesh": Lazy(MESH.to_meshio)},
    "jm.Mesh.from_pyvista": {"grid": Lazy(MESH.to_pyvista)},
    "jm.export": {"path": FOLDER / "a.plan", "layer": jm.Layer(np.arange(N), (0, 1))},
    "jm.KDTree": {"leaves": 4},
    "jm.Layer": {"points": np.arange(N), "axes": (0, 1)},
    "jm.Periodic": {
        "patch": np.array([0]),
        "partner": np.array([1]),
        "translation": np.array([0.0, 1.0]),
    },
    "jm.Plane": {"normal": np.array([0.0, 1.0]), "origin": np.zeros(2)},
    "jm.Plane.through": {"nodes": WALL},
    "jm.Revolution": {
        "axis": np.eye(3)[2],
        "origin": np.zeros(3),
        "profile": np.array([[0.0, 1.0], [1.0, 1.0]]),
    },
    "jm.Slide": {"patch": np.array([0]), "on": jm.Plane([0.0, 1.0], [0.0, 0.0])},
    **each("jm.boundary_faces jm.Mesh.patch jm.Mesh.patch_names jm.Mesh.skin", {"*": "wall"}),
    "jm.inspect": {"moved": POINTS},
    "jm.compare": {"methods": {"graph": jm.DelaunayGraph()}},
    **each("jm.load jm.save", {"path": FOLDER / "a.npz"}),
    **each("jm.prepare jm.Boundary", {"mesh": POINTS, "fixed": FAR}),
    "jm.shard": {"devices": ()},
    "jm.Verdict.together": {"parts": Lazy(lambda: [jm.judge(MESH), jm.judge(MESH)])},
    "io.Decomposed": {"path": FOLDER / "case"},
    "io.export_case": {"path": FOLDER / "case", "mesh": Lazy(lambda: decomposed().read(0))},
    "io.Decomposed.surface": {"sides": Lazy(lambda: [decomposed().side(k) for k in (0, 1)])},
    **each("io.Decomposed.check_output io.Decomposed.writing", {"path": FOLDER / "new"}),
    "io.global_nodes": {"mesh": Lazy(lambda: decomposed().read(0))},
    "io.read_box": {"source": {"low": [0, 0], "high": [1, 1], "points": [2, 2], "moved": []}},
    "io.read_displacement": {"path": FOLDER / "moves.npz"},
    "io.read_sensitivity": {"path": FOLDER / "every.npz"},
    "io.read_surface": {"path": FOLDER / "moves.dat"},
    "io.with_boxes": {"new": ()},
    "io.write_gradient": {
        "path": FOLDER / "a.csv",
        "parameters": {"a": 1.0},
        "gradient": {"a": 1.0},
    },
    "io.write_lattice": {"points": np.zeros((2, 2, 2))},
    "io.write_zones": {"path": FOLDER / "zones.su2", "meshes": zones},
    "io.write_pvd": {"path": FOLDER / "a.pvd", "files": ("a.vtu",), "times": (0.0,)},
    "io.write_sensitivity": {
        "path": FOLDER / "a.csv",
        "ids": np.arange(3),
        "values": np.zeros((3, 2)),
    },
    "shapes.CAD": {"build": lambda x: None, "x0": np.ones(1), "mesh": BRICKS, "*": "floor"},
    "shapes.Chain": {"shapes": {"a": BOX}},
    "shapes.FreeForm": {
        "origin": np.zeros(2),
        "axes": np.eye(2),
        "counts": (3, 3),
        "degree": 1,
        "continuity": 0,
    },
    "shapes.FreeForm.around": {"counts": (3, 3)},
    "shapes.FreeForm.linked": {"free": np.ones((3, 3), bool), "mirror": 0},
    "shapes.FreeForm.raise_if_torn": {"control": np.zeros((3, 3, 2))},
    "shapes.Function": {"function": lambda x, p: x, "rest": {}},
    "shapes.Hexahedron": {"corners": SQUARE, "counts": (3, 3), "degree": 1, "continuity": 0},
    "shapes.HicksHenne": {"centres": np.array([0.3, 0.5])},
    "shapes.History": {"path": FOLDER / "new.jsonl"},
    "shapes.History.add": {
        "design": np.array([0.1]),
        "value": 1.0,
        "constraints": {"a": 1.0},
        "measures": {"a": 1.0},
    },
    "shapes.History.column": {"name": "a"},
    "shapes.Linked": {"matrix": np.ones((18, 1))},
    **each(
        "shapes.MeshGuard.smallest shapes.MeshGuard.value shapes.MeshGuard.gradient",
        {"design": np.array([0.1])},
    ),
    **each("jm.ValidSteps shapes.MeshGuard", {"mesh": DESIGN}),
    "shapes.MeshGuard.callback": {"function": lambda y: None},
    "shapes.MeshGuard.guarded": {"objective": lambda y: (0.0, y)},
    "shapes.MeshGuard.quality_rows": {"design": np.array([0.1]), "count": 2},
    "shapes.Modes": {"fields": np.zeros((1, 4, 2))},
    "shapes.NACA4": {"camber": 0.02, "place": 0.4, "thickness": 0.12},
    "shapes.OnRows": {"rows": np.array([0, 1])},
    "shapes.Part": {"mask": np.ones(4, bool)},
    "shapes.ReferenceAxis": {"points": np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])},
    **each("shapes.Smoother shapes.Smoother.on", {"held": np.array([0])}),
    "shapes.SobolevMetric": {"wall": FACETS, "held": np.array([0])},
    **each(
        "shapes.area_of_revolution shapes.volume_of_revolution",
        {"x": SQUARE, "axis": jm.Plane([0.0, 1.0], [0.0, 0.0])},
    ),
    "shapes.Stations.on": {"points": np.array([[0.5, 0.0]]), "direction": np.array([0.0, 1.0])},
    "shapes.Together": {"*": BOX},
    "shapes.bend": {"along": np.array([1.0, 0.0])},
    "shapes.fit": {"targets": X, "max_steps": 2},
    "shapes.names": {"parameters": {"a": 1.0}},
    "shapes.project": {"gradient": X},
    "shapes.scale": {"factors": np.array([1.0, 2.0])},
    "shapes.thickness": {
        "stations": Lazy(lambda: shapes.Stations.on(X, LOOP, [[0.5, 0.0]], [0.0, 1.0]))
    },
    "shapes.translate": {"by": np.zeros(2)},
    "shapes.twist": {"x": PLACES, "about": np.zeros(3), "axis": np.array([0.0, 0.0, 1.0])},
    "shapes.varied": {"parameters": {"a": 1.0}, "changes": {"a": 1.0}},
    "shapes.volume": {"x": PLACES, "faces": np.array([[0, 1, 2]]), "plane": np.zeros(3)},
    "shapes.upper_side": {"*": "wall", "chord": shapes.Chord([0.0, 0.0], [1.0, 0.0])},
    "shapes.wall_normals": {"mesh": BRICKS, "*": "floor"},
    "plot.before_after_3d": {"mesh": BRICKS, "points": PLACES},
    "plot.convergence": {"history": history},
    "plot.cut": SPACE | {"plane": jm.Plane([0.0, 0.0, 1.0], [0.0, 0.0, 0.3])},
    "plot.distances": {"wall": FACETS, "target": FACETS, "points": FACETS.points},
    "plot.graph": {"interior": False},
    "plot.histogram": {"reports": Lazy(lambda: {"a": report()})},
    "jm.Remeshed.transfer": {"values": np.zeros(N)},
    "jm.Remeshed.transfer_cells": {"values": np.zeros(sum(map(len, MESH.cells.values())))},
    "jm.Relay.points_at": {"u": U},
    **each("jm.wall_layers", {"patches": "wall"}),
    "plot.mesh": {"values": np.zeros(9)},
    "plot.picture": {"before": MESH},
    "plot.sources": {"surface": plan},
    "plot.surface": SPACE,
    "cases.bodies": {"boxes": {"a": [-1.0, 1.0, -1.0, 1.0]}},
    "cases.bricks": {"first_cell": 0.1},
    "cases.naca4": {"code": "2412"},
}
"""Good values by name: of every callable, of a module, of one callable. A default needs none."""

RATIO, LEAST = {"below": -0.1, "beyond": 1.5}, {"less": 0}
POSITIVE = {"negative": -1.0, "zero": 0.0, "infinite": np.inf}
EXTRA: dict[str, dict[str, Any]] = {
    **each("separation group min_jacobian_ratio slope decrease size_weight", RATIO),
    **each(
        "radius support_radius ell mu width outer max_step spacing first_cell gap pitch lift",
        POSITIVE,
    ),
    **each("softness sharpness span edge shapes.bend.length thickness", POSITIVE),
    **each("rate shapes.twist.length widths jm.Graded.share", POSITIVE),
    **each("tolerance smallest_box largest_box", {"negative": -1.0}),
    **each(
        "count most sources neighbours copies leaves fixed_leaves steps max_steps rows order points",
        LEAST,
    ),
    **each("stations layers columns mode frames dense chunk size points_per_leaf crowded", LEAST),
    **{
        "k": {"less": -1, "beyond": 99},
        "degree": {"less": -1, "beyond": 99},
        "d": {"less": 1, "beyond": 4},
    },
    **{"shapes.FreeForm.linked.mirror": {"less": -1, "beyond": 2}},
    **{
        "nose": {"beyond": 9},
        "tail": {"beyond": 9},
        "poisson": {"below": -1.0, "beyond": 0.5},
        "plan": {"mesh": MESH},
    },
    **{
        "dimensions": {"less": 1, "beyond": 4},
        "kind": {"other": "cube"},
        "mode": {"less": 0, "beyond": 9},
    },
    **{"place": {"below": 0.0, "beyond": 1.0}, "margin": {"negative": -1.0, "infinite": np.inf}},
    **{"camber": {"infinite": np.inf}, "depth": {"less": -1}},
    **each("mesh moved before", {"plan": plan, "empty": Lazy(lambda: jm.Mesh(np.zeros((0, 2))))}),
    **each("jm.prepare.mesh jm.Boundary.mesh", {"far": POINTS + 1e300}),
    **each(
        "ridge inner shapes.Smoother.length shapes.Smoother.on.length shapes.SobolevMetric.length",
        {"negative": -1.0, "infinite": np.inf},
    ),
    **each("jm.Multiscale.whole.fraction jm.Iterative.tolerance", POSITIVE | {"beyond": 1.5}),
    **each("name measure", {"unknown": "nonsense"}),
    "counts": {"half": (2.5, 3), "less": (1, 3)},
    "shapes.FreeForm.counts": {
        "half": (2.5, 3),
        "less": (1, 3),
        "longer": (3, 3, 3),
        "flags": (True, True),
    },
    "jm.Plane.normal": {"zero": np.zeros(2), "wide": np.ones(3)},
    "jm.Revolution.axis": {"zero": np.zeros(3), "short": np.ones(2)},
    "jm.Revolution.profile": {"back": [[1.0, 1.0], [0.0, 1.0]]},
    **each("jm.points jm.cotangent extreme", {"short": POINTS[:3]}),
    **each("u u_dot direction", {"short": U[:-1]}),
    **each("path motions", {"short": np.zeros((2, len(WALL) - 1, 2))}),
    "jm.shard.devices": {"empty": (), "list": [1]},
    "io.global_nodes.mesh": {"another": MESH},
    "io.write_gradient.gradient": {"other": {"b": 1.0}},
    "io.write_pvd.times": {"words": ["a"], "nan": [np.nan], "longer": [0.0, 1.0]},
    "shapes.Chord.tail": {"same": [0.0, 0.0]},
    "shapes.FreeForm.axes": {"flat": np.ones((2, 2))},
    "shapes.FreeForm.linked.groups": {"beyond": [[(0, 0), (9, 9)]]},
    "shapes.HicksHenne.centres": {"beyond": [1.5], "twice": [0.5, 0.5]},
    "shapes.ReferenceAxis.points": {"one": np.zeros((1, 3))},
    **each("shapes.bend.axis shapes.rotate.axis", {"plane": [0.0, 0.0, 1.0]}),
    "jm.replay.plans": {"empty": ()},
    "cases.bodies.box": {"short": [0.0, 1.0], "back": [4.0, -4.0, -4.0, 4.0]},
}
"""Values out of range, by the name of an argument, everywhere or of one callable."""

PATTERNS = (
    ("sequence", r"^(collections\.abc\.)?(Sequence|tuple)\b"),
    ("flag", r"^bool\b"),
    ("function", r"Callable"),
    ("path", r"PathLike"),
    ("mapping", r"Mapping|^dict"),
    ("ids", r"\bInt(eger)?\["),
    ("array", r"(Real|Float)\["),
    ("sequence", r"Sequence"),
    ("count", r"^int\b"),
    ("number", r"^float\b"),
    ("word", r"^str\b"),
)
"""Kinds of arguments by their annotations, the first that fits."""


def kind_of(parameter: inspect.Parameter, good: Any) -> str:
    """Names the kind of an argument by its annotation, and by its good value where that says more."""
    note = parameter.annotation
    text = "" if note in (inspect.Parameter.empty, Any) else inspect.formatannotation(note)
    kind = next((kind for kind, pattern in PATTERNS if re.search(pattern, text)), "instance")
    if kind == "array" and isinstance(good, jm.Plan):
        return "instance"
    if (
        kind in ("array", "instance")
        and isinstance(good, int | float)
        and not isinstance(good, bool)
    ):
        return "count" if isinstance(good, int) and kind == "instance" else "number"
    if kind == "instance" and (isinstance(good, np.ndarray) or (isinstance(good, tuple) and good)):
        return "array" if np.asarray(good).dtype.kind == "f" else "ids"
    return kind


ANY: dict[str, Any] = {
    "none": None,
    "word": "word",
    "number": 3,
    "list": [1, 2],
    "object": object(),
    "class": dict,
}
"""Nonsense for most kinds; `of_kind` leaves out what is sense."""


def of_kind(kind: str, good: Any) -> dict[str, Any]:
    """Makes the nonsense that every argument of a kind meets."""
    array = np.zeros(3)
    if kind == "number":
        return ANY | {"number": 1j, "nan": np.nan, "array": array}
    if kind == "count":
        return ANY | {
            "number": 2.5,
            "complex": 2j,
            "nan": np.nan,
            "flag": True,
            "array": np.ones(3, int),
        }
    if kind == "flag":
        return ANY | {"array": np.ones(3, bool)}
    if kind == "word":
        return ANY | {"word": "nonsense", "empty": ""}
    if kind == "path":
        path = good if isinstance(good, pathlib.Path) else FOLDER / "a.vtu"
        ways = {
            "mesh": MESH,
            "ending": FOLDER / "a.nonsense",
            "folder": FOLDER / "nowhere" / path.name,
        }
        return {key: value for key, value in (ANY | ways).items() if key != "word"}
    if kind == "array":
        good = np.asarray(good if good is not None else array, dtype=float)
        masked = np.ma.masked_array(good, mask=np.ones(good.shape, bool))
        forms = {
            "words": good.astype(str),
            "complex": good + 1j,
            "masked": masked,
            "axis": good[None],
            "number": 0.1,
        }
        forms |= {"objects": np.full(good.shape, None), "dates": np.zeros(good.shape, "M8[s]")}
        forms |= {"nan": np.full(good.shape, np.nan), "infinite": np.full(good.shape, np.inf)}
        forms |= {"ragged": [[1.0, 2.0], [3.0]], "list": [[1.0], "a"]}
        return ANY | forms | ({"wide": np.zeros((*good.shape[:-1], 5))} if good.ndim > 1 else {})
    if kind == "ids":
        axis = np.asarray(good)[None] if np.size(good) and good is not None else [[0]]
        ids = {
            "objects": np.full(3, None),
            "dates": np.zeros(3, "M8[s]"),
            "complex": np.ones(3) + 1j,
        }
        ids |= {"below": np.array([-1]), "beyond": np.array([N]), "huge": np.array([2**62])}
        ids |= {
            "floats": np.array([0.5, 1.5]),
            "list": [[0, 1], [1]],
            "axis": axis,
            "mask": np.ones(N, bool),
        }
        return ANY | ids
    if bases := [base for base in type(good).__mro__ if base.__name__.startswith("Abstract")]:
        return ANY | {"array": array, "base": bases[-1]}
    return (
        ANY
        | {"array": array}
        | {"mapping": {"contents": {"a": 3}}, "sequence": {"list": [3]}}.get(kind, {})
    )


def arguments(name: str) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yields the name, the good value and the nonsense of every argument of a callable."""
    scope = GOOD[""] | GOOD.get(name.split(".")[0], {}) | GOOD.get(name, {})
    for key, parameter in inspect.signature(callable_of(name)).parameters.items():
        if key in UNCHECKED or f"{name}.{key}" in UNCHECKED:
            continue
        many = parameter.kind is inspect.Parameter.VAR_POSITIONAL
        is_given, key = (
            parameter.default is inspect.Parameter.empty or key in GOOD.get(name, {}),
            "*" if many else key,
        )
        good = (
            scope[key]
            if is_given
            else parameter.default
            if parameter.default is not None
            else scope.get(key)
        )
        value = made(good)
        value = scope.get(key) if type(value).__name__ == "_HAS_DEFAULT_FACTORY_CLASS" else value
        kind = "word" if many and isinstance(value, str) else kind_of(parameter, value)
        places = kind, key, f"{name.split('.')[0]}.{key}", f"{name}.{key}"
        wrong = functools.reduce(
            lambda found, place: found | EXTRA.get(place, {}), places, of_kind(kind, value)
        )
        sense = " ".join(SENSE.get(place, "") for place in places).split()
        if parameter.default is None or "None" in str(parameter.annotation):
            sense.append("none")
        yield (
            key,
            good if is_given else None,
            {label: case for label, case in wrong.items() if label not in sense},
        )


UNCHECKED = words("""
jm.Mesh.source ax plotter label window exponents cache_directory done first classes is_open start
""")
UNCHECKED |= words(
    "jm.Periodic.about jm.Periodic.axis jm.Periodic.rotation jm.prepare_surface.faces"
)
"""Arguments of other packages, and those that mean something only beside others."""

SENSE = {
    "x": "nan infinite",
    **each("jm.curve.moving jm.curve.fixed jm.Layer.points", "beyond"),  # nodes of another mesh
    **each("jm.Graded.share jm.Greedy.motions", "beyond wide short"),
    **each("jm.march.path jm.replay.path jm.judge.points shapes.project.gradient", "nan infinite"),
    **each("jm.Limits.min_jacobian_ratio", "below beyond"),
    **{"jm.judge.part": "less"},
    **each(
        "jm.Steps.path_to.u jm.deform.u jm.pullback.u jm.velocity.u shapes.FreeForm.raise_if_torn.control",
        "nan infinite",
    ),
    **each(
        "jm.Relay.points_at.u jm.Remeshed.transfer.values jm.Remeshed.transfer_cells.values",
        "nan infinite",
    ),
    **each(
        "u_dot cotangent jm.distortion.points jm.inverted.points jm.quality.points", "nan infinite"
    ),
    **each("jm.face_quality.points jm.refit.points jm.smooth_quality.points", "nan infinite"),
    **each("jm.proof.points jm.proven_margin.points", "nan infinite"),
    **each("jm.wall_quality.points jm.soft_maximum.values plot.values", "nan infinite number axis"),
    **each("jm.save.path jm.export.path jm.soft_maximum.axis", "ending less list"),
    **each("jm.KDTree.with_sources.points jm.Plane.through.points jm.Turn.keeps.points", "short"),
    "jm.Mesh.points": "nan infinite short",
    **each("jm.Mesh.moved.points jm.Mesh.in_file_order.points", "nan infinite"),
    **each("jm.Periodic.patch jm.Periodic.partner", "word beyond huge below"),
    "jm.Slide.patch": "word beyond huge below list",
    "shapes.HicksHenne.widths": "list",
    **each("shapes.Linked.matrix shapes.Modes.fields", "wide"),
    "shapes.OnRows.rows": "beyond huge",
    "shapes.Part.mask": "mask",
    "shapes.Stations.on.direction": "axis",
    **each("shapes.chord.nose shapes.chord.tail", "list array less"),
    **each(
        "shapes.names.parameters io.write_gradient.parameters shapes.varied.parameters",
        "none number list array",
    ),
    "shapes.scale.factors": "number",
    **each("jm.QualityReport.worst.k jm.FaceQuality.worst.k jm.Proof.worst.k", "beyond"),
    **each(
        "io.periodic.mesh io.symmetry.mesh io.patch_roles.mesh io.read_displacement.mesh io.write.mesh",
        "empty",
    ),
    **each("io.as_written.mesh io.losses.mesh io.boxes.mesh io.with_boxes.mesh", "empty"),
    "continuity": "less",
    **each("shapes.History.path io.Decomposed.check_output.path", "ending"),
    "shapes.History.add.value": "none list nan array",
    **each(
        "shapes.History.add.constraints shapes.History.add.measures shapes.varied.changes",
        "contents",
    ),
    "io.Decomposed.writing.path": "ending folder",
    "io.check_output.mesh": "mesh folder empty",
    "io.read_displacement.moving": "axis",
    "io.write_pvd.times": "list",
    "shapes.Function.rest": "none word number list object class nan array",
    "io.write_sensitivity.ids": "below beyond huge",
}
"""Kinds that are sense for an argument: values that are read in traced code alone, names of patches, several numbers for one."""


def callable_of(name: str) -> Callable:
    """Returns the callable of a name; a method is that of its owner."""
    module, first, *rest = name.split(".")
    owner = f"{module}.{first}"
    found = OWNERS[owner]() if rest and owner in OWNERS else getattr(MODULES[module], first)
    return functools.reduce(getattr, rest, found)


def public() -> Iterator[str]:
    """Yields the names of all public callables: functions, classes that users build, and methods outside of `CONTRACT`."""
    for module, found in MODULES.items():
        for name in sorted(found.__all__ if hasattr(found, "__all__") else vars(found)):
            each = getattr(found, name)
            if (
                name.startswith(("_", "Abstract"))
                or not callable(each)
                or not each.__module__.startswith("jaxmorph")
            ):
                continue
            if f"{module}.{name}" not in BUILT:
                yield f"{module}.{name}"
            for member, value in vars(each).items() if inspect.isclass(each) else ():
                if isinstance(value, functools.cached_property):
                    continue
                is_routine = isinstance(value, staticmethod | classmethod) or inspect.isroutine(
                    value
                )
                if (
                    (is_routine or hasattr(value, "method"))
                    and not member.startswith("_")
                    and not {member, f"{name}.{member}"} & CONTRACT
                ):
                    yield f"{module}.{name}.{member}"


def made(value: Any) -> Any:
    """Calls what is to be made when it is needed."""
    return value() if isinstance(value, Lazy) else value
