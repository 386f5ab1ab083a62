"""Shapes of OpenCASCADE: faces, edges and vertices by number, evaluated, as facets, of files."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

try:
    from OCP.BinTools import BinTools
    from OCP.Bnd import Bnd_Box
    from OCP.BRep import BRep_Builder, BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
    from OCP.BRepBndLib import BRepBndLib
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing, BRepBuilderAPI_Transform
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Trsf, gp_Vec
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.IGESControl import IGESControl_Reader
    from OCP.IntTools import IntTools_FClass2d
    from OCP.Message import Message
    from OCP.STEPConstruct import STEPConstruct_UnitContext
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import (
        TopAbs_EDGE,
        TopAbs_FACE,
        TopAbs_FORWARD,
        TopAbs_OUT,
        TopAbs_REVERSED,
        TopAbs_VERTEX,
    )
    from OCP.TopExp import TopExp, TopExp_Explorer
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS, TopoDS_Shape
except ImportError as error:
    raise ImportError("CAD models need OpenCASCADE: pip install 'jaxmorph[cad]'") from error

try:
    from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher as ShapeMap
except ImportError:  # before version 8
    from OCP.TopTools import TopTools_IndexedMapOfShape as ShapeMap

import functools
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from ..package.arguments import shown
from ..tolerances import SAME

DEFLECTION = 1e-3
TURN = 0.2
"""Of facets: distance off the model over its size, and radians."""

POLE = 1e-6  # length of a derivative, over the largest at a facet, that is none
SEWN = 1e-6  # gap of faces of an IGES file that are one surface


class CadTopology(NamedTuple):
    """How a model hangs together, in the order in which its parts are listed.

    `surfaces` are types of faces; `edges` of each face are numbers; `ends` of each edge vertices.
    """

    surfaces: tuple[str, ...]
    edges: tuple[tuple[int, ...], ...]
    ends: tuple[tuple[int, ...], ...]
    vertices: int

    def change(self, other: "CadTopology") -> str | None:
        """Says what another model has in place of this one; None if they are alike."""
        counts = {
            "faces": (len(self.surfaces), len(other.surfaces)),
            "edges": (len(self.ends), len(other.ends)),
            "vertices": (self.vertices, other.vertices),
        }
        told = [f"{new} {name}, not {old}" for name, (old, new) in counts.items() if old != new]
        if told:
            return "the model has " + " and ".join(told)
        for form, old, new in (
            ("face {} is a {}, not a {}", self.surfaces, other.surfaces),
            ("face {} has edges {}, not {}", self.edges, other.edges),
            ("edge {} joins vertices {}, not {}", self.ends, other.ends),
        ):
            for number, pair in enumerate(zip(new, old, strict=True)):
                if pair[0] != pair[1]:
                    return form.format(number, *pair)
        return None


class Use(NamedTuple):
    """An edge of a face, and its curve in the face's parameters. A face uses a seam twice."""

    face: int
    edge: int
    curve: Any
    first: float
    last: float

    def at(self, share: float) -> tuple[float, float]:
        """The face's parameters at a share of the edge."""
        return self.curve.Value(self.first + share * (self.last - self.first)).Coord()


class Tessellation(NamedTuple):
    """Facets of a model: `triangles` (t, 3) of `points` (n, 3), their `face` (t,), and parameters
    `at` (t, 3, 2) on it; `segments` (s, 2, 3), their `edge` (s,), and parameters `along` (s, 2).
    """

    points: ndarray
    triangles: ndarray
    face: ndarray
    at: ndarray
    segments: ndarray
    along: ndarray
    edge: ndarray


