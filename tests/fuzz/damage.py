"""Reads damaged files, one after the other, under limits of time and memory: `damage.py FORMAT SEED FIRST LAST FOLDER`.

What an accepted file may hold is one law: a damaged byte moves one node, or changes one cell or those of one node, or two patches;
in a table it changes one number. Where a checksum covers it, it changes nothing; in HDF5, ADF and netCDF all that h5py and the
trees find changed may differ, in OpenFOAM's `boundary` and in TOML all. A cut, and a line more or less, is refused, unless what
is left is whole.

A line `at K` precedes mutation K, and a line of JSON tells each wrong answer. A signal ends one that takes too long.
"""

import functools
import gzip
import io
import json
import pathlib
import resource
import signal
import sys
import time
import warnings

import h5py
import jax
import numpy as np
import seeds

from jaxmorph.io import _tree

SECONDS, BYTES, TIMES = 2.0, 200e6, 10
"""Limits: of CPU time, and of memory beyond that of the imports: bytes, and in sizes of the file."""


TREES = (".cgns", ".e", ".med", ".h5")


def mutated(rng: np.random.Generator, data: bytes) -> tuple[str, bytes, int]:
    """Damages a file once; says how, and where."""
    kind = rng.choice(["bit", "byte", "cut", "digit", "line twice", "line less", "number"])
    kind = "byte" if "line" in kind and b"\0" in data else kind  # binary numbers have no lines
    at = int(rng.integers(max(len(data), 1)))
    if kind in ("digit", "number"):
        digits = [k for k, byte in enumerate(data[at : at + 4000], start=at) if 48 <= byte < 58]
        if digits:
            at = digits[int(rng.integers(min(len(digits), 50)))]
            words = [b"-", b"9999999", b"1e9", b"nan", b"", b" ", b"."]
            new = rng.choice(words) if kind == "number" else b"%d" % rng.integers(10)
            return kind, data[:at] + bytes(new) + data[at + 1 :], at
        kind = "cut"
    if kind == "cut":
        return kind, data[:at], at
    if kind in ("bit", "byte"):
        byte = data[at] ^ (1 << int(rng.integers(8))) if kind == "bit" else int(rng.integers(256))
        return kind, data[:at] + bytes([byte]) + data[at + 1 :], at
    lines = data.splitlines(keepends=True)
    row = int(rng.integers(len(lines)))
    at = sum(map(len, lines[:row]))
    return (
        kind,
        b"".join(
            [*lines[:row], *([lines[row]] * 2 if kind == "line twice" else []), *lines[row + 1 :]]
        ),
        at,
    )


