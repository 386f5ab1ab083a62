"""OpenFOAM's files: header, lists of numbers and of faces, ascii or binary, plain or compressed."""

import collections
import dataclasses
import gzip
import io
import pathlib
import re
import zlib

import numpy as np

from .._text import chunks, parse, scan

_SPACE = re.compile(rb"(?:\s+|//[^\n]*|/\*.*?(?:\*/|\Z))*", re.DOTALL)
_HEADER = re.compile(rb"FoamFile\s*\{(.*?)\}", re.DOTALL)
_COUNT = re.compile(rb"(\d*)\s*([({]?)")
_COMMENT = re.compile(r"//[^\n]*|/\*.*?(?:\*/|\Z)", re.DOTALL)
_WORD = re.compile(r'"[^"\n]*"|[(){};]|[^\s(){};"]+|"')
UNIFORM = 2 * 10**8
"""Bytes of an unpacked list of equal elements, besides ten times its file's size."""
UNPACKED = 100
"""Unpacked bytes per byte of a packed file, besides `UNIFORM`."""
DIGITS = 19
"""Digits of a number of elements."""
PARENTHESES = bytes.maketrans(b"()", b"  ")


@dataclasses.dataclass(frozen=True)
class List:
    """Locates a list: `count` elements (-1: not said) from `start`; `uniform` holds one for all."""

    count: int
    start: int
    uniform: bool


