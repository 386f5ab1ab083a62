"""Boxes of free-form deformation in files: TOML, SU2's meshes, and lattices for ParaView."""

import dataclasses
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked, finite_array
from jaxmorph._host.package.files import PathLike, complete, input_path, output_path
from jaxmorph._host.package.text import LATTICES, parse_toml
from jaxmorph._mesh import vtk
from jaxmorph._mesh.exchange import gathered

from ._format import Source, faults_of, source_of
from ._su2 import NAME, Keyword, find_all, split_zones
from ._text import Section, decoded
from ._vtk import Encoding, file_bytes

ControlPoints = Float[ndarray, "..."]
Surface = Mapping[str, tuple[Int[ndarray, " k"], Float[ndarray, "k d"]]]

NEEDED = {"points", "moved"}
OPTIONAL = {"degree", "continuity"}
"""Keys of a box's table, beside those of its place."""
SPLINE_ORDERS = ("BSPLINE_ORDER_I", "BSPLINE_ORDER_J", "BSPLINE_ORDER_K")
RELATIVES = ("FFD_PARENTS", "FFD_CHILDREN")
MOST_CONTROL_POINTS = 10**6
"""Control points that a box may have."""
HALF_THICKNESS = 0.5
"""SU2's boxes of a 2-D mesh are 1 thick: control points at -1/2 and 1/2, nodes between."""


@checked
def read_box(
    source: PathLike | Mapping[str, Any], dimensions: int
) -> "tuple[jm.shapes.FreeForm | jm.shapes.Hexahedron, Float[ndarray, '*counts d']]":
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
    where = "--box" if isinstance(source, Mapping) else str(source)
    table = (
        dict(source)
        if isinstance(source, Mapping)
        else parse_toml(where, input_path(source).read_bytes())
    )
    with faults_of(Path(where)):
        box = _make_box(table, dimensions)
        control = np.zeros((*box.counts, dimensions))
        for entry in table["moved"] if isinstance(table["moved"], list) else [table["moved"]]:
            if not isinstance(entry, dict) or set(entry) != {"at", "by"}:
                raise ValueError(f"each of moved has at and by, found {entry}.")
            place = tuple(_read_whole("at", entry["at"], 0, np.array(box.counts) - 1))
            if not box.free[place]:
                raise ValueError(
                    f"control point {entry['at']} is held by continuity = {box.continuity}."
                )
            control[place] += _read_numbers("by", entry["by"], dimensions)
    return box, control


def _make_box(table: dict[str, Any], d: int) -> "jm.shapes.FreeForm | jm.shapes.Hexahedron":
    needed = NEEDED | ({"corners"} if "corners" in table else {"low", "high"})
    if not needed <= set(table) <= needed | OPTIONAL:
        listed = ", ".join(table) or "nothing"
        raise ValueError(
            f"low and high or corners, points and a list moved expected, found {listed}."
        )
    counts = _read_whole("points", table["points"], 2, np.full(d, MOST_CONTROL_POINTS))
    if math.prod(counts) > MOST_CONTROL_POINTS:
        raise ValueError(
            f"points = {counts} are {math.prod(counts):.3g} control points; {MOST_CONTROL_POINTS} "
            "at most."
        )
    more = {name: table[name] for name in OPTIONAL & table.keys()}
    if "corners" in table:
        rows = table["corners"] if isinstance(table["corners"], list) else [table["corners"]]
        return jm.shapes.Hexahedron(
            np.array([_read_numbers("corners", row, d) for row in rows]), counts, **more
        )
    low = _read_numbers("low", table["low"], d)
    high = _read_numbers("high", table["high"], d)
    if not (low < high).all():
        raise ValueError("low must be below high.")
    return jm.shapes.FreeForm(low, np.diag(high - low), counts, **more)


def _read_whole(name: str, values: Any, least: int, most: Int[ndarray, " d"]) -> list[int]:
    numbers = _read_numbers(name, values, len(most))
    if (numbers != np.clip(np.floor(numbers), least, most)).any():
        raise ValueError(
            f"{name} = {values}: whole numbers from {least} to {most.tolist()} expected."
        )
    return numbers.astype(int).tolist()


def _read_numbers(name: str, values: Any, d: int) -> Float[ndarray, " d"]:
    good = (
        isinstance(values, list)
        and len(values) == d
        and all(type(value) in (int, float) for value in values)
    )
    if not good or not np.isfinite(values).all():
        raise ValueError(f"{name} needs {d} numbers for a mesh in {d}-D, found {values}.")
    return np.array(values, float)


