"""The tree of a CGNS, MED or Exodus file, in HDF5, in ADF or in classic netCDF."""

try:
    import h5py
    from h5py import h5l, h5o  # pyright: ignore[reportAttributeAccessIssue]
except ImportError as error:
    raise ImportError("CGNS, MED and Exodus files need h5py: pip install 'jaxmorph[io]'") from error

import contextlib
import pathlib
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .. import _netcdf
from .._format import MeshLike, own_source
from ..text.digits import decoded
from . import adf

WHAT = "a CGNS file in HDF5 or ADF"
_FOREIGN = "{0}: {1} {2}. Only files that hold all of their data are read: `h5repack` or `cgnsconvert` make one."


@contextlib.contextmanager
def opened(path: pathlib.Path, writes: bool = False, what: str = WHAT) -> Iterator[Any]:
    """Yields the root of a file's tree as h5py has it: groups with `label`, arrays as " data".

    `what` names the format in messages. A file to be read is refused with a `ValueError` where it
    is another one, damaged, or has data elsewhere. Writing would go through to them.
    """
    try:
        if adf.is_adf(path):
            with path.open("r+b" if writes else "rb") as file:
                yield adf.tree(path, file)
        elif _netcdf.is_classic(path):
            with path.open("r+b" if writes else "rb") as file:
                yield _netcdf.tree(file)
        else:
            with h5py.File(path, "r+" if writes else "r") as file:
                _refuse_foreign_data(path, file)
                yield file
    except Exception as error:  # HDF5 answers damage by a dozen classes
        if writes or (isinstance(error, ValueError) and str(path) in str(error)):
            raise
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not {what}, or a damaged one ({detail}).") from error


def write_points(
    path: pathlib.Path,
    mesh: MeshLike,
    format_name: str,
    put: Callable[[Any, np.ndarray, np.ndarray], None],
    what: str = WHAT,
) -> None:
    """Copies the file that a mesh was read from, and puts the mesh's points into the copy.

    `put` takes the root of the copy's tree, the points in the file's order, and the old points. It
    is not called where no point has moved, and rounds by NumPy, since HDF5 has a rule of its own
    for ties. A file with data in another one is refused before it is
    copied.
    """
    source = own_source(path, mesh, format_name)
    with opened(source.path, what=what):
        pass
    shutil.copyfile(source.path, path)
    points, old = source.content.in_file(np.asarray(mesh.points)), source.content.points
    if not np.array_equal(points, old):
        with opened(path, writes=True, what=what) as file:
            put(file, points, old)


def _text(name: str | bytes) -> str:
    """Returns a name as text; h5py has names that are not UTF-8 as bytes."""
    return decoded(name) if isinstance(name, bytes) else name


def _link(group: Any, name: str | bytes) -> Any:
    """Returns the link of a group's member, as h5py's `get` does for names that are UTF-8."""
    if isinstance(name, str):
        return group.get(name, getlink=True)
    kind = group.id.links.get_info(name).type
    if kind == h5l.TYPE_EXTERNAL:
        return h5py.ExternalLink(*map(_text, group.id.links.get_val(name)))
    return h5py.SoftLink("elsewhere") if kind == h5l.TYPE_SOFT else h5py.HardLink()


def _refuse_foreign_data(path: pathlib.Path, file: Any) -> None:
    """Raises `ValueError` where anything in an HDF5 file has its data in another one.

    Links to other files, data sets in external storage and virtual ones are refused, wherever they
    stand.
    """
    groups, seen = [file["/"]], set()
    while groups:
        group = groups.pop()
        for name in group:
            link, place = _link(group, name), "/".join([_text(group.name).rstrip("/"), _text(name)])[-200:]
            if isinstance(link, h5py.ExternalLink):
                raise ValueError(_FOREIGN.format(path, place, f"is a link to {link.filename}"))
            if isinstance(link, h5py.SoftLink):
                continue  # to a place of this file, which is looked at by itself
            child = group[name]
            if isinstance(child, h5py.Dataset):
                if child.external or child.is_virtual:
                    other = child.external[0][0] if child.external else "other data sets"
                    raise ValueError(_FOREIGN.format(path, place, f"keeps its values in {other}"))
            elif isinstance(child, h5py.Group):
                address = h5o.get_info(child.id).addr
                if address not in seen:  # groups may hold each other
                    seen.add(address)
                    groups.append(child)
