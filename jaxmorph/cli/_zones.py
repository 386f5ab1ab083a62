"""The mesh of a file, or of one of its zones."""

from pathlib import Path

from jaxmorph import Mesh, io

from ._output import plural


def load_mesh(path: Path, zone: int | None = None, tags: Path | None = None) -> Mesh:
    if zone is None or tags is not None:
        return io.read(path, tags=tags)
    meshes = io.read_zones(path)
    if not 1 <= zone <= len(meshes):
        raise ValueError(f"--zone {zone}: {path} has {plural(len(meshes), 'zone')}.")
    return meshes[zone - 1]