class CadShape:
    """A shape of OpenCASCADE, or an object of CadQuery or build123d that wraps one."""

    def __init__(self, shape: Any):
        shape = shape.val() if hasattr(shape, "val") else shape  # a workplane of CadQuery
        self.shape = getattr(shape, "wrapped", shape)
        if not isinstance(self.shape, TopoDS_Shape) or self.shape.IsNull():
            raise ValueError(
                f"a shape of OpenCASCADE, CadQuery or build123d is expected, found {shown(shape)}."
            )
        _, faces = _numbered_shapes(self.shape, TopAbs_FACE, "Face")
        numbers, self._edges = _numbered_shapes(self.shape, TopAbs_EDGE, "Edge")
        vertex_numbers, vertices = _numbered_shapes(self.shape, TopAbs_VERTEX, "Vertex")
        if not faces:
            raise ValueError("the shape has no faces.")
        self.is_reversed = [face.Orientation() == TopAbs_REVERSED for face in faces]
        self._faces = [_typed_shape("Face", face.Oriented(TopAbs_FORWARD)) for face in faces]
        self.surfaces = [BRepAdaptor_Surface(face) for face in self._faces]
        self.bounds = np.array([BRepTools.UVBounds_s(face) for face in self._faces])
        self.is_point = [BRep_Tool.Degenerated_s(edge) for edge in self._edges]
        self.curves = [
            None if is_point else BRepAdaptor_Curve(edge)
            for edge, is_point in zip(self._edges, self.is_point, strict=True)
        ]
        self.ranges = np.array([BRep_Tool.Range_s(edge) for edge in self._edges]).reshape(-1, 2)
        self.vertices = np.reshape([BRep_Tool.Pnt_s(point).Coord() for point in vertices], (-1, 3))
        self.uses = _uses(self._faces, numbers)
        self.uses_of: list[list[Use]] = [[] for _ in self._edges]
        edges: list[list[int]] = [[] for _ in self._faces]
        for use in self.uses:
            self.uses_of[use.edge].append(use)
            edges[use.face].append(use.edge)
        ends = [[TopExp.FirstVertex_s(edge), TopExp.LastVertex_s(edge)] for edge in self._edges]
        self.topology = CadTopology(
            surfaces=tuple(
                surface.GetType().name.removeprefix("GeomAbs_") for surface in self.surfaces
            ),
            edges=tuple(map(tuple, edges)),
            ends=tuple(
                tuple(vertex_numbers.FindIndex(vertex) - 1 for vertex in pair) for pair in ends
            ),
            vertices=len(vertices),
        )

    @classmethod
    def read(cls, path: Path) -> Any:
        """Reads a STEP, IGES or BREP file; its numbers stay, in the unit in which they stand."""
        messenger = Message.DefaultMessenger_s()
        printers = [*messenger.Printers()]
        messenger.ChangePrinters().Clear()  # of what is read, on the standard output
        try:
            shape = CAD_READERS[path.suffix.lower()](str(path))
        finally:
            for printer in printers:
                messenger.AddPrinter(printer)
        if shape is None or shape.IsNull():
            raise ValueError("not a CAD model, or a damaged one.")
        return cls(shape)

    def __reduce__(self) -> tuple[Any, ...]:
        data = io.BytesIO()
        BinTools.Write_s(self.shape, data)  # in OpenCASCADE's own format, which keeps the order
        return _unpickled, (type(self), data.getvalue())

    def scaled(self, factor: float) -> Any:
        """Makes the shape with coordinates times a factor."""
        change = gp_Trsf()
        change.SetScale(gp_Pnt(0, 0, 0), factor)
        return type(self)(BRepBuilderAPI_Transform(self.shape, change, True).Shape())

    @functools.cached_property
    def facets(self) -> Tessellation:
        box = Bnd_Box()
        BRepBndLib.Add_s(self.shape, box, False)
        size = np.sqrt(box.SquareExtent())
        BRepTools.Clean_s(self.shape)
        BRepMesh_IncrementalMesh(self.shape, DEFLECTION * size, False, TURN, False)
        return _tessellation_of(self, self._faces, self._edges)

    @functools.cached_property
    def size(self) -> float:
        return float(np.ptp(self.facets.points, axis=0).max())

    def on_faces(self, face: ndarray, at: ndarray, order: int = 0) -> ndarray:
        """Evaluates surfaces (m, 1, 3), with order 1 or 2 derivatives too: u, v, uu, vv, uv."""
        place = gp_Pnt()
        slopes = [gp_Vec() for _ in range((0, 2, 5)[order])]
        calls = [getattr(surface, f"D{order}") for surface in self.surfaces]
        values = []
        for number, (u, v) in zip(face.tolist(), at.tolist(), strict=True):
            calls[number](u, v, place, *slopes)
            values.append([place.Coord(), *(slope.Coord() for slope in slopes)])
        return np.array(values).reshape(-1, 1 + len(slopes), 3)

    def on_edges(self, edge: ndarray, along: ndarray, order: int = 0) -> ndarray:
        """Evaluates curves (m, 1 + order, 3), with their derivatives up to an order."""
        place = gp_Pnt()
        slopes = [gp_Vec() for _ in range(order)]
        values = []
        for number, t in zip(edge.tolist(), along.tolist(), strict=True):
            getattr(self.curves[number], f"D{order}")(t, place, *slopes)
            values.append([place.Coord(), *(slope.Coord() for slope in slopes)])
        return np.array(values).reshape(-1, 1 + order, 3)

    def is_inside(self, face: ndarray, at: ndarray) -> ndarray:
        """Marks parameters within the trimmed face."""
        inside = [
            self._classifiers(number).Perform(gp_Pnt2d(u, v), False) != TopAbs_OUT
            for number, (u, v) in zip(face.tolist(), at.tolist(), strict=True)
        ]
        return np.array(inside, bool)

    @functools.cached_property
    def _classifiers(self) -> Any:
        return functools.cache(lambda number: IntTools_FClass2d(self._faces[number], SAME))


def _unpickled(kind: type[CadShape], data: bytes) -> CadShape:
    shape = TopoDS_Shape()
    BinTools.Read_s(shape, io.BytesIO(data))
    return kind(shape)


def _typed_shape(kind: str, shape: Any) -> Any:
    return (getattr(TopoDS, f"{kind}_s", None) or getattr(TopoDS, kind))(shape)


