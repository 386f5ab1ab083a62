"""Free-form boxes that SU2 keeps in its mesh files, behind the markers."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked
from jaxmorph.shapes import Hexahedron

from ._format import Source, source_of
from ._su2 import NAME, Keyword, by_zones
from ._text import Section, decoded

Points = Float[np.ndarray, "..."]
Surface = Mapping[str, tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k d"]]]

HALF = 0.5
"""SU2's boxes of a 2-D mesh are 1 thick: control points at -1/2 and 1/2, nodes between."""


@dataclasses.dataclass(frozen=True, eq=False)
class Box:
    """A free-form box of an SU2 file.

    - `name`: its tag.
    - `shape`: corners, numbers of control points and degrees; in the dimension of the mesh.
    - `control`: positions (*counts, d) of the control points now. Those of `shape.lattice()` until
      the box is deformed.
    - `surface`: by marker, ids (k,) of its nodes in the box and their coordinates (k, d) there,
      which a deformation leaves.
    - `level`, `parents`, `children`: of nested boxes; 0 and none for others.
    """

    name: str
    shape: Hexahedron
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

    **Raises:** `ValueError` for a section that is cut short, with file and line.
    """
    source = source_of(mesh, NAME)
    if source is None or b"FFD_" not in source.content.text:
        return ()
    keywords = _keywords(source)
    starts = [k for k, keyword in enumerate(keywords) if keyword.name == "FFD_TAG"]
    ends = [*starts[1:], len(keywords)]
    if not any(keyword.name == "FFD_NBOX" for keyword in keywords):
        return ()
    n, d = mesh.points.shape
    return tuple(_box(keywords[a:b], n, d) for a, b in zip(starts, ends, strict=True))


@checked
def with_boxes(mesh: Mesh, new: Sequence[Box]) -> Mesh:
    """Makes a mesh whose file, once written, has these free-form boxes and no others.

        boxes = [dataclasses.replace(box, control=box.control + change) for box in io.boxes(mesh)]
        io.write("moved.su2", io.with_boxes(mesh.moved(points), boxes))

    **Arguments:**

    - `mesh`: a mesh that was read from an SU2 file.
    - `new`: its boxes, none to remove all.

    **Returns:** a `Mesh` with the points, cells and patches of `mesh`.

    **Raises:** `ValueError` for a mesh that did not come from an SU2 file, boxes of one name, and
    other control points.
    """
    source = source_of(mesh, NAME)
    if source is None:
        raise ValueError("the mesh was not read from an SU2 file: other formats hold no free-form boxes.")
    d = mesh.points.shape[1]
    for box in new:
        if np.shape(box.control) != (*box.shape.counts, d):
            raise ValueError(
                f"box {box.name}: `control` has shape {np.shape(box.control)}; expected {(*box.shape.counts, d)}."
            )
    names = [box.name for box in new]
    if len(set(names)) < len(names):
        raise ValueError(f"{len(names) - len(set(names))} of {len(names)} boxes have the name of another one.")
    content = source.content
    start, stop = _extent(source)
    end = b"\r\n" if b"\r\n" in content.text[:1000] else b"\n"
    lines = [line.encode() for line in _lines(new, d)] if new else []
    before = content.text[:start]
    if lines and before and not before.endswith(b"\n"):
        before += end
    written = b"".join(line + end for line in lines)
    shift = len(before) + len(written) - stop if start < content.start else 0
    text = before + written + content.text[stop:]
    changed = dataclasses.replace(content, text=text, start=content.start + shift, stop=content.stop + shift)
    return Mesh(mesh.points, mesh.cells, mesh.patches, dataclasses.replace(source, content=changed))


def _keywords(source: Source) -> Sequence[Keyword]:
    """Finds the keywords of the file, or of the zone in it that a mesh was read from."""
    content = source.content
    zones = by_zones(source.path, content.text)
    return next(
        zone for zone in zones if any(word.name == "NPOIN" and word.section.start == content.start for word in zone)
    )


def _extent(source: Source) -> tuple[int, int]:
    """Finds where the text's section of boxes begins and ends; both are the zone's end if none."""
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
        if word not in table and default is None:
            raise at.error(f"box {name} has no {word}=; SU2 writes it by DV_KIND= FFD_SETTING.")
        return table[word].number() if word in table else int(default or 0)

    degrees = [number(f"FFD_DEGREE_{axis}") for axis in "IJK"[:d]]
    orders = [number(f"BSPLINE_ORDER_{axis}", 0) for axis in "IJK"[:d]]
    corners = _rows(table, "FFD_CORNER_POINTS", at, d)
    if len(corners) != 2**d:
        raise at.error(f"box {name} has {len(corners)} corners; {2**d} expected in {d}-D.")
    bent = all(1 < order <= degree + 1 for order, degree in zip(orders, degrees, strict=True))
    try:
        shape = Hexahedron(corners, [p + 1 for p in degrees], degree=[o - 1 for o in orders] if bent else None)
    except ValueError as error:
        raise at.error(f"box {name}: {error}") from None
    return Box(
        name,
        shape,
        _control(_rows(table, "FFD_CONTROL_POINTS", at, 6), shape, at),
        _surface(table.get("FFD_SURFACE_POINTS"), n, d),
        number("FFD_LEVEL", 0),
        _names(table.get("FFD_PARENTS")),
        _names(table.get("FFD_CHILDREN")),
    )


def _rows(table: Mapping[str, Keyword], name: str, at: Section, width: int) -> Float[np.ndarray, "k w"]:
    if name not in table:
        raise at.error(f"a box has no {name}=.")
    keyword = table[name]
    rows = keyword.section.rows(np.float64)
    if (rows.counts != width).any() or len(rows.counts) != keyword.number():
        raise keyword.section.error(f"{name}= {keyword.value}: as many rows of {width} numbers expected.")
    return rows.values.reshape(-1, width)


def _control(rows: Float[np.ndarray, "k 6"], shape: Hexahedron, at: Section) -> Points:
    """Sorts control points by their numbers; in 2-D, two above each other become their mean."""
    d = len(shape.counts)
    counts = (*shape.counts, *(2,) * (3 - d))
    if not len(rows):
        return np.asarray(shape.lattice())
    ids = rows[:, :3].astype(int)
    if (
        len(rows) != np.prod(counts)
        or (ids < 0).any()
        or (ids >= counts).any()
        or len(np.unique(ids, axis=0)) < len(ids)
    ):
        raise at.error(f"{len(rows)} control points do not make a lattice of {' x '.join(map(str, counts))}.")
    control = np.empty((*counts, 3))
    control[tuple(ids.T)] = rows[:, 3:]
    return control if d == 3 else control.mean(axis=2)[..., :2]


def _surface(keyword: Keyword | None, n: int, d: int) -> Surface:
    lists: dict[str, list[list[float]]] = {}
    if keyword is None:
        return {}
    lines = [line.split() for line in keyword.section.text[keyword.section.start : keyword.section.stop].split(b"\n")]
    lines = [line for line in lines if line]
    if len(lines) != keyword.number():
        raise keyword.section.error(f"FFD_SURFACE_POINTS= {keyword.value}, but {len(lines)} rows follow.")
    for row, words in enumerate(lines):
        try:
            values = [float(word) for word in words[1:]]
        except ValueError:
            values = []
        if len(values) != 4 or not 0 <= values[0] < n or values[0] != int(values[0]):
            raise keyword.section.error("a marker, a node and three coordinates in the box expected.", row)
        lists.setdefault(decoded(words[0]), []).append(values)
    tables = {marker: np.array(rows) for marker, rows in lists.items()}
    return {marker: (table[:, 0].astype(np.int64), table[:, 1 : 1 + d]) for marker, table in tables.items()}


def _names(keyword: Keyword | None) -> tuple[str, ...]:
    if keyword is None:
        return ()
    content = keyword.section.text[keyword.section.start : keyword.section.stop]
    return tuple(decoded(line.strip()) for line in content.split(b"\n") if line.strip())


def _lines(new: Sequence[Box], d: int) -> Iterator[str]:
    """Yields the section line by line, as SU2 writes it."""
    yield f"FFD_NBOX= {len(new)}"
    yield f"FFD_NLEVEL= {1 + max(box.level for box in new)}"
    for box in new:
        counts, degrees = box.shape.counts, box.shape.box.degrees
        yield from (f"FFD_TAG= {box.name}", f"FFD_LEVEL= {box.level}")
        yield from (f"FFD_DEGREE_{axis}= {count - 1}" for axis, count in zip("IJK", counts, strict=False))
        bezier = all(p == count - 1 for p, count in zip(degrees, counts, strict=True))
        yield f"FFD_BLENDING= {'BEZIER' if bezier else 'BSPLINE_UNIFORM'}"
        if not bezier:
            yield from (f"BSPLINE_ORDER_{axis}= {p + 1}" for axis, p in zip("IJK", degrees, strict=False))
        yield from (f"FFD_PARENTS= {len(box.parents)}", *box.parents)
        yield from (f"FFD_CHILDREN= {len(box.children)}", *box.children)
        corners = box.shape.given_corners
        yield from (f"FFD_CORNER_POINTS= {len(corners)}", *("\t".join(map(repr, row)) for row in corners.tolist()))
        yield from _control_lines(np.asarray(box.control, float), d)
        yield f"FFD_SURFACE_POINTS= {sum(len(nodes) for nodes, _ in box.surface.values())}"
        for marker, (nodes, places) in box.surface.items():
            for node, place in zip(nodes.tolist(), places.tolist(), strict=True):
                yield "\t".join([marker, str(node), *map(repr, place), *[repr(HALF)] * (3 - d)])


def _control_lines(control: Points, d: int) -> Iterator[str]:
    full = np.empty((*control.shape[:-1], *(2,) * (3 - d), 3))
    if d == 3:
        full[...] = control
    else:
        full[..., :2], full[..., 2] = control[:, :, None], np.array([-HALF, HALF])
    yield f"FFD_CONTROL_POINTS= {full[..., 0].size}"
    for place in np.ndindex(full.shape[:-1]):
        yield "\t".join([*map(str, place), *map(repr, full[place].tolist())])
