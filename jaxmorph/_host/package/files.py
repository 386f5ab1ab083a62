"""Files and folders that appear when they are complete."""

import contextlib
import gzip
import os
import pathlib
import re
import secrets
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterator

import numpy as np
from numpy import ndarray

PathLike = str | os.PathLike[str]
"""The name of a file, as users give it."""


def input_path(path: PathLike) -> pathlib.Path:
    """Returns a path to read. Raises `ValueError` for a device, a pipe, or a null byte."""
    path = _without_null(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(
            f"{path}: is a device or a pipe, but a file is read more than once: write its content "
            "to a file."
        )
    return path


def _without_null(path: PathLike) -> pathlib.Path:
    if "\0" in os.fspath(path):
        raise ValueError(f"{os.fspath(path)!r}: a name of a file holds no null byte.")
    return pathlib.Path(path)


def output_path(path: PathLike, *endings: str, folder: bool = False) -> pathlib.Path:
    """Checks the path of a file, or of a folder, to write, before any work. Raises `ValueError` for
    a name without one of the `endings`, if there are any, without a parent folder, and for a
    folder, a device or a pipe.
    """
    name = os.fspath(path)
    if not folder and name.endswith((os.sep, os.altsep or os.sep)):
        raise ValueError(
            f"{name}: ends as a folder does, but a file is written. Remove the {name[-1]} at the "
            "end."
        )
    path = _without_null(path)
    if endings and path.suffix.lower() not in endings:
        raise ValueError(f"{path}: the name should end in {' or '.join(endings)}.")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}.")
    _check_replaceable(path, pathlib.Path(os.path.realpath(path)), folder)
    return path


def is_same(a: pathlib.Path, b: pathlib.Path) -> bool:
    try:
        return os.path.samefile(a, b)
    except OSError:
        return a.resolve() == b.resolve()


def read_arrays(path: pathlib.Path, what: str = "an NPZ file") -> dict[str, ndarray]:
    """Reads arrays by name. Raises `ValueError` for objects, a damaged file, or not `what`."""
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                arrays = {}
                for name in archive.namelist():
                    # To the end, where `zipfile` compares the checksum: a damaged type hides a part
                    with archive.open(name) as member:
                        arrays[name.removesuffix(".npy")] = np.lib.format.read_array(
                            member, allow_pickle=False
                        )
                        if member.read(1):
                            raise ValueError(f"{name} holds more than its array")
                return arrays
        except Exception as error:  # zipfile, zlib and NumPy raise a dozen classes for damage
            detail = " ".join(str(error).split())[:120]
            raise ValueError(
                f"{path}: not {what}, or a damaged one ({type(error).__name__}: {detail})."
            ) from error


def real_values(path: pathlib.Path, arrays: dict[str, ndarray], name: str) -> ndarray:
    if arrays[name].dtype.kind not in "fiu":
        raise ValueError(
            f"{path}: the array {name} holds {arrays[name].dtype}; real numbers expected."
        )
    return arrays[name].astype(float)


# bytes that a packed file may become in any case, and that a byte of it may become
UNPACKED = (2 * 10**8, 100)