@dataclasses.dataclass(frozen=True, eq=False)
class FoamFile:
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
        return np.dtype(f"{'>' if 'MSB' in arch else '<'}{'i' if what == 'label' else 'f'}{width // 8}")

    def error(self, message: str) -> ValueError:
        return ValueError(f"{self.path}: {message}.")

    def list_at(self, at: int) -> List:
        space = _SPACE.match(self.data, at)
        at = space.end() if space else at
        match = _COUNT.match(self.data, at)
        if match is None or not match[0] or len(match[1]) > DIGITS:
            raise self.error(f"a list expected, found {self.data[at : at + 20]!r}")
        count = int(match[1]) if match[1] else -1
        return List(count if match[2] else 0, match.end(), match[2] == b"{")

    def end_of_text(self, start: int) -> int:
        """Finds the last parenthesis after `start`, before the comments at the end of the file."""
        stop = len(self.data)
        while stop > start:
            line = max(self.data.rfind(b"\n", start, stop), start)
            comment = self.data.find(b"//", line, stop)
            if comment < 0 and self.data[line:stop].strip():
                break
            stop = max(comment, line)
        return self.data.rfind(b")", start, stop)

    def numbers(self, what: str, width: int = 1) -> np.ndarray:
        """Reads the list of `label`s or `scalar`s: (count, width), as int32 or float64."""
        items = self.list_at(self.end)
        if items.uniform and items.count * width * 8 > UNIFORM + 10 * len(self.raw):
            raise self.error(f"{items.count} elements that are all equal; a mesh has no such list")
        if self.is_binary:
            values = self.binary(items, what, width)[0]
            return (_narrow(values) if what == "label" else values.astype(float)).reshape(-1, width)
        values = self._text_numbers(items, what)
        if items.uniform and len(values) == width:
            values = np.tile(values, items.count)
        if len(values) % width or items.count not in (-1, len(values) // width):
            raise self.error(f"{items.count} elements of {width} {what}s expected, found {len(values)} numbers")
        return values.reshape(-1, width)

    def _text_numbers(self, items: List, what: str) -> np.ndarray:
        kind = np.int64 if what == "label" else np.float64
        stop = self.data.find(b"}", items.start) if items.uniform else self.end_of_text(items.start)
        parts = [_narrow(np.zeros(0, kind)) if what == "label" else np.zeros(0, kind)]
        for chunk in chunks(self.data, items.start, stop if items.count else items.start):
            values = parse(chunk.translate(PARENTHESES), kind)
            parts.append(_narrow(values) if what == "label" else values)
        return np.concatenate(parts)

    def binary(self, items: List, what: str, width: int = 1) -> tuple[np.ndarray, int]:
        """Views the numbers of a binary list, not copied, and tells where it ends."""
        dtype = self.dtype(what)
        count = items.count * width
        stored = width if items.uniform else count
        end = items.start + stored * dtype.itemsize
        if items.count == 0:
            return np.zeros(0, dtype), items.start
        if items.count < 0 or end >= len(self.data) or self.data[end : end + 1] not in (b")", b"}"):
            message = f"{items.count} elements of {width} {what}s of {dtype.itemsize} bytes do not fit the file"
            raise self.error(f"{message}; it is cut short, or its header's arch ({self.header.get('arch')}) is wrong")
        values = np.frombuffer(self.data, dtype, stored, items.start)
        return (np.tile(values, items.count) if items.uniform else values), end + 1

    def faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Reads the labels of all faces, and where each face begins (one more at the end)."""
        if not self.is_binary:
            return self._text_faces()
        if "Compact" not in self.header.get("class", ""):
            return self._separate_faces()
        starts, end = self.binary(self.list_at(self.end), "label")
        labels, _ = self.binary(self.list_at(end), "label")
        starts = starts.astype(np.int64)
        if not len(starts) or starts[0] or starts[-1] != len(labels) or (np.diff(starts) < 3).any():
            raise self.error(f"the offsets of the faces do not fit their {len(labels)} labels")
        return _narrow(labels), starts

    def _separate_faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Reads a binary list of lists of older versions: faces with their counts, in turn."""
        items = self.list_at(self.end)
        at, parts = items.start, [np.zeros(0, self.dtype("label"))]
        for _ in range(items.count):
            labels, at = self.binary(self.list_at(at), "label")
            parts.append(labels)
        sizes = np.array([len(part) for part in parts])
        short = np.flatnonzero(sizes[1:] < 3)
        if len(short):
            raise self.error(f"face {short[0]} has {sizes[1 + short[0]]} labels; it needs 3 at least")
        return _narrow(np.concatenate(parts)), np.cumsum(sizes)

    def _text_faces(self) -> tuple[np.ndarray, np.ndarray]:
        # Numbers right before a parenthesis are counts of labels, which are taken out at the end.
        items = self.list_at(self.end)
        words, before, done = [np.zeros(0, np.int32)], [np.zeros(0, np.int64)], 0
        for chunk in chunks(self.data, items.start, self.end_of_text(items.start)):
            plain = chunk.translate(PARENTHESES)
            opens = np.flatnonzero(np.frombuffer(chunk, np.uint8) == ord("("))
            starts = scan(plain)[0]
            before.append(done + np.searchsorted(starts, opens))
            words.append(_narrow(parse(plain, np.int64)))
            done += len(starts)
        values, begins = np.concatenate(words), np.concatenate(before)
        sizes = np.diff(begins, append=done + 1) - 1
        fits = len(values) == done and (begins > 0).all() and items.count in (-1, len(begins))
        if not fits or (values[begins - 1] != sizes).any() or (sizes < 3).any():
            raise self.error(
                f"{items.count} faces expected, each as 4(0 1 2 3); found {len(begins)}, or other numbers of labels"
            )
        return np.delete(values, begins - 1), np.append(0, np.cumsum(sizes))


def _narrow(labels: np.ndarray) -> np.ndarray:
    return labels.astype(np.int32 if not len(labels) or labels.max() < 2**31 else np.int64)


def load(folder: pathlib.Path, name: str) -> FoamFile:
    path = folder / name
    if not path.is_file() and path.with_name(f"{name}.gz").is_file():
        path = path.with_name(f"{name}.gz")
    raw = path.read_bytes()
    try:
        data = _unpacked(path, raw) if path.suffix == ".gz" else raw
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: a damaged gzip file ({error}).") from error
    match = _HEADER.search(data, 0, 1 << 14)
    if match is None:
        raise ValueError(f"{path}: no FoamFile header; it is not a file of OpenFOAM.")
    header = {key: " ".join(values).strip('"') for key, values in _entries(_words(match[1])).items()}
    return FoamFile(path, raw, data, header, match.end())


def _unpacked(path: pathlib.Path, raw: bytes) -> bytes:
    limit = UNIFORM + UNPACKED * len(raw)
    with gzip.GzipFile(fileobj=io.BytesIO(raw)) as packed:
        data = packed.read(limit + 1)
    if len(data) > limit:
        raise ValueError(f"{path}: {len(raw)} bytes become more than {limit} when unpacked; no mesh does.")
    return data


@dataclasses.dataclass(frozen=True)
class Patch:
    """An entry of `boundary`: `count` faces from `start` on.

    `groups` has it in its `inGroups`, and `neighbour` is its `neighbourPatch`. `refers` is the
    cyclic patch of a `processorCyclic` one. Both are "" for others. `part` is the processor on the
    other side, or -1.
    """

    name: str
    type: str
    start: int
    count: int
    groups: tuple[str, ...] = ()
    neighbour: str = ""
    refers: str = ""
    part: int = -1

    @property
    def end(self) -> int:
        return self.start + self.count

    @property
    def faces(self) -> np.ndarray:
        return np.arange(self.start, self.end)

    @property
    def is_between(self) -> bool:
        return self.type == "processor"


def patches(file: FoamFile) -> list[Patch]:
    """Reads a `boundary`'s patches: `2 ( inlet { type patch; nFaces 4; startFace 8; } ... )`."""
    words = _words(file.data[file.end :])
    _refuse_directives(file, words[:1])
    head = re.match(rf"(\d{{1,{DIGITS}}} )?\( ", " ".join([*words[:2], ""]))
    if head is None:
        raise file.error("a list of patches expected, such as 1 ( wall { type wall; nFaces 4; startFace 8; } )")
    stated = int(head[1]) if head[1] else None
    found, end = _listed(file, words, 2 if head[1] else 1)
    for name, count in collections.Counter(patch.name for patch in found).most_common(1):
        if count > 1:
            raise file.error(f"{count} patches are called {name}; each needs a name of its own")
    if end == len(words) or stated not in (None, len(found)):
        end_of_list = "" if end < len(words) else " and no end of the list"
        raise file.error(f"{stated} patches announced, {len(found)} read{end_of_list}")
    return found


def _listed(file: FoamFile, words: list[str], at: int) -> tuple[list[Patch], int]:
    found = []
    while at < len(words) and words[at] != ")":
        _refuse_directives(file, words[at : at + 1])
        end = _end_of_body(words, at + 1)
        if end is None:
            raise file.error(f"patch {words[at][:80]} has no entries between {{ and }}; is the file cut short?")
        found.append(_patch(file, words[at], words[at + 2 : end]))
        at = end + 1
    return found, at


def _refuse_directives(file: FoamFile, words: list[str]) -> None:
    """Raises `ValueError` for `#include`, `#calc` and `$name`, which a solver replaces by text."""
    for word in words:
        if word.startswith(("#", "$")):
            raise file.error(
                f"{word[:40]} is not read, nor are other directives and variables: `foamDictionary -expand` prints "
                "the file without them"
            )


def _end_of_body(words: list[str], start: int) -> int | None:
    depth = 0
    for place in range(start, len(words)):
        depth += {"{": 1, "}": -1}.get(words[place], 0)
        if depth <= 0:
            return place if place > start else None
    return None


def _words(data: bytes) -> list[str]:
    return _WORD.findall(_COMMENT.sub(" ", data.decode(errors="replace")))


def _entries(body: list[str]) -> dict[str, list[str]]:
    """Lists the words of each entry `key word word;`, with those of its dictionary, by its key."""
    entries: dict[str, list[str]] = {}
    key, depth = None, 0
    for word in body:
        depth += {"{": 1, "}": -1}.get(word, 0)
        if word == ";" or word == "}":
            key = key if depth else None
        elif key is None:
            key, entries[word] = word, []
        else:
            entries[key].append(word)
    return entries


def _patch(file: FoamFile, name: str, body: list[str]) -> Patch:
    entries = _entries(body)
    firsts = {key: words[0].strip('"') for key, words in entries.items() if words}
    _refuse_directives(file, [*entries, *(firsts.get(key, "") for key in ("type", "nFaces", "startFace"))])
    groups = entries.get("inGroups", [])  # List<word> 2(wall wing), or (wall wing)
    groups = groups[groups.index("(") + 1 : -1] if "(" in groups else []
    try:
        return Patch(
            name.strip('"'),
            firsts["type"],
            int(firsts["startFace"]),
            int(firsts["nFaces"]),
            tuple(word.strip('"') for word in groups),
            firsts.get("neighbourPatch", ""),
            firsts.get("referPatch", ""),
            int(firsts.get("neighbProcNo", -1)),
        )
    except (KeyError, ValueError) as error:
        raise file.error(f"patch {name[:80]} has no good type, nFaces and startFace ({error})") from error
