"""SU2 files of several zones, each a mesh of its own."""

import os
import pathlib
from collections.abc import Sequence

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, input_path

from ._format import source_of
from ._reading import check_nodes
from ._registry import check_output
from ._su2 import NAME, by_zones, mesh_of, with_points


@checked
def read_zones(path: str | os.PathLike[str]) -> tuple[Mesh, ...]:
    """Reads each zone of an SU2 file (`NZONE= 2`) as a mesh, in the order of `IZONE=`.

    Zones are moved alone or together: a wall that two zones have moves in both where each is given
    its displacement. `write` writes the file with one zone moved, `write_zones` with several. All
    else stays byte for byte.

    **Arguments:**

    - `path`: the file, .su2.

    **Returns:** the meshes; one for a file without zones.

    **Raises:** `ValueError` for what `read` refuses, and for other formats, whose zones `read`
    joins to one mesh.
    """
    path = input_path(path)
    if path.suffix.lower() != ".su2":
        raise ValueError(
            f"{path}: SU2 files (.su2) have zones that are meshes of their own; io.read joins the zones of other formats."
        )
    text = path.read_bytes()
    meshes = [mesh_of(path, text, zone) for zone in by_zones(path, text)]
    for mesh in meshes:
        check_nodes(path, mesh)
    return tuple(Mesh(*mesh) for mesh in meshes)


@checked
def write_zones(path: str | os.PathLike[str], meshes: Sequence[Mesh]) -> None:
    """Writes the zones' SU2 file with the coordinates of some of them, all else byte for byte.

    The file appears when it is complete.

    **Arguments:**

    - `path`: the file to write, .su2; its folder must exist.
    - `meshes`: zones that `read_zones` has read from one file together, then moved. Those left out
      stay as they are.

    **Raises:** `ValueError` for none, for meshes of several files, or of several readings, one zone
    twice, and what `write` refuses.
    """
    contents = []
    for mesh in meshes:
        source = source_of(mesh, NAME)
        contents.append(None if source is None else source.content)
        check_output(path, mesh)
        bad = np.flatnonzero(~np.isfinite(np.asarray(mesh.points)).all(axis=1))
        if len(bad):
            raise ValueError(f"{path}: {len(bad)} points are not finite, first node {bad[0]}.")
    if pathlib.Path(path).suffix.lower() != ".su2" or not contents or None in contents:
        raise ValueError(
            f"{path}: `meshes` must be zones that io.read_zones has read, and the file end in .su2; io.write writes other meshes."
        )
    if any(content.text is not contents[0].text for content in contents):
        raise ValueError(
            f"{path}: `meshes` are not of one reading of one file: read its zones together, io.read_zones."
        )
    if len({content.start for content in contents}) < len(contents):
        raise ValueError(f"{path}: one zone is twice in `meshes`.")
    text = contents[0].text
    # from the last zone to the first, so that places of earlier zones stay
    for content, mesh in sorted(zip(contents, meshes, strict=True), key=lambda pair: -pair[0].start):
        text = b"".join(with_points(text, content.start, content.stop, np.asarray(mesh.points)))
    with complete(pathlib.Path(path)) as partial:
        partial.write_bytes(text)
