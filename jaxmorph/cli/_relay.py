"""`jaxmorph deform --remesh`: a motion over several meshes, and layers that go along."""

import dataclasses

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._early import is_given
from ._method import Patches
from ._motion import PARTS, motion
from ._output import Output, plural
from ._requests import Deform
from ._way import draw, faults, finish

MOVES_OF_RELAY = 20
"""Moves of a motion, each of which may need new cells, unless --steps names their number."""

RATIO_OF_RELAY = 0.3
"""Jacobian ratio below which such a move gets new cells, unless a gate names another."""

RIGID_MOTIONS = ("rotate", "translate")
"""Motions that keep the shape of what moves."""


def move_over_meshes(request: Deform, patches: Patches, plan: jm.Plan, out: Output) -> int:
    """Moves with new cells before old ones break, and writes the last mesh. The plan is that of
    the patches.
    """
    limits = request.gates.limits
    least = limits.min_jacobian_ratio or RATIO_OF_RELAY
    moving = _with_layers(request, patches, out)
    if moving is not patches:
        _, plan = next(moving.chunks())
    limits = dataclasses.replace(limits, min_jacobian_ratio=least)
    relay = jm.Relay(plan, patches.mesh, limits=limits)
    path = list(_path_of(request, moving))
    with out.progress("moving and remeshing") as stage:
        for move, u in enumerate(stage.over(path), start=1):
            try:
                relay = relay.moved(u)
            except ValueError as error:
                raise ValueError(
                    f"move {move} of {len(path)}: {error} --steps {2 * len(path)} makes smaller "
                    "moves."
                ) from error
            if relay.remeshed is not None:
                share = relay.remeshed.replaced
                out.say(f"remeshed {share:.1%} of the cells before move {move} of {len(path)}")
    mesh = relay.mesh.moved(relay.points)
    cells = ", ".join(f"{number} {kind}" for kind, number in mesh.cell_counts.items())
    out.say(f"new mesh {len(mesh.points)} points, {cells}", remeshed=relay.count)
    verdict = jm.judge(mesh)
    draw(request.picture, mesh, out, verdict=verdict)
    return finish(
        faults(verdict),
        request.allow_inverted,
        request.output,
        lambda: io.write(request.output, mesh),
        out,
    )


def _path_of(request: Deform, moving: Patches) -> Float[np.ndarray, "k m d"]:
    nodes = moving.nodes
    moves = request.step_count if request.step_count > 1 else MOVES_OF_RELAY
    places = np.asarray(moving.mesh.points, float)[nodes]
    return motion(request, moving.mesh, nodes).path(places, moves)


def _with_layers(request: Deform, patches: Patches, out: Output) -> Patches:
    """Takes the layers at patches that move rigidly to these patches: they go along."""
    mesh = patches.mesh
    layers = {name: jm.wall_layers(mesh, name) for name in patches.moving}
    inside = np.setdiff1d(np.concatenate(list(layers.values())), patches.nodes)
    if not len(inside):
        return patches
    others = {*mesh.patches} - {*patches.moving, *patches.symmetry}
    met = [name for name in others if np.isin(mesh.patches[name], inside).any()]
    bending = [
        part.replace("_", "-")
        for part in PARTS
        if part not in RIGID_MOTIONS and any(is_given(group, part) for group in request.groups)
    ]
    why = [f"they meet {', '.join(sorted(met))}"] if met else []
    why += [f"--{part} changes their shape" for part in bending]
    if why:
        out.say(f"layers   follow as other cells do: {' and '.join(why)}", layers=0)
        return patches
    out.say(f"layers   {plural(len(inside), 'node')} of layers go along", layers=len(inside))
    joined = Mesh(mesh.points, mesh.cells, {**mesh.patches, **layers}, mesh.source)
    return dataclasses.replace(patches, mesh=joined)