def _numbered_shapes(shape: Any, kind: Any, name: str) -> tuple[Any, list[Any]]:
    numbers = ShapeMap()
    TopExp.MapShapes_s(shape, kind, numbers)
    return numbers, [_typed_shape(name, numbers.FindKey(k + 1)) for k in range(numbers.Extent())]


def _uses(faces: list[Any], numbers: Any) -> list[Use]:
    found = []
    for number, face in enumerate(faces):
        explorer = TopExp_Explorer(face, TopAbs_EDGE)
        while explorer.More():
            edge = _typed_shape("Edge", explorer.Current())
            curve = BRepAdaptor_Curve2d(edge, face)
            ends = curve.FirstParameter(), curve.LastParameter()
            found.append(Use(number, numbers.FindIndex(edge) - 1, curve, *ends))
            explorer.Next()
    return found


def _tessellation_of(model: CadShape, faces: list[Any], edges: list[Any]) -> Tessellation:
    points: list[Any] = []
    at: list[Any] = []
    lines: dict[int, tuple[list[Any], list[float]]] = {}
    triangles = []
    owners = []
    for number, face in enumerate(faces):
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, location)
        if mesh is None:
            continue
        place = location.Transformation()
        nodes = range(1, mesh.NbNodes() + 1)
        own = [mesh.Node(k).Transformed(place).Coord() for k in nodes]
        ids = np.array([mesh.Triangle(k + 1).Get() for k in range(mesh.NbTriangles())]) - 1
        triangles.append(ids[:, :: -1 if model.is_reversed[number] else 1] + len(points))
        owners += [number] * len(ids)
        points += own
        at += [mesh.UVNode(k).Coord() for k in nodes]
        for edge in model.topology.edges[number]:
            line = BRep_Tool.PolygonOnTriangulation_s(edges[edge], mesh, location)
            if line is not None and not model.is_point[edge]:
                lines[edge] = _places_on_line(line, own)
    if not triangles:
        raise ValueError("OpenCASCADE finds no facets on this model: are its faces damaged?")
    segments, along = (
        [np.stack([column[:-1], column[1:]], axis=1) for column in map(np.array, columns)]
        for columns in (zip(*lines.values(), strict=True) if lines else ((), ()))
    )
    corners = np.concatenate(triangles)
    face = np.array(owners)
    return Tessellation(
        points=np.array(points),
        triangles=corners,
        face=face,
        at=_turned_at_poles(model, face, np.array(at)[corners]),
        segments=np.concatenate([np.zeros((0, 2, 3)), *segments]),
        along=np.concatenate([np.zeros((0, 2)), *along]),
        edge=np.repeat([*lines], [len(part) for part in along]).astype(int),
    )


def _places_on_line(line: Any, points: list[Any]) -> tuple[list[Any], list[float]]:
    """Lists the points of an edge, of those of a face, and the parameter of each."""
    count = range(1, line.NbNodes() + 1)
    return [points[line.Node(k) - 1] for k in count], [line.Parameter(k) for k in count]


def _turned_at_poles(model: CadShape, face: ndarray, at: ndarray) -> ndarray:
    """Gives a corner at a pole the direction of the two others of its triangle."""
    slopes = model.on_faces(np.repeat(face, 3), at.reshape(-1, 2), 1)[:, 1:]
    length = np.linalg.norm(slopes, axis=2).reshape(at.shape)
    is_pole = length < POLE * length.max(axis=1, keepdims=True)
    others = (at[:, [1, 2, 0]] + at[:, [2, 0, 1]]) / 2
    return np.where(is_pole, others, at)


def _read_step(path: str) -> Any:
    reader = STEPControl_Reader()
    if reader.ReadFile(path) != IFSelect_RetDone:
        return None
    model = reader.StepModel()
    # OpenCASCADE would turn all into millimetres
    for number in range(model.NbEntities()):
        entity = model.Entity(number + 1)
        if hasattr(entity, "GlobalUnitAssignedContext"):
            unit = STEPConstruct_UnitContext()
            unit.ComputeFactors(entity.GlobalUnitAssignedContext())
            reader.SetSystemLengthUnit(unit.LengthFactor())
            break
    reader.TransferRoots()
    return reader.OneShape()


def _read_iges(path: str) -> Any:
    reader = IGESControl_Reader()
    if reader.ReadFile(path) != IFSelect_RetDone:
        return None
    section = reader.IGESModel().ChangeGlobalSection()
    section.SetCascadeUnit(section.UnitValue())
    reader.TransferRoots()
    # its faces are apart
    sewing = BRepBuilderAPI_Sewing(SEWN)
    sewing.Add(reader.OneShape())
    sewing.Perform()
    return sewing.SewedShape()


def _read_brep(path: str) -> Any:
    shape = TopoDS_Shape()
    return shape if BRepTools.Read_s(shape, path, BRep_Builder()) else None


CAD_READERS = {
    **dict.fromkeys((".step", ".stp"), _read_step),
    **dict.fromkeys((".iges", ".igs"), _read_iges),
    **dict.fromkeys((".brep", ".brp"), _read_brep),
}
