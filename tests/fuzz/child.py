"""Reads damaged files, one after the other, under limits of time and memory: `child.py FORMAT SEED FIRST LAST FOLDER`.

A line `at K` precedes mutation K, and a line of JSON tells each that is answered wrongly. The process ends by a signal where one
takes too long inside of compiled code.
"""

import gzip
import json
import pathlib
import resource
import signal
import sys
import time
import warnings

import jax
import numpy as np
import seeds

SECONDS, BYTES, TIMES = 2.0, 200e6, 10
"""Limits: of CPU time, and of memory beyond that of the imports: bytes, and in sizes of the file."""


def mutated(rng: np.random.Generator, data: bytes) -> tuple[str, bytes]:
    """Damages a file once; says how."""
    kind = rng.choice(["bit", "byte", "cut", "digit", "line twice", "line less", "number"])
    at = int(rng.integers(max(len(data), 1)))
    if kind == "cut":
        return kind, data[:at]
    if kind == "bit":
        return kind, data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
    if kind == "byte":
        return kind, data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :]
    if kind in ("digit", "number"):
        digits = [k for k, byte in enumerate(data[at : at + 4000], start=at) if 48 <= byte < 58]
        if not digits:
            return "cut", data[:at]
        place = digits[int(rng.integers(min(len(digits), 50)))]
        new = (
            rng.choice([b"-", b"9999999", b"1e9", b"nan", b"", b" ", b"."])
            if kind == "number"
            else b"%d" % rng.integers(10)
        )
        return kind, data[:place] + bytes(new) + data[place + 1 :]
    lines = data.splitlines(keepends=True)
    row = int(rng.integers(len(lines)))
    return kind, b"".join([*lines[:row], *([lines[row]] * 2 if kind == "line twice" else []), *lines[row + 1 :]])


def peak() -> float:
    text = pathlib.Path("/proc/self/status").read_text()
    return 1024.0 * int(text.partition("VmHWM:")[2].split()[0])


def content(result) -> list[np.ndarray]:
    """The arrays of what a reader returns: two readings are alike where these are."""
    if hasattr(result, "patches"):
        names = np.frombuffer(" ".join([*result.cells, *result.patches]).encode(), np.uint8)
        return [names, np.asarray(result.points), *result.cells.values(), *result.patches.values()]
    return [np.asarray(leaf) for leaf in jax.tree.leaves(result)]


def alike(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def verdict(reader, path: pathlib.Path, good: list[np.ndarray], kind: str, size: int) -> str:
    """What is wrong with the answer to a damaged file; nothing if it is right."""
    pathlib.Path("/proc/self/clear_refs").write_text("5")
    before, began = peak(), time.process_time()
    fault = ""
    try:
        found = content(reader(path))
        if not all(np.isfinite(each).all() for each in found if each.dtype.kind == "f"):
            fault = "numbers that are not finite"
        if kind and not alike(found, good):
            fault = "another mesh without a word"
    except ValueError as error:
        fault = "" if str(path) in str(error) else f"file not named: {str(error)[:200]!r}"
    except BaseException as error:  # whatever it is, it is told
        fault = f"{type(error).__name__}: {str(error)[:200]}"
    seconds, memory = time.process_time() - began, peak() - before
    if seconds > SECONDS:
        fault += f" {seconds:.1f} s"
    if memory > BYTES + TIMES * size:
        fault += f" {memory / 1e6:.0f} MB"
    return fault


def main(name: str, seed: int, first: int, last: int, folder: pathlib.Path) -> None:
    warnings.simplefilter("ignore")
    jax.config.update("jax_enable_x64", True)
    files = seeds.FORMATS[name](folder)
    good = [content(reader(path)) for reader, path, _ in files]
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
        kind, damaged = mutated(rng, text)
        place.write_bytes(gzip.compress(damaged) if packed else damaged)
        signal.setitimer(signal.ITIMER_PROF, 3 * SECONDS)  # ends the process
        # what is left may be whole: without the end of its last word, the byte order of numbers, or a line of a list of names
        is_whole = kind not in ("cut", "line less", "line twice") or place.suffix == ".patches"
        is_whole |= kind == "cut" and len(text[len(damaged) :].split()) < 2
        is_whole |= b"arch " in text and b"arch " not in damaged
        fault = verdict(reader, path, good[which], "" if is_whole else kind, len(data))
        signal.setitimer(signal.ITIMER_PROF, 0)
        if fault:
            told = {"mutation": k, "file": str(place.relative_to(folder)), "kind": kind, "fault": fault}
            print(json.dumps(told), flush=True)
        place.write_bytes(data)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]), pathlib.Path(sys.argv[5]))
