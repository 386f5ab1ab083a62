"""`jaxmorph deform`."""

import argparse
import dataclasses
import sys
import time

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._motion import motion
from ._progress import Progress
from ._tables import compared, count, inverted_cells

HINTS = {"paper": "more --sources or more --steps", "rbf": "more --steps", "dgm": "--method paper"}
"""What to try when cells are inverted."""

SEARCHES = 24
"""Reductions tried to find one of about as many sources as asked for."""


def deform(arguments: argparse.Namespace) -> int:
    """Reads, moves, judges, writes; says each on the terminal. Returns the exit status."""
    began = time.monotonic()
    progress = Progress("jaxmorph deform")
    with progress(f"reading {arguments.file.name}"):
        mesh = io.read(arguments.file)
    _check(arguments, mesh)
    moving, fixed = mesh.patch(*arguments.moving), mesh.patch(*arguments.fixed)
    path = motion(arguments, mesh, moving).path(np.asarray(mesh.points)[moving], arguments.steps)
    largest = float(np.linalg.norm(path[-1], axis=1).max())
    with progress("choosing sources"):
        choice = choose(arguments, np.asarray(mesh.points)[moving])
    cells = ", ".join(f"{len(corners)} {kind}" for kind, corners in mesh.cells.items())
    print(f"{arguments.file.name}: {len(mesh.points)} points in {mesh.points.shape[1]}-D, {cells}")
    print(f"moving   {', '.join(arguments.moving)}: {count(len(moving), 'node')}, by up to {largest:.4g}")
    print(f"fixed    {', '.join(arguments.fixed)}: {count(len(np.setdiff1d(fixed, moving)), 'node')}")
    print(f"method   {choice.name}, {count(arguments.steps, 'step')}", flush=True)
    with progress("preparing"):
        plan = _prepare(arguments, mesh, moving, fixed, choice.method)
        for warning in jm.inspect(plan, path[-1]).warnings:
            print(f"jaxmorph deform: warning: {warning}", file=sys.stderr)
    with progress(f"deforming in {count(arguments.steps, 'step')}"):
        points = jm.deform(plan, path[0]) if arguments.steps == 1 else jm.march(plan, path)[1]
        moved = mesh.moved(np.asarray(points))
    with progress("judging the cells"):
        before, after = jm.quality(mesh), jm.quality(mesh, moved.points)
        table = compared(before, after)
    print(f"\n{table}\n", flush=True)
    bad = inverted_cells(after)
    if bad:
        print(f"jaxmorph deform: {bad} Try {HINTS[arguments.method]}.", file=sys.stderr)
    if bad and not arguments.allow_inverted:
        print(f"{arguments.output} is not written; --allow-inverted writes it all the same.", file=sys.stderr)
        return 1
    with progress(f"writing {arguments.output.name}"):
        _write(arguments, mesh, moved, after)
    print(f"wrote {arguments.output} ({time.monotonic() - began:.1f} s)")
    return 1 if bad else 0


def _prepare(arguments, mesh: Mesh, moving: np.ndarray, fixed: np.ndarray, method: jm.AbstractMethod | None) -> jm.Plan:
    """A patch is plane, or an error names it; so does one for points outside of the hull name the patches left out."""
    planes = []
    for name in arguments.symmetry:
        try:
            planes.append(jm.Plane.through(mesh.points, mesh.patch(name)))
        except ValueError as error:
            raise ValueError(f"--symmetry {name}: {error}") from None
    try:
        return jm.prepare(mesh.points, moving, fixed, method=method, symmetry=planes)
    except ValueError as error:
        left = [name for name in mesh.patches if name not in {*arguments.moving, *arguments.fixed, *arguments.symmetry}]
        if "convex hull" in str(error) and left:
            raise ValueError(f"{error} Patches that are neither: {', '.join(left)}.") from None
        raise


