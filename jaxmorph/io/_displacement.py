"""Displacements of moving nodes from a file, or from two surfaces (STL, OBJ, NPZ); tables by node.

A table has rows of node id, x, y[, z] in text; SU2's restart files are one in binary.
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from jaxmorph import Facets, Mesh
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import PathLike, input_path, read_arrays, real_values
from jaxmorph._host.rows import Rows
from jaxmorph._host.surface.cad_sources import CAD_ENDINGS, cad_model
from jaxmorph._host.surface.gaps import closest, fans

from ._format import faults_of
from ._registry import read
from ._text import Section, decoded, parse, scan

NodeIds = Int[ndarray, " m"]
RowsOfNodes = Float[ndarray, "m d"]
IdsAndRows = tuple[NodeIds, RowsOfNodes]

OFF = 0.01
"""Distance of a moving node off the surface, as a share of its bounding box's diagonal."""


@checked
def read_displacement(
    path: PathLike,
    mesh: Mesh,
    moving: Int[ndarray, " m"],
    *,
    before: PathLike | None = None,
    is_position: bool = True,
) -> Float[ndarray, "m d"]:
    """Reads the displacement of each of the nodes `moving`, in their order.

    With `before` it goes from one surface to another of the same points in the same order (.stl,
    .obj, or .npz of `points` and `triangles`, in 2-D `lines`). Each node takes the displacement of
    the closest place of `before`. Without `before` it goes by node id. The file is a table `id, x,
    y[, z]` (SU2's `surface_*.dat`, .csv), or .npz of `displacement` or `position` and `ids`
    (default: in the order of `moving`). Ids are rows of `mesh.points`, from 0, or the numbers that
    a file of gmsh, Abaqus, I-deas, Exodus or MED gives the same nodes.

    **Arguments:**

    - `path`: the file, or the surface after the motion.
    - `mesh`: the mesh; `mesh.points` is undeformed.
    - `moving`: ids (m,) of the moving nodes.
    - `before`: the surface before the motion. Default: none.
    - `is_position`: a table holds new positions (True, default) or displacements.

    **Returns:** displacements (m, d) in the unit of the mesh.

    **Raises:** `ValueError` for missing or foreign nodes, surfaces of different connectivity, and
    nodes off the surface `before` by more than 0.01 of its size.
    """
    path = input_path(path)
    moving = np.asarray(moving)
    points = np.asarray(mesh.points)
    if before is not None:
        return _interpolate_motion(input_path(before), path, points[moving])
    of_file = getattr(mesh.source, "node_ids", None)
    d = points.shape[1]
    numbers = moving if of_file is None else of_file[moving]
    with faults_of(path):
        if path.suffix.lower() in (".stl", ".obj"):
            raise ValueError("a surface without node ids; give the surface before the motion too.")
        if path.suffix.lower() == ".npz":
            ids, values, name = read_named(path, ("displacement", "position"), numbers)
            is_position = name == "position"
        else:
            ids, values = read_surface(path, d)
        known = (numbers, "the moving patches")
        values = sort_by_id(ids, values, d, numbers, known, take_labels(mesh, moving))
    return values - points[moving] if is_position else values


def take_labels(mesh: Mesh, nodes: NodeIds) -> ndarray | None:
    """Returns the numbers that the mesh's file gives some nodes; None where it has no others."""
    labels = getattr(mesh.source, "labels", None)
    return None if labels is None or len(labels) != len(mesh.points) else labels[nodes]


@checked
def read_facets(
    path: PathLike, d: int = 3, *, smooth: bool = False, angle: float = np.pi / 3
) -> Facets:
    """Reads a surface in 3-D, a curve in 2-D: a scan, or a CAD model.

    Closest places on a CAD model are on its own surfaces, and its edges are sharp where its faces
    turn, not where facets do. Its numbers stay as the file has them, in the unit that it names.

    **Arguments:**

    - `path`: .stl, .obj, .npz of `points` and `triangles` (2-D: `lines`), or a mesh, of which its
      faces count, else its boundary. A CAD model in .step, .iges or .brep.
    - `d`: 2 takes x and y of .obj. Default 3.
    - `smooth`, `angle`: as `Facets` takes them.

    **Raises:** `ValueError` for a damaged file, and for triangles in 2-D or lines in 3-D.
    `ImportError` for a CAD model without OpenCASCADE.
    """
    path = input_path(path)
    if path.suffix.lower() in CAD_ENDINGS:
        with faults_of(path):
            if d != 3:
                message = "a CAD model has surfaces in 3-D; in 2-D take lines of .obj or .npz."
                raise ValueError(message)
            model = cad_model(path)
        return Facets(model.facets.points, model.facets.triangles, model=model)
    if path.suffix.lower() not in READERS:
        return Facets.of(read(path), smooth=smooth, angle=angle)
    shape = read_shape(path)
    if shape.points.shape[1] < d or shape.simplices.shape[1] != d:
        found = f"faces of {shape.simplices.shape[1]} points in {shape.points.shape[1]}-D"
        raise ValueError(
            f"{path}: {'lines' if d == 2 else 'triangles'} in {d}-D are expected, found {found}."
        )
    return Facets(shape.points[:, :d], shape.simplices, smooth=smooth, angle=angle)


