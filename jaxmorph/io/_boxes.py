"""Boxes of free-form deformation in files: TOML, SU2's meshes, and lattices for ParaView."""

import dataclasses
import os
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked, finite_array
from jaxmorph._host.package.files import complete, input_path, output_path
from jaxmorph._host.package.text import LATTICES, read
from jaxmorph._mesh import vtk
from jaxmorph._mesh.exchange import gathered

from ._format import Source, faults_of, source_of
from ._su2 import NAME, Keyword, by_zones
from ._text import Section, decoded, parse
from ._vtk import Encoding, text_of

Points = Float[np.ndarray, "..."]
Surface = Mapping[str, tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k d"]]]

NEEDED, OPTIONAL = {"points", "moved"}, {"degree", "continuity"}
"""Keys of a box's table, beside those of its place."""
MOST = 10**6
"""Control points that a box may have."""
HALF = 0.5
"""SU2's boxes of a 2-D mesh are 1 thick: control points at -1/2 and 1/2, nodes between."""


@checked
def read_box(
    source: str | os.PathLike[str] | Mapping[str, Any], dimensions: int
) -> "tuple[jm.shapes.FreeForm | jm.shapes.Hexahedron, Float[np.ndarray, '*counts d']]":
    """Reads a box of control points, and the displacements of its control points.

    The table has `low` and `high` (two corners of a box along the axes), or `corners` (eight, in
    2-D four, as `Hexahedron` takes them). It has `points` (numbers of control points), and a list
    `moved` of tables of `at` (a control point's numbers, from 0) and `by` (its displacement).
    `degree` and `continuity` are as in `FreeForm`.

    **Arguments:**

    - `source`: a TOML file, or its table.
    - `dimensions`: of the mesh, 2 or 3.

    **Returns:** the box, and displacements (*counts, d).

    **Raises:** `ValueError` for a bad table, other dimensions, and a displacement of a control
    point that is held.
    """
    is_table = isinstance(source, Mapping)
    where = "--box" if is_table else str(source)
    table = dict(source) if is_table else read(where, input_path(source).read_bytes())
    with faults_of(pathlib.Path(where)):
        box = _box_of(table, dimensions)
        control = np.zeros((*box.counts, dimensions))
        for entry in table["moved"]:
            if not isinstance(entry, dict) or set(entry) != {"at", "by"}:
                raise ValueError(f"each of moved has at and by, found {entry}.")
            at = _numbers("at", entry["at"], dimensions)
            if (at < 0).any() or (at >= box.counts).any() or (at != np.floor(at)).any():
                most = np.array(box.counts) - 1
                raise ValueError(f"at = {entry['at']} is none of the control points 0 to {most}.")
            place = tuple(at.astype(int))
            if not box.free[place]:
                raise ValueError(f"control point {entry['at']} is held by continuity = {box.continuity}.")
            control[place] += _numbers("by", entry["by"], dimensions)
    return box, control


def _box_of(table: dict[str, Any], d: int) -> "jm.shapes.FreeForm | jm.shapes.Hexahedron":
    needed = NEEDED | ({"corners"} if "corners" in table else {"low", "high"})
    if not needed <= set(table) <= needed | OPTIONAL or not isinstance(table["moved"], list):
        listed = ", ".join(table) or "nothing"
        raise ValueError(f"low and high or corners, points and a list moved expected, found {listed}.")
    counts, options = _counts(table["points"], d), {name: table[name] for name in OPTIONAL & set(table)}
    if any(type(value) is not int for value in options.values()):
        raise ValueError(f"degree and continuity are whole numbers, found {options}.")
    if "corners" in table:
        rows = table["corners"] if isinstance(table["corners"], list) else [table["corners"]]
        return jm.shapes.Hexahedron(np.array([_numbers("corners", row, d) for row in rows]), counts, **options)
    low, high = (_numbers(name, table[name], d) for name in ("low", "high"))
    if not (low < high).all():
        raise ValueError("low must be below high.")
    return jm.shapes.FreeForm(low, np.diag(high - low), counts, **options)


def _counts(given: Any, d: int) -> list[int]:
    counts = _numbers("points", given, d)
    if not (counts >= 2).all() or (counts != np.floor(counts)).any():
        raise ValueError("points must be 2 or more whole numbers of control points.")
    if counts.prod() > MOST:
        raise ValueError(f"points = {given} are {counts.prod():.3g} control points; {MOST} at most.")
    return counts.astype(int).tolist()


def _numbers(name: str, values: Any, d: int) -> Float[np.ndarray, " d"]:
    good = isinstance(values, list) and len(values) == d and all(type(value) in (int, float) for value in values)
    if not good or not np.isfinite(values).all():
        raise ValueError(f"{name} needs {d} numbers for a mesh in {d}-D, found {values}.")
    return np.array(values, float)


@checked
def write_lattice(file: str | os.PathLike[str], points: Any) -> None:
    """Writes a lattice of control points as a structured grid in VTK's XML, which ParaView opens.

    **Arguments:**

    - `file`: its name ends in `.vts`.
    - `points`: (i, j, 2) or (i, j, k, 3), as `FreeForm.lattice` gives them, or moved.

    **Raises:** `ValueError` for another shape or another ending, `ImportError` without vtk.
    """
    path, points = check_lattice_output(file), finite_array("points", points, (None, None, 2), (None, None, None, 3))
    d = points.shape[-1]
    full = np.zeros((*points.shape[:-1], *(1,) * (3 - d), 3))
    full[..., :d] = points.reshape(*full.shape[:-1], d)
    grid = vtk.vtk("vtkCommonDataModel").vtkStructuredGrid()
    grid.SetDimensions(full.shape[:-1])
    grid.SetPoints(vtk.points_of(full.reshape(-1, 3, order="F")))
    with complete(path) as partial:
        partial.write_bytes(text_of(grid, Encoding(mode="appended")))


@checked
def check_lattice_output(file: str | os.PathLike[str]) -> pathlib.Path:
    """Raises `ValueError` or `ImportError` where `write_lattice` cannot write; returns the path."""
    path = output_path(file, *LATTICES)
    vtk.vtk("vtkIOXML")
    return path


@dataclasses.dataclass(frozen=True, eq=False)
class Box:
    """A free-form box of an SU2 file.

    - `name`: its tag.
    - `shape`: corners, numbers of control points and degrees; in the dimension of the mesh.
    - `control`: positions (*counts, d) of the control points, at first those of `shape.lattice()`.
    - `surface`: by marker, ids (k,) of its nodes in the box and their coordinates (k, d) there,
      which a deformation leaves.
    - `level`, `parents`, `children`: of nested boxes; 0 and none for others.
    """

    name: str
    shape: "jm.shapes.Hexahedron"
    control: Points
    surface: Surface = dataclasses.field(default_factory=dict)
    level: int = 0
    parents: tuple[str, ...] = ()
    children: tuple[str, ...] = ()


@checked
def boxes(mesh: Mesh) -> tuple[Box, ...]:
    """Reads the free-form boxes in the SU2 file that a mesh came from.

    **Arguments:**

    - `mesh`: what `read` returned, moved or not.

    **Returns:** its boxes; none for other formats, and for files without boxes.

    **Raises:** `ValueError`, with file and line, for a section that is cut short.
    """
    source = source_of(mesh, NAME)
    if source is None or b"FFD_NBOX" not in source.content.text:
        return ()
    keywords = _keywords(source)
    starts = [k for k, keyword in enumerate(keywords) if keyword.name == "FFD_TAG"]
    ends = [*starts[1:], len(keywords)]
    if not any(keyword.name == "FFD_NBOX" for keyword in keywords):
        return ()
    return tuple(_box(keywords[a:b], *mesh.points.shape) for a, b in zip(starts, ends, strict=True))


@checked
def with_boxes(mesh: Mesh, new: Sequence[Box]) -> Mesh:
    """Makes a mesh whose file, once written, has these free-form boxes and no others.

        boxes = [dataclasses.replace(box, control=box.control + change) for box in io.boxes(mesh)]
        io.write("moved.su2", io.with_boxes(mesh.moved(points), boxes))

    **Arguments:**

    - `mesh`: a mesh that was read from an SU2 file.
    - `new`: its boxes, none to remove all.

    **Raises:** `ValueError` for a mesh from elsewhere, duplicate names of boxes, and other control
    points.
    """
    source = source_of(mesh, NAME)
    if source is None:
        raise ValueError("the mesh was not read from an SU2 file: other formats hold no free-form boxes.")
    _check_new(new, mesh.points.shape[1])
    content, (start, stop) = source.content, _extent(source)
    end = b"\r\n" if b"\r\n" in content.text[:1000] else b"\n"
    written = b"".join(line.encode() + end for line in _lines(new)) if new else b""
    before = content.text[:start]
    if written and before and not before.endswith(b"\n"):
        before += end
    shift = len(before) + len(written) - stop if start < content.start else 0
    text = before + written + content.text[stop:]
    changed = dataclasses.replace(content, text=text, start=content.start + shift, stop=content.stop + shift)
    return Mesh(mesh.points, mesh.cells, mesh.patches, dataclasses.replace(source, content=changed))


def _check_new(new: Sequence[Box], d: int) -> None:
    for box in new:
        expected = (*box.shape.counts, d)
        if np.shape(box.control) != expected:
            raise ValueError(f"box {box.name}: `control` has shape {np.shape(box.control)}; expected {expected}.")
    again = len(new) - len({box.name for box in new})
    if again:
        raise ValueError(f"{again} of {len(new)} boxes have the name of another one.")


def _keywords(source: Source) -> Sequence[Keyword]:
    content = source.content
    zones = by_zones(source.path, content.text)
    return next(
        zone for zone in zones if any(word.name == "NPOIN" and word.section.start == content.start for word in zone)
    )


def _extent(source: Source) -> tuple[int, int]:
    keywords = _keywords(source)
    section = [keyword for keyword in keywords if keyword.name.startswith(("FFD_", "BSPLINE_ORDER_"))]
    if not section:
        end = keywords[-1].section.stop
        return end, end
    first = section[0].section.start
    return source.content.text.rfind(b"\n", 0, first - 1) + 1, section[-1].section.stop


def _box(keywords: Sequence[Keyword], n: int, d: int) -> Box:
    table = {keyword.name: keyword for keyword in keywords}
    name, at = table["FFD_TAG"].value.replace(" ", ""), table["FFD_TAG"].section

    def number(word: str, default: int | None = None) -> int:
        if word in table:
            return table[word].number()
        if default is None:
            raise at.error(f"box {name} has no {word}=; SU2 writes it by DV_KIND= FFD_SETTING.")
        return default

    degrees = np.array([number(f"FFD_DEGREE_{axis}") for axis in "IJK"[:d]])
    orders = np.array([number(f"BSPLINE_ORDER_{axis}", 0) for axis in "IJK"[:d]])
    is_spline = ((orders > 1) & (orders <= degrees + 1)).all()
    corners = _rows(table, "FFD_CORNER_POINTS", at, d)
    if len(corners) != 2**d:
        raise at.error(f"box {name} has {len(corners)} corners; {2**d} expected in {d}-D.")
    try:
        shape = jm.shapes.Hexahedron(
            corners, (degrees + 1).tolist(), degree=(orders - 1).tolist() if is_spline else None
        )
    except ValueError as error:
        raise at.error(f"box {name}: {error}") from error
    control = _control(_rows(table, "FFD_CONTROL_POINTS", at, 6), shape, at)
    surface = _surface(table.get("FFD_SURFACE_POINTS"), n, d)
    relatives = (_names(table.get(word)) for word in ("FFD_PARENTS", "FFD_CHILDREN"))
    return Box(name, shape, control, surface, number("FFD_LEVEL", 0), *relatives)


def _names(keyword: Keyword | None) -> tuple[str, ...]:
    return () if keyword is None else tuple(decoded(line.strip()) for line in _content(keyword) if line.strip())


def _content(keyword: Keyword) -> list[bytes]:
    return keyword.section.text[keyword.section.start : keyword.section.stop].split(b"\n")


def _rows(table: Mapping[str, Keyword], name: str, at: Section, width: int) -> Float[np.ndarray, "k w"]:
    if name not in table:
        raise at.error(f"a box has no {name}=.")
    keyword = table[name]
    rows = keyword.section.rows(np.float64)
    if (rows.counts != width).any() or len(rows.counts) != keyword.number():
        raise keyword.section.error(f"{name}= {keyword.value}: as many rows of {width} numbers expected.")
    return rows.values.reshape(-1, width)


def _control(rows: Float[np.ndarray, "k 6"], shape: "jm.shapes.Hexahedron", at: Section) -> Points:
    """Sorts control points by their numbers; in 2-D, two above each other become their mean."""
    d = len(shape.counts)
    counts = (*shape.counts, *(2,) * (3 - d))
    if not len(rows):
        return np.asarray(shape.lattice())
    ids = rows[:, :3].astype(int)
    if not np.array_equal(np.unique(ids, axis=0), list(np.ndindex(counts))) or len(ids) != np.prod(counts):
        raise at.error(f"{len(rows)} control points do not make a lattice of {' x '.join(map(str, counts))}.")
    control = np.empty((*counts, 3))
    control[tuple(ids.T)] = rows[:, 3:]
    return control if d == 3 else control.mean(axis=2)[..., :2]


def _surface(keyword: Keyword | None, n: int, d: int) -> Surface:
    if keyword is None:
        return {}
    lines = [words for words in map(bytes.split, _content(keyword)) if words]
    if len(lines) != keyword.number():
        raise keyword.section.error(f"FFD_SURFACE_POINTS= {keyword.value}, but {len(lines)} rows follow.")
    rows = [parse(b" ".join(words[1:]), np.float64) for words in lines]
    for row, values in enumerate(rows):
        if len(values) != len(lines[row]) - 1 or len(values) != 4 or not 0 <= values[0] < n or values[0] % 1:
            raise keyword.section.error("a marker, a node and three coordinates in the box expected.", row)
    tables = gathered((decoded(words[0]), values[None]) for words, values in zip(lines, rows, strict=True))
    return {marker: (table[:, 0].astype(np.int64), table[:, 1 : 1 + d]) for marker, table in tables.items()}


def _lines(new: Sequence[Box]) -> Iterator[str]:
    yield f"FFD_NBOX= {len(new)}"
    yield f"FFD_NLEVEL= {1 + max(box.level for box in new)}"
    for box in new:
        counts, degrees = box.shape.counts, box.shape.box.degrees
        is_bezier = list(degrees) == [count - 1 for count in counts]
        yield from (f"FFD_TAG= {box.name}", f"FFD_LEVEL= {box.level}")
        yield from (f"FFD_DEGREE_{axis}= {count - 1}" for axis, count in zip("IJK", counts, strict=False))
        yield f"FFD_BLENDING= {'BEZIER' if is_bezier else 'BSPLINE_UNIFORM'}"
        orders = () if is_bezier else degrees
        yield from (f"BSPLINE_ORDER_{axis}= {p + 1}" for axis, p in zip("IJK", orders, strict=False))
        yield from (f"FFD_PARENTS= {len(box.parents)}", *box.parents)
        yield from (f"FFD_CHILDREN= {len(box.children)}", *box.children)
        yield from _points(box)


def _points(box: Box) -> Iterator[str]:
    """Yields corners, control points, in 2-D below and above the plane, and nodes in the box."""
    corners, control, d = box.shape.given_corners.tolist(), np.asarray(box.control, float), len(box.shape.counts)
    yield from (f"FFD_CORNER_POINTS= {len(corners)}", *("\t".join(map(repr, row)) for row in corners))
    if d == 2:
        control = np.stack([np.insert(control, 2, height, axis=-1) for height in (-HALF, HALF)], axis=2)
    places = np.ndindex(control.shape[:-1])
    yield f"FFD_CONTROL_POINTS= {control[..., 0].size}"
    yield from ("\t".join([*map(str, place), *map(repr, control[place].tolist())]) for place in places)
    yield f"FFD_SURFACE_POINTS= {sum(len(nodes) for nodes, _ in box.surface.values())}"
    for marker, (nodes, inside) in box.surface.items():
        for node, x in zip(nodes.tolist(), inside.tolist(), strict=True):
            yield "\t".join([marker, str(node), *map(repr, [*x, *[HALF] * (3 - d)])])