@checked
def write_lattice(file: PathLike, points: Any) -> None:
    """Writes a lattice of control points as a structured grid in VTK's XML, which ParaView opens.

    **Arguments:**

    - `file`: its name ends in `.vts`.
    - `points`: (i, j, 2) or (i, j, k, 3), as `FreeForm.lattice` gives them, or moved.

    **Raises:** `ValueError` for another shape or another ending, `ImportError` without vtk.
    """
    path = output_path(file, *LATTICES)
    points = finite_array("points", points, (None, None, 2), (None, None, None, 3))
    d = points.shape[-1]
    full = np.zeros((*points.shape[:-1], *(1,) * (3 - d), 3))
    full[..., :d] = points.reshape(*full.shape[:-1], d)
    grid = vtk.vtk("vtkCommonDataModel").vtkStructuredGrid()
    grid.SetDimensions(full.shape[:-1])
    grid.SetPoints(vtk.points_of(full.reshape(-1, 3, order="F")))
    with complete(path) as partial:
        partial.write_bytes(file_bytes(grid, Encoding(mode="appended")))


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
    control: ControlPoints
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
    keywords = (
        [] if source is None or b"FFD_NBOX" not in source.content.raw else _find_keywords(source)
    )
    if not find_all(keywords, "FFD_NBOX"):
        return ()
    starts = find_all(keywords, "FFD_TAG")
    return tuple(
        _read_section(keywords[a:b], *mesh.points.shape)
        for a, b in itertools.pairwise([*starts, None])
    )


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
        raise ValueError(
            "the mesh was not read from an SU2 file: other formats hold no free-form boxes."
        )
    _check_control(new, mesh.points.shape[1])
    content = source.content
    start, stop = _find_extent(source)
    end = b"\r\n" if b"\r\n" in content.raw[:1000] else b"\n"
    written = b"".join(line.encode() + end for line in _format_boxes(new)) if new else b""
    before = content.raw[:start]
    if written and before and not before.endswith(b"\n"):
        before += end
    (part,) = content.parts
    shift = len(before) + len(written) - stop if start < part.start else 0
    text = before + written + content.raw[stop:]
    part = part._replace(start=part.start + shift, stop=part.stop + shift)
    changed = dataclasses.replace(content, raw=text, parts=[part])
    return Mesh(mesh.points, mesh.cells, mesh.patches, dataclasses.replace(source, content=changed))


def _check_control(new: Sequence[Box], d: int) -> None:
    for box in new:
        expected = (*box.shape.counts, d)
        if np.shape(box.control) != expected:
            raise ValueError(
                f"box {box.name}: `control` has shape {np.shape(box.control)}; expected {expected}."
            )
    again = len(new) - len({box.name for box in new})
    if again:
        raise ValueError(f"{again} of {len(new)} boxes have the name of another one.")


def _find_keywords(source: Source) -> list[Keyword]:
    start = source.content.parts[0].start
    zones = split_zones(source.path, source.content.raw)
    return next(
        zone
        for zone in zones
        if ("NPOIN", start) in [(word.name, word.section.start) for word in zone]
    )


def _find_extent(source: Source) -> tuple[int, int]:
    keywords = _find_keywords(source)
    sections = [
        each.section for each in keywords if each.name.startswith(("FFD_", "BSPLINE_ORDER_"))
    ]
    if not sections:
        end = keywords[-1].section.stop
        return end, end
    return source.content.raw.rfind(b"\n", 0, sections[0].start - 1) + 1, sections[-1].stop


def _read_section(keywords: Sequence[Keyword], n: int, d: int) -> Box:
    table = {keyword.name: keyword for keyword in keywords}
    tag = table["FFD_TAG"]
    empty = Section(Path(), b"", 0, 0)
    name = tag.value.replace(" ", "")
    try:
        shape = _read_shape_of_box(table, d)
        control = _sort_control(_read_rows(table["FFD_CONTROL_POINTS"], 6), shape)
    except KeyError as error:
        missing = f"box {name} has no {error.args[0]}=; SU2 writes it by DV_KIND= FFD_SETTING."
        raise tag.section.error(missing) from error
    except ValueError as error:
        raise (
            error if ", line " in str(error) else tag.section.error(f"box {name}: {error}")
        ) from error
    others = {
        word: Keyword(word, "0", empty) for word in ("FFD_LEVEL", "FFD_SURFACE_POINTS", *RELATIVES)
    } | table
    lists = [others[word].section.content.split(b"\n") for word in RELATIVES]
    relatives = [tuple(decoded(line.strip()) for line in lines if line.strip()) for lines in lists]
    surface = _read_markers(others["FFD_SURFACE_POINTS"], n, d)
    return Box(name, shape, control, surface, others["FFD_LEVEL"].number(), *relatives)


def _read_shape_of_box(table: Mapping[str, Keyword], d: int) -> "jm.shapes.Hexahedron":
    degrees = np.array([table[f"FFD_DEGREE_{axis}"].number() for axis in "IJK"[:d]])
    orders = [table[word].number() if word in table else 0 for word in SPLINE_ORDERS[:d]]
    is_spline = all(
        1 < order <= degree + 1 for order, degree in zip(orders, degrees.tolist(), strict=True)
    )
    corners = _read_rows(table["FFD_CORNER_POINTS"], d)
    if len(corners) != 2**d:
        raise ValueError(f"{len(corners)} corners; {2**d} expected in {d}-D.")
    degree = [order - 1 for order in orders] if is_spline else None
    return jm.shapes.Hexahedron(corners, (degrees + 1).tolist(), degree=degree)


