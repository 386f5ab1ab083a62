"""OpenFOAM's files, ascii or binary, plain or compressed: numbers, patches, checked faces."""

import collections
import itertools
import pathlib
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.package.files import unpack
from jaxmorph._host.ragged import Ragged
from jaxmorph._host.rows import join_ids
from jaxmorph._mesh.faces import Faces, open_cells

from .._text import decoded, line_chunks, parse

_LIST = re.compile(rb"(?:\s|//[^\n]*+|/\*.*?(?:\*/|\Z))*+(\d{0,19})(?!\d)\s*([({]?)", re.DOTALL)
_LIST_END = re.compile(rb"\)(?:[\s;]|//[^\n]*+)*+\Z")
_FOAM_HEADER = re.compile(rb"FoamFile\s*\{(.*?)\}", re.DOTALL)
_COMMENT = re.compile(r"//[^\n]*|/\*.*?(?:\*/|\Z)", re.DOTALL)
_WORD = re.compile(r'"[^"\n]*"|[(){};]|[^\s(){};"]+|"')
UNIFORM = 2 * 10**8
"""Bytes of an unpacked list of equal elements, besides ten times its file's size."""
PARENTHESES = bytes.maketrans(b"()", b"  ")
FOAM_NUMBERS = {"label": np.int64, "scalar": np.float64}


class List(NamedTuple):
    """Locates a list: `size` elements (-1: not said) from `start`; `uniform` holds one for all."""

    size: int
    start: int
    uniform: bool


