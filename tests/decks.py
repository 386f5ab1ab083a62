"""Hexahedra and a patch in files of Abaqus, I-deas, Medit, AFLR and gmsh, whose nodes stand in any order."""

import pathlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

ORDERS = ("plain", "first", "last", "falling", "twice")
"""Nodes 1, 2, 3, ...; with copies that no cell has before or behind them; ..., 3, 2, 1; one of them twice."""


class Deck(NamedTuple):
    """Labels (n,) and places of nodes in the order of the file, cells (k, 8) and faces (f, 4) by label."""

    labels: np.ndarray
    points: np.ndarray
    cells: np.ndarray
    faces: np.ndarray


def in_order(order: str, points: np.ndarray, cells: np.ndarray, faces: np.ndarray) -> Deck:
    n = len(points)
    rows = np.tile(np.arange(n), 2 if order in ("first", "last") else 1)
    labels = 1 + np.arange(len(rows))
    first = n if order == "first" else 0
    if order == "falling":
        labels = labels[::-1]
    if order == "twice":
        rows = np.append(rows, 0)
        labels = np.append(labels, 1)
    return Deck(labels, points[rows], labels[first + cells], labels[first + faces])


def table(rows: np.ndarray, form: str = " ") -> str:
    return "".join(form.join(map(repr, row)) + "\n" for row in np.asarray(rows).tolist())


def inp(path: pathlib.Path, deck: Deck) -> None:
    """In two sections of nodes, with comments, small letters and what belongs to a solver."""
    nodes = [
        f"{label}, {', '.join(map(repr, point))}\n"
        for label, point in zip(deck.labels.tolist(), deck.points.tolist(), strict=True)
    ]
    shells = np.column_stack([1000 + np.arange(len(deck.faces)), deck.faces])
    solids = np.column_stack([1 + np.arange(len(deck.cells)), deck.cells])
    text = "*Heading\n a deck, 1\n** comment\n*NODE\n" + "".join(nodes[:5]) + "** more, 1, 2\n"
    text += "".join(nodes[5:9]) + "*node, nset=Rest\n" + "".join(nodes[9:])
    text += "*Element, type=c3d8r,\n elset=Box\n" + table(solids, ", ")
    text += "*ELEMENT, TYPE=S4, ELSET=floor\n" + table(shells, ", ")
    path.write_text(text + "*Material, name=steel\n*Elastic\n2.1e11, 0.3\n*End Step\n")


def unv(path: pathlib.Path, deck: Deck) -> None:
    """With units, and a group in dataset 2467."""
    text = "    -1\n   164\n         1SI\n    -1\n    -1\n  2411\n"
    for label, point in zip(deck.labels.tolist(), deck.points.tolist(), strict=True):
        text += f"{label:10d}{1:10d}{1:10d}{11:10d}\n"
        text += "".join(f"{x:25.16E}" for x in point).replace("E", "D") + "\n"
    text += "    -1\n    -1\n  2412\n"
    elements = [(94, row) for row in deck.faces.tolist()] + [
        (115, row) for row in deck.cells.tolist()
    ]
    for label, (kind, row) in enumerate(elements, start=1):
        head = (label, kind, 1, 1, 7, len(row))
        text += "".join(f"{word:10d}" for word in head) + "\n"
        text += "".join(f"{word:10d}" for word in row) + "\n"
    text += "    -1\n    -1\n  2467\n" + "".join(f"{k:10d}" for k in (1, 0, 0, 0, 0, 0, 0))
    members = [f"{8:10d}{1 + k:10d}{0:10d}{0:10d}" for k in range(len(deck.faces))]
    text += f"{len(members):10d}\nfloor\n"
    text += "".join("".join(members[k : k + 2]) + "\n" for k in range(0, len(members), 2))
    path.write_text(text + "    -1\n")


def mesh(path: pathlib.Path, deck: Deck) -> None:
    """Medit in text, with comments and a section of another program."""
    numbered = [f"{' '.join(map(repr, point))} 0\n" for point in deck.points.tolist()]
    text = "MeshVersionFormatted 2\n# a comment, 3 4\nDimension\n3\n\nVertices\n"
    text += f"{len(numbered)}\n{''.join(numbered[:3])}# more 1 2\n{''.join(numbered[3:])}"
    text += f"Corners\n1\n1\nQuadrilaterals {len(deck.faces)}\n"
    text += table(np.insert(deck.faces, 4, 2, axis=1)) + f"Hexahedra\n{len(deck.cells)}\n"
    path.write_text(text + table(np.insert(deck.cells, 8, 1, axis=1)) + "End\n")


