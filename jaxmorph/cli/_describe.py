"""Checks and descriptions of a request of `deform`, for a whole mesh and a mesh in parts."""

from pathlib import Path

import numpy as np

from jaxmorph import Mesh, io
from jaxmorph._host.package.files import complete

from ._job import text_of
from ._method import NamedMethod, Patches
from ._output import Output, count, wrapped
from ._requests import Deform


def mesh_of(path: Path, zone: int | None) -> Mesh:
    """Reads a file's mesh, or an SU2 file's zone `zone`. Raises `ValueError` for an absent zone."""
    if zone is None:
        return io.read(path)
    meshes = io.read_zones(path)
    if not 1 <= zone <= len(meshes):
        raise ValueError(f"--zone {zone}: {path} has {count(len(meshes), 'zone')}.")
    return meshes[zone - 1]


def check_files(request: Deform, mesh: Mesh) -> None:
    """Raises `ValueError` for patches without nodes, `ImportError` for lattices without VTK."""
    for group in request.groups:
        if group.lattice is not None:
            io.check_lattice_output(group.lattice)
        if group.patches and not len(mesh.patch(*group.patches)):
            raise ValueError(f"--moving {' '.join(group.patches)}: there are no nodes in it.")


def described(request: Deform, patches: Patches, choice: NamedMethod, u: np.ndarray, out: Output) -> None:
    """Describes what moves, by how much, what stays, and the method.

    `u` are the displacements of the moving nodes.
    """
    mesh, way = patches.mesh, np.linalg.norm(u, axis=1)
    for names in dict.fromkeys(tuple(group.patches) for group in request.groups):
        nodes = mesh.patch(*names)
        largest = way[np.searchsorted(patches.nodes, nodes)].max()
        wrapped(out, f"moving   {', '.join(names)}: {count(len(nodes), 'node')}, by up to {largest:.4g}")
    fixed = np.setdiff1d(patches.fixed_nodes, patches.nodes)
    names = ", ".join(request.boundary.fixed) or "no patch"
    wrapped(out, f"fixed    {names}: {count(len(fixed), 'node')}")
    if patches.symmetry:
        wrapped(out, f"symmetry {', '.join(patches.symmetry)}: {count(len(mesh.patch(*patches.symmetry)), 'node')}")
    if patches.sliding:
        wrapped(out, f"sliding  {', '.join(patches.sliding)}: {count(len(mesh.patch(*patches.sliding)), 'node')}")
    for pair in patches.periodic:
        wrapped(out, f"periodic {pair.patch}, {pair.partner}: {count(len(mesh.patch(str(pair.patch))), 'pair')}")
    out.say(f"method   {choice.name}, {count(request.steps, 'step')}", method=choice.name, steps=request.steps)
    moving = {name: len(mesh.patch(name)) for name in patches.moving}
    out.say(moving=moving, largest=float(way.max()), sources=choice.sources)


def write_job(request: Deform, out: Output) -> None:
    """Writes the job file that is asked for."""
    if request.save_job is not None:
        with complete(request.save_job) as partial:
            partial.write_bytes(text_of(request, request.save_job.parent).encode())
        out.say(f"job      {request.save_job}")