def _interpolate_motion(before: Path, after: Path, x: ndarray) -> ndarray:
    old = read_shape(before)
    new = read_shape(after)
    if old.points.shape != new.points.shape or not np.array_equal(old.simplices, new.simplices):
        sizes = " and ".join(
            f"{len(surface.points)} points, {len(surface.simplices)} faces"
            for surface in (old, new)
        )
        raise ValueError(f"{before} and {after} differ in connectivity: {sizes}.")
    d = x.shape[1]
    if old.points.shape[1] < d or (old.simplices.shape[1] != d and d == 2):
        raise ValueError(
            f"{before}: a mesh in {d}-D takes "
            f"{'lines of OBJ or NPZ' if d == 2 else 'a surface in 3-D'}."
        )
    # linear on each triangle or segment, and exact at its corners
    simplex, weights, distance = closest(old.points[old.simplices][..., :d], x)
    values = np.einsum("mc,mck->mk", weights, (new.points - old.points)[old.simplices[simplex], :d])
    limit = OFF * np.linalg.norm(np.ptp(old.points, axis=0))
    off = np.flatnonzero(distance > limit)
    if off.size:
        place = ", ".join(f"{value:.4g}" for value in x[distance.argmax()])
        raise ValueError(
            f"{before}: {off.size} of {len(x)} moving nodes are off this surface by more than "
            f"{limit:.3g}, at most by "
            f"{distance.max():.3g} near ({place}). Does the surface have the mesh's units and "
            "origin?"
        )
    return values


class Simplices(NamedTuple):
    """`points` (p, 2 or 3), and `simplices`: triangles (t, 3), or a curve's segments (t, 2)."""

    points: ndarray
    simplices: ndarray


def read_shape(path: Path) -> Simplices:
    """Reads a surface: .stl (text, binary), .obj (faces, lines), .npz (points with either)."""
    with faults_of(path):
        if path.suffix.lower() not in READERS:
            raise ValueError(
                f"a surface is read from {', '.join(READERS)}, found the ending {path.suffix!r}."
            )
        points, simplices = READERS[path.suffix.lower()](path)
        if not len(simplices) or points.ndim != 2 or not np.isfinite(points).all():
            contents = f"{len(simplices)} faces between points of shape {points.shape}"
            raise ValueError(f"not a surface, or a damaged one: {contents}, all finite, expected.")
        if simplices.min() < 0 or simplices.max() >= len(points):
            raise ValueError(
                f"a face names a point that is not among the {len(points)} of this file."
            )
        return Simplices(points, simplices)


def _read_stl(path: Path) -> Simplices:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and count:
        facets = np.frombuffer(
            data, np.dtype([("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")]), count, 84
        )
        points = facets["x"].reshape(-1, 3).astype(float)
    else:
        values = parse(b" ".join(re.findall(rb"vertex\s([^\r\n]*)", data)), np.float64)
        if len(values) % 9:
            raise ValueError(
                f"{len(values)} coordinates of vertices are no whole number of triangles."
            )
        points = values.reshape(-1, 3)
    return Simplices(points, np.arange(len(points)).reshape(-1, 3))