@contextlib.contextmanager
def unpack(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yields a file, or the unpacked copy of one that ends in .gz, under its name without .gz."""
    if path.suffix.lower() != ".gz" or path.is_dir():
        yield path
        return
    left = UNPACKED[0] + UNPACKED[1] * path.stat().st_size
    with tempfile.TemporaryDirectory(prefix="jaxmorph-") as folder:
        copy = pathlib.Path(folder, path.stem)
        try:
            with gzip.open(path) as packed, copy.open("wb") as file:
                while block := packed.read(1 << 20):
                    left -= file.write(block)
                    if left < 0:
                        raise ValueError(
                            f"{path}: {file.tell() / 1e6:.0f} MB are in it, and more: unpack it "
                            "first."
                        )
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise ValueError(f"{path}: not a .gz file, or a damaged one ({error}).") from error
        yield copy


@contextlib.contextmanager
def pack_into(path: pathlib.Path, name: str) -> Iterator[pathlib.Path]:
    """Yields a file to write: `path`, or where it ends in .gz a file that is packed into it."""
    if path.suffix.lower() != ".gz":
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="jaxmorph-") as folder:
        plain = pathlib.Path(folder, name)
        yield plain
        with (
            plain.open("rb") as file,
            path.open("wb") as out,
            gzip.GzipFile("", "wb", mtime=0, fileobj=out) as target,
        ):
            shutil.copyfileobj(file, target)


@contextlib.contextmanager
def complete(
    path: pathlib.Path, *, folder: bool = False, name_errors: bool = True
) -> Iterator[pathlib.Path]:
    """Yields a temporary file or folder that replaces `path` at the end; a failure leaves nothing.

    If `path` is a symbolic link, its target is replaced. The new file has the permissions of the
    old file. Raises `FileNotFoundError` if the parent folder does not exist, and `ValueError` if
    `path` is a folder, a device or a pipe. An `OSError` of the writer names `path`. A caller with
    errors of its own passes `name_errors=False`, and writes within `named`.
    """
    target = pathlib.Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {target.parent}.")
    _check_replaceable(path, target, folder)
    with name_errors_by(path):
        partial = _make_partial(target, folder)
    try:
        with name_errors_by(path) if name_errors else contextlib.nullcontext():
            yield partial
        with name_errors_by(path):
            partial.replace(target)
    finally:
        if partial.is_dir() and not partial.is_symlink():
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)


def _check_replaceable(path: pathlib.Path, target: pathlib.Path, folder: bool) -> None:
    if target.is_symlink():
        raise ValueError(f"{path}: is a symbolic link to itself; remove it, or give another name.")
    if folder or not target.exists() or target.is_file():
        return
    kind = "a folder" if target.is_dir() else "a device or a pipe"
    raise ValueError(f"{path}: is {kind}, which a file cannot replace: give the file another name.")


@contextlib.contextmanager
def name_errors_by(path: pathlib.Path) -> Iterator[None]:
    """Makes a system error name the target file instead of the temporary file or none."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        # `shutil` lists the errors of a tree: the first one counts.
        text = str(error.args[0][0][-1] if isinstance(error, shutil.Error) else error)
        number = getattr(error, "errno", None) or int(
            (re.search(r"\b[Ee]rrno (?:= )?(\d+)", text) or [0, 0])[1]
        )
        if _is_of_another(error) or not (number or isinstance(error, OSError)):
            raise
        if not number:  # NumPy, for example, counts the bytes that were not written
            raise OSError(f"{path}: not written ({text})") from error
        raise OSError(
            number, os.strerror(number), str(path)
        ) from error  # HDF5's RuntimeError for a full device too


def _is_of_another(error: Exception) -> bool:
    names = [
        os.fsdecode(name)
        for key in ("filename", "filename2")
        if (name := getattr(error, key, None))
    ]
    return bool(names) and not any(".partial" in name for name in names)


def _make_partial(target: pathlib.Path, folder: bool) -> pathlib.Path:
    # of a file system's 255 bytes
    room = 255 - len(os.fsencode(target.suffix)) - len("..12345678.partial")
    stem = os.fsencode(target.stem)[: max(room, 0)].decode(errors="ignore")
    while True:
        partial = target.with_name(f".{stem}.{secrets.token_hex(4)}.partial{target.suffix}")
        with contextlib.suppress(FileExistsError):
            if folder:
                partial.mkdir()
                return partial
            mode = stat.S_IMODE(target.stat().st_mode) if target.is_file() else None
            # O_EXCL: a link planted under this name is not followed
            os.close(
                os.open(
                    partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666 if mode is None else mode
                )
            )
            if mode is not None:
                partial.chmod(mode)
            return partial
