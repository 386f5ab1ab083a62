"""What an accepted file may hold that one byte damages: what the byte stood for, and nothing else.

The place decides. In a coordinate, only that one differs, and is what Python and NumPy make of its text or of its bytes. In numbers
of nodes, one cell or one patch differs; of OpenFOAM, whose cells do not close then, nothing. In comments, and in files with
checksums, nothing differs. In HDF5's own structure, what h5py alone finds changed decides. In OpenFOAM's `boundary`, names differ.
"""

import io
import pathlib
import re
import tomllib
import warnings

import h5py
import numpy as np

from jaxmorph.io import _adf, _tree

WORD = re.compile(rb"[^\s()<>\",;{}%]*")


def parts(result) -> dict[str, np.ndarray]:
    """The arrays of what a reader returns by name: `points`, `cells KIND`, `patch NAME`; of other things by number."""
    if not hasattr(result, "patches"):
        import jax

        return {f"array {k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(result))}
    cells = {f"cells {kind}": np.asarray(ids) for kind, ids in result.cells.items()}
    if result.polyhedra is not None:  # how they are cut depends on coordinates: they are compared whole
        faces, pieces = result.polyhedra.faces, np.isin(result.cell_ids, result.polyhedra.cut)
        cut = np.split(pieces, np.cumsum([len(ids) for ids in cells.values()])[:-1])
        cells = {name: ids[~away] for (name, ids), away in zip(cells.items(), cut, strict=True)}
        cells |= {f"cells faces {k}": leaf for k, leaf in enumerate((faces.labels, faces.starts, result.polyhedra.cut))}
    patches = {f"patch {name}": np.asarray(nodes) for name, nodes in result.patches.items()}
    return {"points": np.asarray(result.points)} | cells | patches


def alike(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return list(a) == list(b) and all(np.array_equal(a[name], b[name]) for name in a)


def zone(file: pathlib.Path, data: bytes, at: int) -> str:
    """What a byte of a good file stands for: `points`, `ids`, `nothing`, `structure`, or `any` where that is not told here."""
    before, line = data[:at], data[data.rfind(b"\n", 0, at) + 1 : at]
    if file.suffix == ".su2":
        words = re.findall(rb"^(\w+)=", before, re.MULTILINE)
        if b"%" in line:
            return "nothing"
        known = {b"NPOIN": "points", b"NELEM": "ids", b"MARKER_ELEMS": "ids"}
        return "any" if b"=" in data[at - len(line) :].split(b"\n")[0] or not words else known.get(words[-1], "any")
    if data[:1] == b"(":  # Fluent's
        return "any"
    if file.suffix == ".msh":
        words = re.findall(rb"^\$(\w+)", before, re.MULTILINE)
        is_text = data[:60].split()[2:3] == [b"0"]
        known = {b"Nodes": "points" if is_text and b"." in _word(data, at) else "any", b"Elements": "ids"}
        return known.get(words[-1], "any") if words else "any"
    if file.suffix in (".cgns", ".e", ".med"):
        return _dataset(data, at)
    if file.name == "boundary":
        return "boundary"
    if file.parent.name == "polyMesh":
        is_banner = b"FoamFile" not in before or line.lstrip().startswith((b"//", b"|", b"\\*"))
        if is_banner and b"\0" not in line:
            return "nothing"
        if not file.name.startswith("points"):
            return "nothing"  # another node or another cell beside a face leaves cells open
        return "any" if at < data.find(b"\n\n", data.find(b"FoamFile")) else "points"
    return "any"


def _dataset(data: bytes, at: int) -> str:
    """The array of HDF5, ADF or netCDF that a byte of a good file belongs to."""
    named = []

    def visit(name, item):
        start = item.id.get_offset() if isinstance(item, h5py.Dataset) else None
        if start is not None and start <= at < start + item.id.get_storage_size():
            named.append(name)

    if data[4:25] == _adf.MAGIC:
        for name, pieces, _ in _nodes(data):
            named += [name for first, count in pieces if first <= at < first + count]
    elif data.startswith(_tree.MAGIC):
        for name, array in _tree._Header(io.BytesIO(data)).tree().items():
            named += [name for first, count in array.pieces if 0 < first <= at < first + count]
    else:
        with h5py.File(io.BytesIO(data)) as opened:
            opened.visititems(visit)
    if not named:
        return "structure"
    last = named[0].split("/")[-1]
    is_points = "Coordinate" in named[0] or last.startswith("coord") or last == "COO"
    is_ids = "Connectivity" in named[0] or last.startswith("connect") or last == "NOD"
    return "points" if is_points else "ids" if is_ids else "any"


NAMED = re.compile(r'"?([^\s"{}();]+)"?\s*\{([^{}]*)\}')
SPECIAL = re.compile(r"type\s+(empty|wedge|cyclic\w*|processor\w*|symmetryPlane)\s*;")


def _boundary(data: bytes, damaged: bytes, good, found, where: str) -> str:
    """What is wrong where a byte of `boundary` differs: patches have other names. Types of some say what a case is."""
    lists = []
    for text in (data.decode(errors="replace"), damaged.decode(errors="replace")):
        entries = NAMED.findall(re.sub(r"//.*|/\*[\s\S]*?\*/", " ", text.partition("}")[2]))
        lists.append([(name, SPECIAL.findall(body)) for name, body in entries])
    if [types for _, types in lists[0]] != [types for _, types in lists[1]]:
        return ""
    names = {f"patch {old}": f"patch {new}" for (old, _), (new, _) in zip(*lists, strict=True)}
    return "" if alike({names.get(name, name): each for name, each in good.items()}, found) else f"{where} changes it"


def content(data: bytes) -> dict[str, tuple]:
    """Everything in an HDF5 file as h5py has it: attributes, types and values by the path of each group and data set."""
    told = {}

    def visit(name, item):
        try:
            attributes = sorted((key, repr(value)) for key, value in item.attrs.items())
            is_data = isinstance(item, h5py.Dataset)
            told[name] = (attributes, str(item.dtype), item[()].tobytes()) if is_data else (attributes,)
        except Exception as error:  # h5py answers damage by a dozen classes
            told[name] = (repr(error),)

    if data[4:25] == _adf.MAGIC:
        return {name: content for name, _, content in _nodes(data)}
    if data.startswith(_tree.MAGIC):
        arrays = _tree._Header(io.BytesIO(data)).tree().items()
        return {name: (sorted(array.attrs.items()), array.shape, array.pieces) for name, array in arrays}
    with h5py.File(io.BytesIO(data)) as file:
        file.visititems(visit)
    return told


def _nodes(data: bytes) -> list[tuple[str, list[tuple[int, int]], tuple]]:
    """Labels, types and values of an ADF file by the path that HDF5 has, and where values stand in it."""
    waiting, found = [("", _adf.Reader(pathlib.Path("a.cgns"), io.BytesIO(data)).tree())], []
    while waiting:
        place, node = waiting.pop()
        found.append((place, [], (node.attrs["label"],)))
        for name, child in node.items():
            path = f"{place}/{name}".lstrip("/")
            if isinstance(child, _adf.Array):
                values = child[()]
                found.append((path, child.pieces, ([], values.dtype.str, values.tobytes())))
            else:
                waiting.append((path, child))
    return found


def _structure(right: dict[str, tuple], damaged: dict[str, tuple], wrong: list[str], found, where: str) -> str:
    """What is wrong where a byte of HDF5's own structure differs, by the content of the good file and of the other one."""
    changed = [name for name in right.keys() | damaged.keys() if right.get(name) != damaged.get(name)]
    if not changed:
        return f"{where} changes {wrong}, and nothing that h5py finds"
    if not any("Coordinate" in name for name in right):
        return ""  # of Exodus and MED
    if any("Coordinate" not in name for name in changed):
        kinds = {"ZoneBC": ("patch",), "cells": ("cells", "patch"), "faces": ("cells", "patch")}
        may = [kinds.get(part, ()) for name in changed for part in name.split("/")[2:3]]
        if all(may) and not all(name.startswith(sum(may, ())) for name in wrong):
            return f"{where} changes {wrong}, but {changed} in the file"
        return ""
    names = [name for name in sorted(right) if "Coordinate" in name and " data" in name]
    axes = [np.frombuffer(damaged[name][2], damaged[name][1]) for name in names]
    told = set(map(tuple, np.stack(axes, axis=1).astype(float).tolist()))
    places = set(map(tuple, found["points"].tolist()))  # nodes of zones that meet are one
    return "" if places <= told else f"{where} changes {wrong}"


def _word(data: bytes, at: int) -> bytes:
    start = at
    while start and WORD.fullmatch(data[start - 1 : start]) and data[start - 1 : start]:
        start -= 1
    match = WORD.match(data, start)
    return match[0] if match else b""


def values(damaged: bytes, at: int) -> np.ndarray:
    """What the damaged place may mean: the word there as a number, and all numbers of four and eight bytes across it."""
    numbers = []
    for start in (at, at + 1):
        try:
            numbers.append(float(_word(damaged, start).replace(b"D", b"E").replace(b"d", b"e")))
        except ValueError:
            continue
    for kind in ("<f8", ">f8", "<f4", ">f4"):
        width = int(kind[2])
        pieces = (damaged[k : k + width] for k in range(max(at - width + 1, 0), at + 1))
        numbers += [float(np.frombuffer(piece, kind)[0]) for piece in pieces if len(piece) == width]
    return np.array(numbers)


def accepted(file: pathlib.Path, data: bytes, damaged: bytes, at: int, good, found, *, sealed: bool) -> str:
    """What is wrong with what a reader makes of a damaged file, `good` being that of the good one; nothing if it is right."""
    if alike(found, good):
        return ""
    place = "nothing" if sealed or file.suffix == ".npz" else zone(file, data, at)
    where = f"a byte of {place} at {at} ({data[max(at - 20, 0) : at + 20]!r})"
    if place == "nothing":
        return f"{where} changes what is read"
    wrong = sorted(name for name in good.keys() | found.keys() if not np.array_equal(found.get(name), good.get(name)))
    if file.suffix == ".toml":
        is_other = tomllib.loads(damaged.decode()) != tomllib.loads(data.decode())
        return "" if is_other else f"{where} changes what is read"
    if place == "boundary":
        return _boundary(data, damaged, good, found, where)
    if place == "structure":
        return _structure(content(data), content(damaged), wrong, found, where)
    if file.suffix in (".xyz", ".patches", ".cgns") and place != "ids":
        return _places(good, found, np.zeros(0) if file.suffix == ".patches" else values(damaged, at), where)
    if file.suffix in (".vtk", ".vtu") and "cells faces 0" in good and good["points"].shape == found["points"].shape:
        # a type belongs to all pieces of a cell, and the sense of all faces follows from points
        return "" if (good["points"] != found["points"]).sum() <= 1 else f"{where} changes {wrong}"
    if data[:1] == b"(" and good["points"].shape == found["points"].shape:  # the sense of faces follows from all points
        return "" if (good["points"] != found["points"]).sum() <= 2 else f"{where} changes {wrong}"
    numbers = [name for name in wrong if name == "points" or name.startswith("array")]
    if numbers:
        if place == "ids" or len(wrong) > 1:
            return f"{where} changes {wrong}"
        a, b = good[numbers[0]], found[numbers[0]]
        if a.shape != b.shape:
            return f"{where} changes the shape of {wrong}"
        changed = np.argwhere(a != b)
        if len(changed) > 1:
            return f"{where} changes {len(changed)} numbers of {wrong}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            is_right = wrong != ["points"] or b[tuple(changed[0])] in values(damaged, at)
        return "" if is_right else f"{where} makes {b[tuple(changed[0])]!r} of {a[tuple(changed[0])]!r}"
    if place == "points":
        return f"{where} changes {wrong}"
    cells = [name for name in wrong if name.startswith("cells")]
    if cells:
        told = [name for name in wrong if name not in (*cells, "patch boundary")]  # of a file that names no patch
        told = [] if file.suffix == ".e" else told  # sets of sides, whose nodes are those of cells
        return "" if not told and _rows(good, found) <= 1 else f"{where} changes {wrong}: {_rows(good, found)} cells"
    return "" if _members(good, found) <= 2 else f"{where} changes {wrong}"


def _places(good, found, expected: np.ndarray, where: str) -> str:
    """Compares the corners of all cells by place: nodes of blocks that meet are one where their places are, and it alone."""
    a, b = (np.concatenate([each["points"][ids].reshape(-1) for name, ids in each.items() if name.startswith("cells")
                            and "faces" not in name]) for each in (good, found))  # fmt: skip
    if a.shape != b.shape:
        return f"{where} changes the number of cells"
    changed = np.unique(b[a != b])
    told = expected[np.isfinite(expected)]
    # a node beside another one is joined to it
    near = 1e-3 * np.ptp(a) if len(good["points"]) > len(found["points"]) else 0
    with np.errstate(over="ignore"):
        is_told = (np.abs(changed[:, None] - told) <= near).any(axis=1)
    return "" if is_told.all() else f"{where} makes {changed} of places"


def _rows(good, found) -> int:
    """Counts the cells of either mesh that are not in the other one, and the nodes of whole cells' faces that differ."""
    cells = [[name for name in each if name.startswith("cells") and "faces" not in name] for each in (good, found)]
    rows = [{(name, *row) for name in names for row in each[name].tolist()}
            for names, each in zip(cells, (good, found), strict=True)]  # fmt: skip
    labels, other = (each.get("cells faces 0", np.zeros(0)) for each in (good, found))
    faces = int((labels != other).sum()) if labels.shape == other.shape else 99
    return max(len(rows[0] - rows[1]), len(rows[1] - rows[0])) + faces


def _members(good, found) -> int:
    """Counts the patches that hold other nodes: those of one that has a new name are the same."""
    members = [{tuple(ids.tolist()) for name, ids in m.items() if name.startswith("patch")} for m in (good, found)]
    return max(len(members[0] - members[1]), len(members[1] - members[0]))