def _read_obj(path: Path) -> Simplices:
    data = path.read_bytes()
    rows = re.findall(rb"^v\s+(\S+\s+\S+\s+\S+)", data, re.MULTILINE)
    values = parse(b" ".join(rows), np.float64)
    if len(values) != 3 * len(rows):
        raise ValueError("a vertex holds something that is not a number.")
    points = values.reshape(-1, 3)
    for mark, corners in ((b"f", 3), (b"l", 2)):
        text = b"\n".join(re.findall(rb"^" + mark + rb"\s+([^\r\n]*)", data, re.MULTILINE))
        if text.strip():
            text = re.sub(rb"/\S*", b"", text)
            ids = parse(text, np.int64)
            counts = scan(text)[2]
            if len(ids) != counts.sum() or (counts < corners).any() or (ids < 1).any():
                raise ValueError(
                    f"faces and lines need the numbers, from 1, of {corners} vertices or more."
                )
            chains = (
                np.delete(np.column_stack([ids[:-1], ids[1:]]), np.cumsum(counts)[:-1] - 1, axis=0)
                - 1
            )
            return Simplices(points, fans(ids - 1, counts) if corners == 3 else chains)
    return Simplices(points, np.zeros((0, 3), np.int64))


def _read_npz(path: Path) -> Simplices:
    arrays = read_arrays(path)
    kind = next((name for name in ("triangles", "lines") if name in arrays), "")
    if not kind or "points" not in arrays:
        listed = ", ".join(arrays) or "none"
        raise ValueError(f"arrays points, and triangles or lines, expected; found {listed}.")
    simplices = arrays[kind]
    corners = 3 if kind == "triangles" else 2
    if simplices.dtype.kind not in "iu" or simplices.ndim != 2 or simplices.shape[1] != corners:
        found = f"{simplices.dtype} of shape {simplices.shape}"
        raise ValueError(f"{kind} must be whole numbers (k, {corners}), found {found}.")
    return Simplices(real_values(path, arrays, "points"), simplices.astype(np.int64))


READERS = {".stl": _read_stl, ".obj": _read_obj, ".npz": _read_npz}

FACT = re.compile(rb"^[ \t]*[A-Za-z_]+[ \t]*=.*$", re.MULTILINE)
"""A line `NAME= value`, as SU2's older restarts have behind their rows."""
COLUMN_NAME = re.compile(rb"\"[^\"]*\"|[^\s,;]+")
HEADER_LINE = re.compile(rb"\s*[\"']*(?!(?:nan|inf)\b)[a-z][^\n]*\n?", re.IGNORECASE)
"""A header: a first line that begins with a name."""
IDS = ("pointid", "point_id", "id", "node", "globalindex", "global_index")
"""Headers of the column of node ids, which is the first one otherwise."""
MAGICS = {(535532).to_bytes(4, "little"): "<", (535532).to_bytes(4, "big"): ">"}
"""The first number of a binary restart, in four bytes of either order."""
NAME_WIDTH = 33
"""Bytes of the name of one of its columns."""


@checked
def read_surface(path: PathLike, d: int) -> tuple[Int[ndarray, " m"], Float[ndarray, "m d"]]:
    """Reads ids and d numbers each, from lines `id, x, y[, z]`: SU2's surfaces, or CSV.

    Numbers stand between blanks, commas or semicolons; a header line and what follows `%` or `#`
    are skipped. The numbers are positions or displacements.

    **Arguments:**

    - `path`: the file.
    - `d`: how many numbers follow each id, 2 or 3.

    **Returns:** node ids (m,) and numbers (m, d).

    **Raises:** `ValueError`, with file and line, for other contents and duplicate or broken ids.
    """
    path = input_path(path)
    with faults_of(path):
        return read_table(path, d)


def read_table(path: Path, d: int, wanted: tuple[str, ...] = ()) -> IdsAndRows:
    """Reads node ids and d numbers for each; with `wanted` those of columns with these headers."""
    text = path.read_bytes()
    if wanted and text[:4] in MAGICS:
        return _read_restart(text, wanted[:d])
    text = FACT.sub(b"", re.sub(rb"[%#][^\n]*", b"", text))
    found = HEADER_LINE.match(text)
    head = found[0] if found else b""
    names = [decoded(name.strip(b"\"'").lower()) for name in COLUMN_NAME.findall(head)]
    rows = Section(path, re.sub(rb"[,;]", b" ", text), len(head), len(text)).rows(np.float64)
    if not len(rows.counts):
        raise ValueError(f"no rows of node id and {d} numbers in this file.")
    columns = list(range(d + 1))
    width = d + 1
    expected = f"a node id and {d} numbers"
    if wanted and {*wanted[:d]} <= {*names}:
        columns = [
            next((k for k, name in enumerate(names) if name in IDS), 0),
            *map(names.index, wanted[:d]),
        ]
        width = len(names)
        expected = f"{len(names)} numbers, as in the header,"
    rows.refuse(
        rows.counts != width, lambda k: f"{expected} expected, found {rows.counts[k]} numbers."
    )
    table = rows.values.reshape(-1, width)[:, columns]
    ids = np.abs(np.floor(table[:, 0]))
    is_wrong = ~np.isfinite(table).all(axis=1) | (ids != table[:, 0])
    rows.refuse(
        is_wrong, lambda k: f"found {table[k].tolist()}, not a node id and {d} finite numbers."
    )
    rows.refuse(Rows(ids).repeated, lambda k: f"node {ids[k]:.0f} comes a second time.")
    return ids.astype(np.int64), np.ascontiguousarray(table[:, 1:])


