"""Fluent's files of a mesh, in text, in binary and in HDF5, as Fluent writes them."""

import itertools
import pathlib

import h5py
import numpy as np

from jaxmorph._mesh.faces import faces_of_cells, joined_faces

KINDS = {"triangle": 1, "tetra": 2, "quad": 3, "hexahedron": 4, "pyramid": 5, "wedge": 6}
Zones = list[tuple[str, str, int, np.ndarray]]
"""Zones of faces: name, kind, its number, and the faces."""


def faces(
    cells: dict[str, np.ndarray], patches: dict[str, np.ndarray]
) -> tuple[list[np.ndarray], np.ndarray, Zones]:
    """The faces of cells by their nodes, the cells on both sides from 1, and the zones: inner faces, patches, other faces."""
    ends = np.cumsum([0, *map(len, cells.values())])
    spans = zip(cells.items(), itertools.pairwise(ends), strict=True)
    parts = [faces_of_cells(kind, ids, np.arange(a, b)) for (kind, ids), (a, b) in spans]
    joined = joined_faces(parts)
    rows = [joined.labels[a:b] + 1 for a, b in itertools.pairwise(joined.starts)]
    sides, zones = np.column_stack([joined.owner, joined.neighbour]) + 1, []
    left = sides[:, 1] == 0
    zones.append(("inside", "interior", 2, np.flatnonzero(~left)))
    for name, nodes in patches.items():
        inside = np.array([np.isin(row - 1, nodes).all() for row in rows]) & left
        zones.append((name, "wall", 3, np.flatnonzero(inside)))
        left &= ~inside
    zones.append(("rest", "pressure-far-field", 9, np.flatnonzero(left)))
    return rows, sides, zones


def write(
    path: pathlib.Path, points: np.ndarray, cells: dict, patches: dict, form: str = "text", **how
) -> None:
    """Writes a mesh in a form: `text`, `float` and `double` for binary sections, or `h5`."""
    rows, sides, zones = faces(cells, patches)
    kinds = [KINDS[kind] for kind, ids in cells.items() for _ in ids]
    (_h5 if form == "h5" else _sections)(path, points, rows, sides, zones, kinds, form, **how)


def _sections(path, points, rows, sides, zones, kinds, form, *, is_turned=False, cuts=(), end="\n"):
    (n, d), count = points.shape, len(kinds)
    width = {"text": 0, "float": 2000, "double": 3000}[form]
    counts = f"(10 (0 1 {n:x} 0 {d}))\n(12 (0 1 {count:x} 0))\n(13 (0 1 {len(rows):x} 0))\n"
    text = [
        f'(0 "a mesh) (in text")\n(2 {d})\n{counts}(12 (1 1 {count:x} 1 0)(\n{" ".join(map(str, kinds))}\n))\n'.encode()
    ]
    for k, (a, b) in enumerate(itertools.pairwise((0, *cuts, n))):
        head = f"({10 + width} ({40 + k:x} {a + 1:x} {b:x} 1 {d})(".encode()
        if width:
            body = points[a:b].astype("<f4" if form == "float" else "<f8").tobytes()
            text.append(head + body + b")\nEnd of Binary Section   %d)\n" % (10 + width))
        else:
            text.append(
                head
                + b"\n"
                + "".join(" ".join(map(repr, row)) + "\n" for row in points[a:b].tolist()).encode()
                + b"))\n"
            )
    first = 1
    for k, (_, _, kind, chosen) in enumerate(zones):
        head = f"({13 + width} ({2 + k:x} {first:x} {first + len(chosen) - 1:x} {kind:x} 0)("
        words = [
            [len(rows[f]), *(rows[f][::-1] if is_turned else rows[f]), *sides[f]] for f in chosen
        ]
        first += len(chosen)
        if width:
            body = np.array([word for row in words for word in row], "<i4").tobytes()
            text.append(head.encode() + body + b")\nEnd of Binary Section   %d)\n" % (13 + width))
        else:
            text.append(
                f"{head}\n{''.join(' '.join(f'{word:x}' for word in row) + chr(10) for row in words)}))\n".encode()
            )
    for k, (name, kind, *_) in enumerate(zones):
        text.append(f"({45 if k % 2 else 39} ({2 + k} {kind} {name})((a . 1)(b . #f)))\n".encode())
    text.append(b"(45 (1 fluid fluid)())\n")
    path.write_bytes(
        b"".join(text).replace(b"\n", end.encode()) if form == "text" else b"".join(text)
    )


def _h5(path, points, rows, sides, zones, kinds, form, *, real="f8"):
    count = len(kinds)
    order = np.concatenate([chosen for *_, chosen in zones])
    ends = np.cumsum([0, *(len(chosen) for *_, chosen in zones)])
    with h5py.File(path, "w") as file:
        mesh = file.create_group("meshes/1")
        file.create_group("settings")
        sizes = {"cellOffset": 0, "faceOffset": 0, "nodeOffset": 0, "dimension": points.shape[1]}
        sizes |= {"cellCount": count, "faceCount": len(rows), "nodeCount": len(points)}
        for name, value in sizes.items():
            mesh.attrs[name] = np.array([value], "i4")

        def section(path, values):
            data = mesh.create_dataset(path, data=values)
            data.attrs["minId"], data.attrs["maxId"] = (
                np.array([1], "u8"),
                np.array([len(values)], "u8"),
            )

        section("nodes/coords/1", points.astype(real))
        nodes = mesh.create_group("faces/nodes/1")
        nodes.attrs["minId"], nodes.attrs["maxId"] = (
            np.array([1], "u8"),
            np.array([len(rows)], "u8"),
        )
        nodes["nnodes"] = np.array([len(rows[f]) for f in order], "i2")
        nodes["nodes"] = np.concatenate([rows[f] for f in order]).astype("u4")
        section("faces/c0/1", sides[order, 0].astype("u4"))
        section("faces/c1/1", sides[order[: len(zones[0][3])], 1].astype("u4"))
        tables = {
            "faces": (
                [name for name, *_ in zones],
                ends[:-1] + 1,
                ends[1:],
                [k for *_, k, _ in zones],
            )
        }
        tables |= {
            "cells": (["fluid"], [1], [count], [1]),
            "nodes": (["nodes"], [1], [len(points)], [1]),
        }
        for what, (names, first, last, types) in tables.items():
            zone = mesh.create_group(f"{what}/zoneTopology")
            zone.attrs["nZones"] = np.array([len(names)], "u8")
            zone["name"] = np.array([";".join(names).encode()])
            zone["id"] = np.arange(1, len(names) + 1, dtype="i4")
            for name, values in (
                ("minId", first),
                ("maxId", last),
                ("zoneType", types),
                ("dimension", [3] * len(names)),
            ):
                zone[name] = np.array(values, "u8")
            for name in (
                "faceType",
                "cellType",
                "childZoneId",
                "shadowZoneId",
                "c0",
                "c1",
                "flags",
            ):
                zone[name] = np.zeros(len(names), "i4")
        types = mesh.create_group("cells/ctype/1")
        for name, value in (("minId", 1), ("maxId", count), ("elementType", 0)):
            types.attrs[name] = np.array([value], "i2" if name == "elementType" else "u8")
        types["cell-types"] = np.array(kinds, "i2")
        for what in ("cells/ctype", "nodes/coords", "faces/nodes", "faces/c0", "faces/c1"):
            mesh[what].attrs["nSections"] = np.array([1], "u8")
