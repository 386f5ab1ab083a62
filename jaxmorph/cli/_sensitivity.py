"""`jaxmorph sensitivity`: dJ/d(points of the volume) to dJ/d(moving nodes), for adjoint solvers elsewhere."""

import argparse
import io as streams
import pathlib

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import io

from ._files import save
from ._method import check_patches, choose, prepare
from ._output import Output
from ._tables import count

ENDINGS = (".csv", ".npz")


def sensitivity(arguments: argparse.Namespace, out: Output) -> int:
    """Reads, pulls back, writes. Returns the exit status."""
    if arguments.output.suffix.lower() not in ENDINGS:
        raise ValueError(f"{arguments.output}: {' or '.join(ENDINGS)} expected.")
    if arguments.output.resolve() == arguments.sensitivity.resolve():
        raise ValueError(f"{arguments.output}: the sensitivities are read from this file; write to another one.")
    if not arguments.output.parent.is_dir():
        raise ValueError(f"{arguments.output}: there is no folder {arguments.output.parent}.")
    with out.progress(f"reading {arguments.file.name}"):
        mesh = io.read(arguments.file)
    check_patches(arguments, mesh, arguments.moving)
    with out.progress(f"reading {arguments.sensitivity.name}"):
        given = io.read_sensitivity(arguments.sensitivity, mesh)
    moving = mesh.patch(*arguments.moving)
    with out.progress("preparing"):
        choice = choose(arguments.method, arguments.sources, np.asarray(mesh.points)[moving])
        plan = prepare(arguments, mesh, arguments.moving, choice.method)
    with out.progress("pulling back"):
        found = np.asarray(jm.pullback(plan, np.zeros((len(moving), given.shape[1])), given), float)
    out.say(f"{arguments.file.name}: {len(mesh.points)} points, {count(len(moving), 'moving node')}")
    out.say(f"method   {choice.name}", points=len(mesh.points), method=choice.name)
    size = np.linalg.norm(found, axis=1)
    worst = int(size.argmax())
    place = ", ".join(f"{x:.3g}" for x in np.asarray(mesh.points)[moving[worst]])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near ({place})", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in found.sum(axis=0))}", sum=found.sum(axis=0).tolist())
    with out.progress(f"writing {arguments.output.name}"):
        save(arguments.output, _file(arguments.output, moving, found))
    out.say(f"wrote {arguments.output} ({out.seconds:.1f} s)", output=str(arguments.output))
    return 0


def _file(path: pathlib.Path, ids: Int[np.ndarray, " m"], values: Float[np.ndarray, "m d"]) -> bytes:
    if path.suffix.lower() == ".npz":
        stream = streams.BytesIO()
        np.savez_compressed(stream, ids=ids, sensitivity=values)
        return stream.getvalue()
    header = ",".join(["id", *(f"dJ_d{axis}" for axis in "xyz"[: values.shape[1]])])
    rows = [f"{node},{','.join(map(repr, row))}" for node, row in zip(ids.tolist(), values.tolist(), strict=True)]
    return "\n".join([header, *rows, ""]).encode()