def parts(result) -> dict[str, np.ndarray]:
    """The arrays of what a reader returns by name: `points`, `cells KIND`, `patch NAME`; of other things by number."""
    if not hasattr(result, "patches"):
        return {f"array {k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(result))}
    cells = {f"cells {kind}": np.asarray(ids) for kind, ids in result.cells.items()}
    patches = {f"patch {name}": np.asarray(nodes) for name, nodes in result.patches.items()}
    notes = [note for note in result.source.notes if "are not read" in note]
    has_keywords = result.source.path.suffix in (".mesh", ".meshb", ".inp")
    told = {"notes": np.array(notes)} if has_keywords else {}
    return {"points": np.asarray(result.points)} | cells | patches | told


def alike(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return list(a) == list(b) and all(np.array_equal(a[name], b[name]) for name in a)


def content(data: bytes) -> dict[str, str]:
    """Everything in a tree as h5py has it, by path; without the root's own attributes."""
    told = {}

    def visit(name, item):
        try:
            attributes = sorted((key, repr(value)) for key, value in item.attrs.items())
            values = item[()].tobytes() if hasattr(item, "shape") else b""
            told[name] = repr((attributes, getattr(item, "dtype", None), values))
        except Exception as error:  # h5py answers damage by a dozen classes
            told[name] = repr(error)

    def descend(place, node):
        for name, item in node.items():
            visit(f"{place}/{name}", item)
            descend(f"{place}/{name}", item if isinstance(item, dict) else {})

    if data[4:25] == _tree.ADF:
        descend("", _tree.Reader(pathlib.Path("a.cgns"), io.BytesIO(data)).tree())
    elif data.startswith(_tree.CDF):
        descend("", _tree._Header(io.BytesIO(data)).tree())
    else:
        with h5py.File(io.BytesIO(data)) as file:
            file.visititems(visit)
    return told


def is_other_tree(data: bytes, damaged: bytes) -> bool:
    try:
        return content(data) != content(damaged)
    except Exception:  # as above
        return False


def is_whole(place: pathlib.Path, kind: str, text: bytes, damaged: bytes, at: int) -> bool:
    """Whether a file without its end or a line, or with one twice, may still be a good one: the end of a word, a name, an array."""
    lost = {b"<DataArray", b"((a . 1)", b"arch "}
    return (
        place.suffix in (".patches", ".toml", ".inp")  # without counts
        or (kind == "cut" and len(text[len(damaged) :].split()) < 2)
        or (
            kind == "cut"
            and text[at:].lstrip().startswith((b"POINT_DATA", b"METADATA", b"(39", b"(45"))
        )
        or (kind == "cut" and b"METADATA" in damaged.rstrip()[-400:])
        or (kind != "cut" and any(damaged.count(word) < text.count(word) for word in lost))
    )


def sets_of(mesh: dict[str, np.ndarray]) -> tuple[set, set, set]:
    """The places of nodes of cells, the cells and the patches by them: nodes of blocks that meet may be one or two."""
    places = list(map(tuple, mesh["points"].tolist()))
    ids = {name: rows.tolist() for name, rows in mesh.items() if name != "points"}
    cells = {
        tuple(sorted(places[k] for k in row))
        for name in ids
        if name.startswith("cells")
        for row in ids[name]
    }
    patches = {frozenset(places[k] for k in ids[name]) for name in ids if name.startswith("patch")}
    return {place for cell in cells for place in cell}, cells, patches


def compared(good: dict[str, np.ndarray], found: dict[str, np.ndarray]) -> str:
    """What is wrong with a file of which one byte differs."""
    if "points" not in good:
        pairs = [(array, found[name]) for name, array in good.items()]
        changed = sum(int((a != b).sum()) if a.shape == b.shape else 99 for a, b in pairs)
        return f"{changed} numbers differ" if changed > 1 else ""
    pairs = list(zip(sets_of(good), sets_of(found), strict=True))
    moved, cells, patches = (max(len(a - b), len(b - a)) for a, b in pairs)
    changed = [set(cell) for cell in pairs[1][0] ^ pairs[1][1]]
    at_one_node = cells == 1 or (
        cells > 1 and bool(set.intersection(*changed))
    )  # PLOT3D blanks nodes
    is_right = moved == 1 or (not moved and (at_one_node or (not cells and patches <= 2)))
    return "" if is_right else f"{moved} nodes moved, {cells} cells and {patches} patches differ"


def judged(
    place: pathlib.Path,
    kind: str,
    text: bytes,
    damaged: bytes,
    at: int,
    good,
    found,
    *,
    sealed: bool,
) -> str:
    """What is wrong with what a reader makes of a damaged file, `good` being that of the good one; nothing if it is right."""
    if alike(good, found):
        return ""
    if not all(np.isfinite(each).all() for each in found.values() if each.dtype.kind == "f"):
        return "numbers that are not finite"
    if place.suffix in TREES and is_other_tree(text, damaged):
        return ""
    if {*found.get("notes", ())} - {
        *good.get("notes", ())
    }:  # a keyword is another one, and that is told
        return ""
    if kind in ("cut", "line twice", "line less"):
        return "" if is_whole(place, kind, text, damaged, at) else "another mesh without a word"
    if sealed or place.suffix in (*TREES, ".npz"):
        return "another mesh, and nothing in the file says so"
    return "" if place.name == "boundary" or place.suffix == ".toml" else compared(good, found)


def peak() -> float:
    text = pathlib.Path("/proc/self/status").read_text()
    return 1024.0 * int(text.partition("VmHWM:")[2].split()[0])


def verdict(reader, path: pathlib.Path, size: int, judge) -> str:
    """What is wrong with the answer to a damaged file; nothing if it is right."""
    pathlib.Path("/proc/self/clear_refs").write_text("5")
    before, began = peak(), time.process_time()
    try:
        fault = judge(parts(reader(path)))
    except ValueError as error:
        fault = "" if str(path) in str(error) else f"file not named: {str(error)[:200]!r}"
    except BaseException as error:  # whatever it is, it is told
        fault = f"{type(error).__name__}: {str(error)[:200]}"
    seconds, memory = time.process_time() - began, peak() - before
    fault += f" {seconds:.1f} s" * (seconds > SECONDS)
    return fault + f" {memory / 1e6:.0f} MB" * (memory > BYTES + TIMES * size)


def main(name: str, seed: int, first: int, last: int, folder: pathlib.Path) -> None:
    warnings.simplefilter("ignore")
    jax.config.update("jax_enable_x64", True)
    files = seeds.FORMATS[name](folder)
    good = [parts(reader(path)) for reader, path, _ in files]
    used = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**31, -1))  # nobody's machine is to fill up
    for k in range(first, last):
        print("at", k, flush=True)
        rng = np.random.default_rng((seed, k))
        which = int(rng.integers(len(files)))
        reader, path, places = files[which]
        place = places[int(rng.integers(len(places)))]
        data = place.read_bytes()
        packed = place.suffix == ".gz" and rng.random() < 0.5
        text = gzip.decompress(data) if packed else data
        kind, damaged, at = mutated(rng, text)
        place.write_bytes(gzip.compress(damaged) if packed else damaged)
        signal.setitimer(signal.ITIMER_PROF, 3 * SECONDS)  # ends the process
        sealed = place.suffix == ".gz" and not packed
        judge = functools.partial(
            judged, place, kind, text, damaged, at, good[which], sealed=sealed
        )
        fault = verdict(reader, path, len(data), judge)
        signal.setitimer(signal.ITIMER_PROF, 0)
        if fault:
            told = {
                "mutation": k,
                "file": str(place.relative_to(folder)),
                "kind": kind,
                "at": at,
                "fault": fault,
            }
            print(json.dumps(told), flush=True)
        place.write_bytes(data)


if __name__ == "__main__":
    main(
        sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), pathlib.Path(sys.argv[5])
    )
