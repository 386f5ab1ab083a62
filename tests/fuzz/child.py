"""Reads damaged files, one after the other, under limits of time and memory: `child.py FORMAT SEED FIRST LAST FOLDER`.

A line `at K` precedes mutation K, and a line of JSON tells each wrong answer. A signal ends one that takes too long.
"""

import functools
import gzip
import json
import pathlib
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable

import jax
import numpy as np
import seeds
from oracle import accepted, alike, content, parts

SECONDS, BYTES, TIMES = 2.0, 200e6, 10
"""Limits: of CPU time, and of memory beyond that of the imports: bytes, and in sizes of the file."""


def mutated(rng: np.random.Generator, data: bytes) -> tuple[str, bytes, int]:
    """Damages a file once; says how, and where."""
    kind = rng.choice(["bit", "byte", "cut", "digit", "line twice", "line less", "number"])
    at = int(rng.integers(max(len(data), 1)))
    if kind == "cut":
        return kind, data[:at], at
    if kind == "bit":
        return kind, data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :], at
    if kind == "byte":
        return kind, data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :], at
    if kind in ("digit", "number"):
        digits = [k for k, byte in enumerate(data[at : at + 4000], start=at) if 48 <= byte < 58]
        if not digits:
            return "cut", data[:at], at
        place = digits[int(rng.integers(min(len(digits), 50)))]
        words = [b"-", b"9999999", b"1e9", b"nan", b"", b" ", b"."]
        new = rng.choice(words) if kind == "number" else b"%d" % rng.integers(10)
        return kind, data[:place] + bytes(new) + data[place + 1 :], place
    lines = data.splitlines(keepends=True)
    row = int(rng.integers(len(lines)))
    at = sum(map(len, lines[:row]))
    return kind, b"".join([*lines[:row], *([lines[row]] * 2 if kind == "line twice" else []), *lines[row + 1 :]]), at


def other_content(data: bytes, damaged: bytes) -> bool:
    """Whether h5py finds other values, which are those of the damaged file."""
    try:
        return content(data) != content(damaged)
    except Exception:  # h5py answers damage by a dozen classes
        return False


def peak() -> float:
    text = pathlib.Path("/proc/self/status").read_text()
    return 1024.0 * int(text.partition("VmHWM:")[2].split()[0])


def verdict(reader, path: pathlib.Path, size: int, judge: Callable[[dict[str, np.ndarray]], str]) -> str:
    """What is wrong with the answer to a damaged file; nothing if it is right. `judge` knows what an accepted one may hold."""
    pathlib.Path("/proc/self/clear_refs").write_text("5")
    before, began = peak(), time.process_time()
    fault = ""
    try:
        found = parts(reader(path))
        if not all(np.isfinite(each).all() for each in found.values() if each.dtype.kind == "f"):
            fault = "numbers that are not finite"
        fault = fault or judge(found)
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
        # what is left may be whole: without the end of its last word, the byte order of numbers, or a line of a list of names
        has_other_lines = kind in ("cut", "line less", "line twice")
        is_whole = not has_other_lines or place.suffix == ".patches"
        is_whole |= kind == "cut" and len(text[len(damaged) :].split()) < 2
        is_whole |= kind == "line less" and damaged.count(b"<DataArray") < text.count(b"<DataArray")
        is_whole |= kind == "cut" and text[at:].lstrip().startswith((b"POINT_DATA", b"METADATA"))
        is_whole |= kind == "cut" and damaged.rstrip()[-400:].rfind(b"METADATA") >= 0
        is_whole |= kind == "line less" and damaged.count(b"((a . 1)") < text.count(b"((a . 1)")  # a zone's name
        is_whole |= place.suffix == ".h5" and other_content(text, damaged)
        is_whole |= b"arch " in text and b"arch " not in damaged

        if not is_whole:
            judge = lambda found, right=good[which]: "" if alike(found, right) else "another mesh without a word"  # noqa: E731
        elif has_other_lines:  # those that are left are a good file
            judge = lambda found: ""  # noqa: E731
        else:
            sealed = place.suffix == ".gz" and not packed
            judge = functools.partial(accepted, place, text, damaged, at, good[which], sealed=sealed)
        fault = verdict(reader, path, len(data), judge)
        signal.setitimer(signal.ITIMER_PROF, 0)
        if fault:
            told = {"mutation": k, "file": str(place.relative_to(folder)), "kind": kind, "fault": fault}
            print(json.dumps(told), flush=True)
        place.write_bytes(data)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), pathlib.Path(sys.argv[5]))