def _read_rows(keyword: Keyword, width: int) -> Float[ndarray, "k w"]:
    rows = keyword.section.rows(np.float64)
    if (rows.counts != width).any() or len(rows.counts) != keyword.number():
        message = f"{keyword.name}= {keyword.value}: as many rows of {width} numbers expected."
        raise keyword.section.error(message)
    return rows.values.reshape(-1, width)


def _sort_control(rows: Float[ndarray, "k 6"], shape: "jm.shapes.Hexahedron") -> ControlPoints:
    """Sorts control points by their numbers; in 2-D, two above each other become their mean."""
    d = len(shape.counts)
    counts = (*shape.counts, *(2,) * (3 - d))
    if not len(rows):
        return np.asarray(shape.lattice())
    rows = rows[np.lexsort(rows[:, 2::-1].T)]
    if not np.array_equal(rows[:, :3], list(np.ndindex(counts))):
        raise ValueError(
            f"{len(rows)} control points do not make a lattice of {' x '.join(map(str, counts))}."
        )
    control = rows[:, 3:].reshape(*counts, 3)
    return control if d == 3 else control.mean(axis=2)[..., :2]


def _read_markers(keyword: Keyword, n: int, d: int) -> Surface:
    """Reads rows of a marker, a node and three coordinates; these are left in the text alone."""
    section = keyword.section
    word = re.compile(rb"(?m)^[ \t]*(\S+)")
    text = section.text[: section.start] + word.sub(b"", section.content)
    numbers = section._replace(text=text, stop=len(text))
    rows = _read_rows(keyword._replace(section=numbers), 4)
    wrong = np.flatnonzero(~np.isin(rows[:, 0], np.arange(n)))
    if len(wrong):
        raise numbers.error(
            "a marker, a node and three coordinates in the box expected.", int(wrong[0])
        )
    markers = [decoded(marker) for marker in word.findall(section.content)]
    tables = gathered((marker, row[None]) for marker, row in zip(markers, rows, strict=True))
    return {
        marker: (table[:, 0].astype(np.int64), table[:, 1 : 1 + d])
        for marker, table in tables.items()
    }


def _format_boxes(new: Sequence[Box]) -> Iterator[str]:
    yield f"FFD_NBOX= {len(new)}"
    yield f"FFD_NLEVEL= {1 + max(box.level for box in new)}"
    for box in new:
        counts = box.shape.counts
        degrees = box.shape.box.degrees
        is_bezier = list(degrees) == [count - 1 for count in counts]
        yield from (f"FFD_TAG= {box.name}", f"FFD_LEVEL= {box.level}")
        yield from (
            f"FFD_DEGREE_{axis}= {count - 1}" for axis, count in zip("IJK", counts, strict=False)
        )
        yield f"FFD_BLENDING= {'BEZIER' if is_bezier else 'BSPLINE_UNIFORM'}"
        orders = () if is_bezier else degrees
        yield from (
            f"BSPLINE_ORDER_{axis}= {p + 1}" for axis, p in zip("IJK", orders, strict=False)
        )
        yield from (f"FFD_PARENTS= {len(box.parents)}", *box.parents)
        yield from (f"FFD_CHILDREN= {len(box.children)}", *box.children)
        yield from _format_points(box)


def _format_points(box: Box) -> Iterator[str]:
    """Yields corners, control points, in 2-D below and above the plane, and nodes in the box."""
    corners = box.shape.given_corners
    control = np.asarray(box.control, float)
    d = len(box.shape.counts)
    yield from (f"FFD_CORNER_POINTS= {len(corners)}", *map(_format_row, corners.tolist()))
    if d == 2:
        control = np.stack(
            [
                np.insert(control, 2, height, axis=-1)
                for height in (-HALF_THICKNESS, HALF_THICKNESS)
            ],
            axis=2,
        )
    yield f"FFD_CONTROL_POINTS= {control[..., 0].size}"
    yield from (
        _format_row([*place, *control[place].tolist()]) for place in np.ndindex(control.shape[:-1])
    )
    yield f"FFD_SURFACE_POINTS= {sum(len(nodes) for nodes, _ in box.surface.values())}"
    for marker, (nodes, inside) in box.surface.items():
        for node, x in zip(nodes.tolist(), inside.tolist(), strict=True):
            yield f"{marker}\t{_format_row([node, *x, *[HALF_THICKNESS] * (3 - d)])}"


def _format_row(numbers: list) -> str:
    return "\t".join(map(repr, numbers))