def read_named(
    path: Path, names: tuple[str, ...], ids: NodeIds | None = None
) -> tuple[NodeIds, ndarray, str]:
    """Reads node ids (if absent `ids`, or 0, 1, 2, ...), an array of `names`, and its name."""
    arrays = read_arrays(path)
    found = [name for name in names if name in arrays]
    if len(found) != 1:
        listed = ", ".join(arrays) or "none"
        raise ValueError(f"one array {' or '.join(names)} expected, found {listed}.")
    values = real_values(path, arrays, found[0])
    ids = arrays.get("ids", np.arange(len(np.atleast_1d(values))) if ids is None else ids)
    if ids.dtype.kind not in "iu" or ids.ndim != 1:
        raise ValueError(f"ids must be whole numbers (n,), found {ids.dtype} of shape {ids.shape}.")
    copies = Rows(ids).repeated
    if len(copies):
        raise ValueError(f"{len(copies)} of its {len(ids)} node ids come a second time.")
    return ids, values, found[0]


def sort_by_id(
    ids: ndarray,
    values: ndarray,
    d: int,
    wanted: NodeIds,
    known: tuple[ndarray, str],
    labels: ndarray | None = None,
) -> RowsOfNodes:
    """Returns the values of the nodes `wanted` from a file's, in the order of its `ids`.

    The ids count from 0. Or they are the mesh file's own numbers, the `labels` (m,) of `wanted`.
    Raises `ValueError` for values that are not finite or not (ids, d), for ids that are not among
    those `known`, with what these are called, and for missing ones.
    """
    if values.shape != (len(ids), d) or not np.isfinite(values).all():
        raise ValueError(
            f"finite values of shape ({len(ids)}, {d}) expected, found shape {values.shape}."
        )
    foreign = np.setdiff1d(ids, known[0])
    missing = np.setdiff1d(wanted, ids)
    own = ""
    if labels is not None:
        if len(foreign) + len(missing) and np.array_equal(np.sort(ids), np.sort(labels)):
            return values[Rows(ids).of(labels)]
        own = f", or are all of the mesh file's own, {labels.min()} to {labels.max()}"
    faults = [
        f"{foreign.size} of its {len(ids)} node ids are not of {known[1]} (first {x})"
        for x in foreign[:1]
    ]
    faults += [
        f"{missing.size} of the {len(wanted)} nodes are missing (first {x})" for x in missing[:1]
    ]
    if faults:
        raise ValueError(f"{', and '.join(faults)}. Ids count the nodes from 0{own}.")
    return values[Rows(ids).of(wanted)]


def _read_restart(content: bytes, wanted: tuple[str, ...]) -> IdsAndRows:
    """Reads columns of a binary restart, which has a row for each node in the order of the mesh."""
    order = MAGICS[content[:4]]
    begin = 20  # five numbers: 535532, counts of columns and nodes, two zeros
    k, n = map(int, np.frombuffer(content[:begin].ljust(begin, b"\0"), f"{order}i4")[1:3])
    start = begin + NAME_WIDTH * k
    size = start + 8 * n * k
    if k < 1 or n < 1 or len(content) < size:
        raise ValueError(
            f"a binary restart of {n} nodes and {k} columns has {size} bytes or more, found "
            f"{len(content)}."
        )
    words = np.frombuffer(content, f"S{NAME_WIDTH}", k, begin).tolist()
    names = [decoded(word.partition(b"\0")[0]).strip("\"' ").lower() for word in words]
    missing = ", ".join(name for name in wanted if name not in names)
    if missing:
        raise ValueError(
            f"a binary restart without the columns {missing}; it has {', '.join(names)}."
        )
    values = np.frombuffer(content, f"{order}f8", n * k, start).reshape(n, k)[
        :, [*map(names.index, wanted)]
    ]
    return np.arange(n), values.astype(float)
