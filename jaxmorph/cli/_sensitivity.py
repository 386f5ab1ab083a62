"""`jaxmorph sensitivity`: dJ/d(points of the volume) to dJ/d(moving nodes), for adjoint solvers elsewhere."""

import io as streams
import pathlib

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import io

from ._files import save
from ._method import named_method, patches_of
from ._output import Output
from ._requests import Sensitivity
from ._tables import count

ENDINGS = (".csv", ".npz")


def sensitivity(request: Sensitivity, out: Output) -> int:
    """Reads, pulls back, writes. Returns the exit status."""
    if request.output.suffix.lower() not in ENDINGS:
        raise ValueError(f"{request.output}: {' or '.join(ENDINGS)} expected.")
    if request.output.resolve() == request.sensitivity.resolve():
        raise ValueError(f"{request.output}: the sensitivities are read from this file; write to another one.")
    if not request.output.parent.is_dir():
        raise ValueError(f"{request.output}: there is no folder {request.output.parent}.")
    with out.progress(f"reading {request.file.name}"):
        mesh = io.read(request.file)
    patches = patches_of(request.surface, mesh, request.file)
    with out.progress(f"reading {request.sensitivity.name}"):
        given = io.read_sensitivity(request.sensitivity, mesh)
    moving = patches.nodes
    with out.progress("preparing"):
        choice = named_method(request.method, np.asarray(mesh.points)[moving])
        plan = patches.prepare(choice)
    with out.progress("pulling back"):
        slope = np.asarray(jm.pullback(plan, np.zeros((len(moving), given.shape[1])), given), float)
    out.say(f"{request.file.name}: {len(mesh.points)} points, {count(len(moving), 'moving node')}")
    out.say(f"method   {choice.name}", points=len(mesh.points), method=choice.name)
    size = np.linalg.norm(slope, axis=1)
    worst = int(size.argmax())
    place = ", ".join(f"{x:.3g}" for x in np.asarray(mesh.points)[moving[worst]])
    out.say(f"largest  {size[worst]:.5g}, at node {moving[worst]} near ({place})", largest=float(size[worst]))
    out.say(f"sum      {', '.join(f'{x:.5g}' for x in slope.sum(axis=0))}", sum=slope.sum(axis=0).tolist())
    with out.progress(f"writing {request.output.name}"):
        save(request.output, _file(request.output, moving, slope))
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 0


def _file(path: pathlib.Path, ids: Int[np.ndarray, " m"], values: Float[np.ndarray, "m d"]) -> bytes:
    if path.suffix.lower() == ".npz":
        stream = streams.BytesIO()
        np.savez_compressed(stream, ids=ids, sensitivity=values)
        return stream.getvalue()
    header = ",".join(["id", *(f"dJ_d{axis}" for axis in "xyz"[: values.shape[1]])])
    rows = [f"{node},{','.join(map(repr, row))}" for node, row in zip(ids.tolist(), values.tolist(), strict=True)]
    return "\n".join([header, *rows, ""]).encode()