def meshb(version: int, order: str = "<") -> Callable[[pathlib.Path, Deck], None]:
    whole = f"{order}i{8 if version == 4 else 4}"
    place = f"{order}i{8 if version > 2 else 4}"
    real = f"{order}f{4 if version == 1 else 8}"

    def write(path: pathlib.Path, deck: Deck) -> None:
        rows = np.zeros(len(deck.points), [("x", real, 3), ("number", whole)])
        rows["x"] = deck.points
        parts = [(4, len(rows), rows.tobytes()), (13, 1, np.array([1], whole).tobytes())]
        for code, corners, number in ((7, deck.faces, 2), (10, deck.cells, 1)):
            numbers = np.insert(corners, corners.shape[1], number, axis=1)
            parts.append((code, len(corners), numbers.astype(whole).tobytes()))
        data = np.array([1, version, 3], f"{order}i4").tobytes()
        width = np.dtype(place).itemsize
        data += (
            np.array([len(data) + width + 4], place).tobytes()
            + np.array([3], f"{order}i4").tobytes()
        )
        for code, count, content in parts:
            stop = len(data) + 4 + width + np.dtype(whole).itemsize + len(content)
            data += np.array([code], f"{order}i4").tobytes() + np.array([stop], place).tobytes()
            data += np.array([count], whole).tobytes() + content
        path.write_bytes(
            data + np.array([54], f"{order}i4").tobytes() + np.array([0], place).tobytes()
        )

    return write


def ugrid(path: pathlib.Path, deck: Deck) -> None:
    """In text."""
    counts = [[len(deck.points), 0, len(deck.faces), 0, 0, 0, len(deck.cells)]]
    numbers = np.full((len(deck.faces), 1), 2)
    path.write_text("".join(map(table, (counts, deck.points, deck.faces, numbers, deck.cells))))


def binary_ugrid(path: pathlib.Path, deck: Deck) -> None:
    """As the name says: .lb8.ugrid, little-endian and of 8 bytes; .r4.ugrid, big-endian records."""
    form = path.name.split(".")[-2]
    order = "<" if form.startswith("l") else ">"
    whole = f"{order}i{8 if form.endswith('l') else 4}"
    counts = np.array([len(deck.points), 0, len(deck.faces), 0, 0, 0, len(deck.cells)], whole)
    body = deck.points.astype(f"{order}f{8 if '8' in form else 4}").tobytes()
    body += deck.faces.astype(whole).tobytes() + np.full(len(deck.faces), 2, whole).tobytes()
    body += deck.cells.astype(whole).tobytes()
    records = [counts.tobytes(), body]
    if "r" in form:
        marks = [np.array([len(record)], f"{order}i4").tobytes() for record in records]
        records = [mark + record + mark for mark, record in zip(marks, records, strict=True)]
    path.write_bytes(b"".join(records))


def msh(path: pathlib.Path, deck: Deck) -> None:
    """gmsh's version 2.2 in text."""
    nodes = table(np.column_stack([deck.labels.astype(object), deck.points.astype(object)]))
    faces = [[k, 3, 2, 1, 1, *row] for k, row in enumerate(deck.faces.tolist(), start=1)]
    cells = [[100 + k, 5, 2, 2, 2, *row] for k, row in enumerate(deck.cells.tolist())]
    text = (
        '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n2 1 "floor"\n$EndPhysicalNames\n'
    )
    text += f"$Nodes\n{len(deck.points)}\n{nodes}$EndNodes\n$Elements\n{len(faces) + len(cells)}\n"
    rows = "".join(" ".join(map(str, row)) + "\n" for row in faces + cells)
    path.write_text(text + rows + "$EndElements\n")


WRITERS = {
    **{".inp": inp, ".unv": unv, ".mesh": mesh, ".ugrid": ugrid, ".msh": msh},
    **{f".v{version}.meshb": meshb(version) for version in (1, 2, 3, 4)},
    ".big.meshb": meshb(2, ">"),
    **dict.fromkeys(
        [f".{form}.ugrid" for form in ("b8", "lb8", "b4", "lb4", "lb8l")], binary_ugrid
    ),
    **dict.fromkeys([f".{form}.ugrid" for form in ("r8", "lr8", "lr4")], binary_ugrid),
}
"""Writers by the ending of the file."""
LABELLED = (".inp", ".unv", ".msh")
"""Kinds in which nodes have labels; in others they have their place in the file."""
TEXTS = (".inp", ".unv", ".mesh")
"""Kinds whose text `places` reads."""
SINGLE = (".v1.meshb", ".b4.ugrid", ".lb4.ugrid", ".lr4.ugrid")
"""Kinds in single precision."""


def places(path: pathlib.Path) -> np.ndarray:
    """Reads the coordinates in a text of `inp`, `unv` or `mesh`, line by line."""
    rows = []
    inside = path.suffix == ".unv"
    lines = [line for line in path.read_text().splitlines() if line[:2] != "**" and line[:1] != "#"]
    for line in lines:
        words = line.replace(",", " ").replace("D", "E").split()
        if line[:1].isalpha() or line[:1] == "*":
            inside = line.lower().startswith(("*node", "vertices"))
        elif inside and len(words) == (3 if path.suffix == ".unv" else 4):
            rows.append(list(map(float, words[1:] if path.suffix == ".inp" else words[:3])))
    return np.array(rows)