class FoamFile(NamedTuple):
    """A file of a mesh: `raw` as on disk, `data` unpacked, its header, and the header's end."""

    path: pathlib.Path
    raw: bytes
    data: bytes
    header: dict[str, str]
    end: int

    @property
    def is_binary(self) -> bool:
        return self.header.get("format", "ascii") == "binary"

    def dtype(self, what: str) -> np.dtype:
        """Type of a binary `label` or `scalar`: by `arch`, else little-endian, 32 and 64 bits."""
        arch = self.header.get("arch", "")
        match = re.search(rf"{what}=(\d{{1,9}})", arch)
        width = int(match[1]) if match else {"label": 32, "scalar": 64}[what]
        if width not in (32, 64):
            raise self.error(f"{what}s of {width} bits are not known; arch is {arch!r}")
        return np.dtype(
            f"{'>' if 'MSB' in arch else '<'}{'i' if what == 'label' else 'f'}{width // 8}"
        )

    def error(self, message: str) -> ValueError:
        return ValueError(f"{self.path}: {message}.")

    def list_at(self, at: int) -> List:
        match = _LIST.match(self.data, at)
        if match is None or not (match[1] or match[2]):
            raise self.error(f"a list expected, found {self.data[at : at + 20].lstrip()!r}")
        return List(int(match[1] or -1) if match[2] else 0, match.end(), match[2] == b"{")

    def end_of_text(self, start: int) -> int:
        """Finds the last parenthesis, before at most 64 KiB of comments at the end of the file."""
        found = _LIST_END.search(self.data, max(start, len(self.data) - (1 << 16)))
        return found.start() if found else start

    def numbers(self, what: str, width: int = 1) -> ndarray:
        """Reads the list of `label`s or `scalar`s: (count, width), as int32 or float64."""
        items = self.list_at(self.end)
        if items.uniform and items.size * width * 8 > UNIFORM + 10 * len(self.raw):
            raise self.error(f"{items.size} elements that are all equal; a mesh has no such list")
        if self.is_binary:
            values = _narrow(self.binary(items, what, width)[0])
        else:
            stop = (
                self.data.find(b"}", items.start)
                if items.uniform
                else self.end_of_text(items.start)
            )
            values = self._parsed(items, stop if items.size else items.start, FOAM_NUMBERS[what])
        if items.uniform and len(values) == width:
            values = np.tile(values, items.size)
        if len(values) % width or items.size not in (-1, len(values) // width):
            raise self.error(
                f"{items.size} elements of {width} {what}s expected, found {len(values)} numbers"
            )
        return values.reshape(-1, width)

    def _parsed(self, items: List, stop: int, kind: type, mark: bytes = b" ") -> ndarray:
        """Reads the numbers of a text list; `mark` takes the place of opening parentheses."""
        parts = [_narrow(np.zeros(0, kind))]
        for chunk in line_chunks(self.data, items.start, stop):
            parts.append(_narrow(parse(chunk.replace(b"(", mark).translate(PARENTHESES), kind)))
        return np.concatenate(parts)

    def binary(self, items: List, what: str, width: int = 1) -> tuple[ndarray, int]:
        """Views the numbers of a binary list, one element if it is uniform; tells where it ends."""
        dtype = self.dtype(what)
        stored = width * (1 if items.uniform else items.size)
        if items.size == 0:
            return np.zeros(0, dtype), items.start
        end = items.start + stored * dtype.itemsize
        if items.size < 0 or self.data[end : end + 1] not in (b")", b"}"):
            message = (
                f"{items.size} elements of {width} {what}s of {dtype.itemsize} bytes do not fit "
                "the file"
            )
            raise self.error(
                f"{message}; it is cut short, or its header's arch ({self.header.get('arch')}) is "
                "wrong"
            )
        return np.frombuffer(self.data, dtype, stored, items.start), end + 1

    def faces(self) -> Ragged:
        if not self.is_binary:
            return self._text_faces()
        if "Compact" not in self.header.get("class", ""):
            return self._separate_faces()
        starts, end = self.binary(self.list_at(self.end), "label")
        labels, _ = self.binary(self.list_at(end), "label")
        rows = Ragged(_narrow(labels), starts.astype(np.int64))
        if starts[[0, -1][: len(starts)]].tolist() != [0, len(labels)] or (rows.sizes < 3).any():
            raise self.error(f"the offsets of the faces do not fit their {len(labels)} labels")
        return rows

    def _separate_faces(self) -> Ragged:
        """Reads a binary list of lists of older versions: faces with their counts, in turn."""
        items = self.list_at(self.end)
        at = items.start
        parts = []
        for face in range(items.size):
            labels, at = self.binary(self.list_at(at), "label")
            if len(labels) < 3:
                raise self.error(f"face {face} has {len(labels)} labels; it needs 3 at least")
            parts.append(labels)
        return Ragged.of(_narrow(join_ids(parts)), list(map(len, parts)))

    def _text_faces(self) -> Ragged:
        # Opening parentheses become the number -1: behind the count of a face, before its labels.
        items = self.list_at(self.end)
        values = self._parsed(items, self.end_of_text(items.start), np.int64, b" -1 ")
        begins = np.flatnonzero(values == -1)
        sizes = np.diff(begins, append=len(values) + 1) - 2
        fits = items.size in (-1, len(begins)) and (begins > 0).all()
        if not fits or (values[begins - 1] != sizes).any() or (sizes < 3).any():
            raise self.error(
                f"{items.size} faces expected, each as 4(0 1 2 3); found {len(begins)}, or other "
                "numbers of labels"
            )
        return Ragged.of(np.delete(values, np.concatenate([begins - 1, begins])), sizes)


def _narrow(values: ndarray) -> ndarray:
    """Takes labels to int32, unless they are too large for it, and scalars to float64."""
    if values.dtype.kind == "f":
        return values.astype(float, copy=False)
    return values.astype(np.int32 if not len(values) or values.max() < 2**31 else np.int64)


def load_file(folder: pathlib.Path, name: str) -> FoamFile:
    path = folder / name
    if not path.is_file() and path.with_name(f"{name}.gz").is_file():
        path = path.with_name(f"{name}.gz")
    with unpack(path) as plain:
        raw = path.read_bytes()
        data = plain.read_bytes()
    match = _FOAM_HEADER.search(data, 0, 1 << 14)
    if match is None:
        raise ValueError(f"{path}: no FoamFile header; it is not a file of OpenFOAM.")
    header = {
        key: " ".join(values).strip('"')
        for key, *values in _split_statements(parse_nested(match[1]))
    }
    return FoamFile(path, raw, data, header, match.end())


class FoamPatch(NamedTuple):
    """An entry of `boundary`: `size` faces from `start` on.

    `groups` has it in its `inGroups`, and `neighbour` is its `neighbourPatch`. `refers` is the
    cyclic patch of a `processorCyclic` one. Both are "" for others. `part` is the processor on the
    other side, or -1.
    """

    name: str
    type: str
    start: int
    size: int
    groups: tuple[str, ...] = ()
    neighbour: str = ""
    refers: str = ""
    part: int = -1

    @property
    def end(self) -> int:
        return self.start + self.size

    @property
    def faces(self) -> ndarray:
        return np.arange(self.start, self.end)

    @property
    def is_between(self) -> bool:
        return self.type == "processor"


Boundary = list[FoamPatch]


def read_patches(file: FoamFile) -> Boundary:
    """Reads a `boundary`'s patches: `2 ( inlet { type patch; nFaces 4; startFace 8; } ... )`."""
    tree = parse_nested(file.data[file.end :])
    _refuse_directives(file, tree)
    stated = int(tree.pop(0)) if re.fullmatch(r"\d{1,19}", str(*tree[:1])) else None
    if tree[:1] != ["("]:
        raise file.error(
            "a list of patches expected, such as 1 ( wall { type wall; nFaces 4; startFace 8; } )"
        )
    end = tree.index(")") if ")" in tree else len(tree)
    found = [
        _read_patch(file, str(name), body)
        for name, body in itertools.zip_longest(tree[1:end:2], tree[2:end:2])
    ]
    name, count = collections.Counter(["", *(patch.name for patch in found)]).most_common(1)[0]
    if count > 1:
        raise file.error(f"{count} patches are called {name}; each needs a name of its own")
    if end == len(tree) or stated not in (None, len(found)):
        end_of_list = "" if end < len(tree) else " and no end of the list"
        raise file.error(f"{stated} patches announced, {len(found)} read{end_of_list}")
    return found


def _refuse_directives(file: FoamFile, words: list[Any]) -> None:
    """Raises `ValueError` for `#include`, `#calc` and `$name`, which a solver replaces by text."""
    for word in words:
        if str(word).startswith(("#", "$")):
            raise file.error(
                f"{word[:40]} is not read, nor are other directives and variables: "
                "`foamDictionary -expand` prints "
                "the file without them"
            )


def parse_nested(data: bytes) -> list[Any]:
    """Lists the words of a text; those between braces are a list of their own."""
    stack: list[list[Any]] = [[]]
    for word in _WORD.findall(_COMMENT.sub(" ", decoded(data))):
        if word == "{":
            stack.append([])
        elif word == "}" and len(stack) > 1:
            inner = stack.pop()
            stack[-1].append(inner)
        else:
            stack[-1].append(word)
    return stack[0]


def _split_statements(words: list[Any]) -> Iterator[list[str]]:
    """Yields the words of each entry `key word word;`, and the key of each dictionary."""
    statement: list[str] = []
    for word in words:
        if word != ";" and not isinstance(word, list):
            statement.append(word)
        elif statement:
            yield statement
            statement = []


def _read_patch(file: FoamFile, name: str, body: Any) -> FoamPatch:
    if not isinstance(body, list):
        raise file.error(
            f"patch {name[:80]} has no entries between {{ and }}; is the file cut short?"
        )
    entries = {key: words for key, *words in _split_statements(body)}
    firsts = {key: words[0].strip('"') for key, words in entries.items() if words}
    _refuse_directives(
        file, [*entries, *(firsts.get(key) for key in ("type", "nFaces", "startFace"))]
    )
    groups = entries.get("inGroups", [])  # List<word> 2(wall wing), or (wall wing)
    groups = groups[groups.index("(") + 1 : -1] if "(" in groups else []
    try:
        return FoamPatch(
            name=name.strip('"'),
            type=firsts["type"],
            start=int(firsts["startFace"]),
            size=int(firsts["nFaces"]),
            groups=tuple(word.strip('"') for word in groups),
            neighbour=firsts.get("neighbourPatch", ""),
            refers=firsts.get("referPatch", ""),
            part=int(firsts.get("neighbProcNo", -1)),
        )
    except (KeyError, ValueError) as error:
        raise file.error(
            f"patch {name[:80]} has no good type, nFaces and startFace ({error})"
        ) from error


def load_faces(folder: pathlib.Path, boundary: Boundary, n: int) -> Faces:
    """Reads `faces`, `owner` and `neighbour`. Raises `ValueError` where they close no cells."""
    rows = load_file(folder, "faces").faces()
    owner, neighbour = (
        load_file(folder, name).numbers("label").ravel() for name in ("owner", "neighbour")
    )
    if len(owner) != len(rows) or len(neighbour) > len(owner) or not len(owner):
        counts = f"{len(rows)} faces, {len(owner)} owners and {len(neighbour)} neighbours"
        raise ValueError(f"{folder}: faces, owner and neighbour do not fit together: {counts}.")
    _check_labels(folder, rows.values, n, owner, neighbour)
    faces = Faces(rows.values, rows.starts, owner, neighbour[neighbour >= 0])
    counts = np.bincount(np.concatenate([owner, faces.neighbour]))
    if counts.min() < 4:
        raise ValueError(
            f"{folder}: cell {counts.argmin()} has {counts.min()} faces; a cell needs 4 at least."
        )
    _check_patches(folder / "boundary", boundary, faces)
    ajar = open_cells(faces)
    if len(ajar):
        raise ValueError(
            f"{folder}: {len(ajar)} cells do not close, first cell {ajar[0]}: a damaged file."
        )
    return faces


def _check_labels(
    folder: pathlib.Path, labels: ndarray, n: int, owner: ndarray, neighbour: ndarray
) -> None:
    """Raises `ValueError` for labels that cannot be, before one of them sizes an array.

    Each cell has four faces and each face two cells at most. Outer faces have no neighbour: older
    versions write -1 for them, at the end of the list.
    """
    inner = int((neighbour >= 0).sum())
    count = len(owner)
    most = f"which is none: {count} faces make {count // 2} cells at most"
    has_none = neighbour < (-1 if len(neighbour) == count else 0)
    has_none[:inner] |= neighbour[:inner] < 0
    if labels.min() < 0 or labels.max() >= n:
        bad = labels.min() if labels.min() < 0 else labels.max()
        raise ValueError(
            f"{folder / 'faces'}: a face names node {bad}, but there are points 0 to {n - 1}."
        )
    for name, cells, wrong, what in (
        ("neighbour", neighbour, has_none | (neighbour > count // 2), most),
        ("owner", owner, (owner < 0) | (owner > count // 2), most),
        ("neighbour", owner, owner[:inner] == neighbour[:inner], "which is on both of its sides"),
    ):
        if wrong.any():
            face = wrong.argmax()
            raise ValueError(f"{folder / name}: face {face} is of cell {cells[face]}, {what}.")


def _check_patches(file: pathlib.Path, boundary: Boundary, faces: Faces) -> None:
    count = len(faces.owner)
    inner = len(faces.neighbour)
    times = np.zeros(count, dtype=np.int64)
    for patch in boundary:
        if patch.size < 0 or patch.start < 0 or patch.end > count:
            raise ValueError(
                f"{file}: patch {patch.name!r} is faces {patch.start} to {patch.end - 1} of "
                f"{count}."
            )
        times[patch.start : patch.end] += 1
    wrong = np.flatnonzero(times != (np.arange(count) >= inner))
    if wrong.size:
        face = int(wrong[0])
        where = "an inner face" if wrong[0] < inner else "an outer face"
        raise ValueError(
            f"{file}: {wrong.size} faces are in the wrong number of patches; face {face}, "
            f"{where}, is in {times[face]}."
        )