def _check(arguments: argparse.Namespace, mesh: Mesh) -> None:
    """`ValueError` for what can be known to fail before any work."""
    io.check_output(arguments.output, mesh)
    files = [file for file in (arguments.displacement, arguments.displacement_from) if file is not None]
    if arguments.output.resolve() in [file.resolve() for file in files]:
        raise ValueError(f"{arguments.output}: the displacements are read from this file; write to another one.")
    known = ", ".join(mesh.patches) or "none"
    for option, names, do in (("--moving", arguments.moving, "move"), ("--fixed", arguments.fixed, "stay")):
        if not names:
            raise ValueError(f"{option} is missing: name the patches that {do}; this mesh has: {known}.")
        if not len(mesh.patch(*names)):
            raise ValueError(f"{option} {' '.join(names)}: there are no nodes in it.")
    for name in arguments.symmetry:
        mesh.patch(name)
    both = sorted(set(arguments.moving) & set(arguments.fixed))
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
    if arguments.steps < 1:
        raise ValueError(f"--steps must be 1 or more, found {arguments.steps}.")
    if not len(mesh.cells):
        raise ValueError(f"{arguments.file}: the mesh has no cells.")


@dataclasses.dataclass(frozen=True)
class Choice:
    """A method (None: the library's own choice), and what to call it."""

    method: jm.AbstractMethod | None
    name: str


def choose(arguments: argparse.Namespace, wall: np.ndarray) -> Choice:
    """The method asked for. `ValueError` for sources where they mean nothing."""
    if arguments.sources is not None and arguments.method != "paper":
        raise ValueError(f"--sources is for --method paper; {arguments.method} has no sources to choose.")
    if arguments.method == "rbf":
        return Choice(jm.RBF(reduction=jm.AllPoints(), fixed_reduction=jm.AllPoints()), "full radial basis functions")
    if arguments.method == "dgm":
        return Choice(jm.DelaunayGraph(), "Delaunay graph mapping")
    if arguments.sources is None:
        return Choice(None, "reduced radial basis functions + graph")
    reduction = about(arguments.sources, wall)
    name = f"reduced radial basis functions ({len(reduction(wall))} wall sources) + graph"
    return Choice(jm.SurfaceReconstruction(jm.RBF(reduction=reduction), jm.NearWall()), name)


def about(sources: int, wall: np.ndarray) -> jm.AbstractReduction:
    """The k-d tree whose number of leaves gives the number of sources closest to the one asked for."""
    d = wall.shape[1]
    if sources < d + 1:
        raise ValueError(f"--sources must be {d + 1} or more in {d}-D, found {sources}.")
    if sources >= len(wall):
        return jm.AllPoints()
    tried: dict[int, int] = {}
    low, high = 1, min(sources, len(wall))
    for _ in range(SEARCHES):
        leaves = (low + high) // 2
        tried[leaves] = len(jm.KDTree(leaves, extremes=True)(wall))
        low, high = (leaves + 1, high) if tried[leaves] < sources else (low, leaves - 1)
        if low > high:
            break
    best = min(tried, key=lambda leaves: (abs(tried[leaves] - sources), leaves))
    return jm.KDTree(best, extremes=True)


def _write(arguments: argparse.Namespace, mesh: Mesh, moved: Mesh, after: jm.QualityReport) -> None:
    """With the displacement and the quality of each cell where the format holds arrays."""
    if not io.check_output(arguments.output, mesh):
        io.write(arguments.output, moved)
        return
    names = ("skewness", "aspect_ratio", "volume_ratio", "jacobian_ratio")
    cell_data = {name: np.asarray(getattr(after, name)) for name in names}
    cell_data["is_inverted"] = np.asarray(after.is_inverted).astype(np.uint8)
    displacement = np.asarray(moved.points) - np.asarray(mesh.points)
    io.write(arguments.output, moved, point_data={"displacement": displacement}, cell_data=cell_data)
