"""AFLR3's .ugrid, which FUN3D reads: text, plain binary or Fortran's records, as its name says."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmorph._host.cells.topology import CORNERS
from jaxmorph._mesh.exchange import Grid, Parts

from ._format import EVERYTHING, MeshLike, check_form, of_grid
from ._places import Stream
from ._text import Section

NAME = "AFLR"
UGRID_FACES = ("triangle", "quad")
UGRID_CELLS = ("tetra", "pyramid", "wedge", "hexahedron")
APEX = [1, 0, 3, 4, 2]
"""The places of AFLR's corners of a pyramid in VTK's order."""


def find_form(path: Path) -> str:
    """Returns the part of a file's name that says how numbers are written, `lb8`; "" for a text."""
    words = path.name.lower().removesuffix(".gz").split(".")
    return words[-2] if len(words) > 2 and re.fullmatch("l?[br][48]l?", words[-2]) else ""


def list_types(form: str) -> Mapping[str, str] | None:
    order = "<" if form.startswith("l") else ">"
    whole = f"{order}i{8 if form.endswith('l') else 4}"
    return {"i": whole, "n": whole, "d": order + f"f{8 if '8' in form else 4}"} if form else None


def read(path: Path) -> Parts:
    """Reads points, cells and patches: surfaces by their numbers, `ugrid:ref_3`."""
    form = find_form(path)
    raw = path.read_bytes()
    stream = Stream(Section(path, raw, 0, len(raw)), list_types(form))
    mark = form.count("r")
    marks = stream.take("i", mark).tolist()
    count, *sizes = stream.take("n", 7).tolist()
    marks += stream.take("i", 2 * mark).tolist()
    if marks[:2] not in ([], [28, 28]):
        raise ValueError("no Fortran records of this form; the name says how numbers are written.")
    places = stream.places(count, "ddd")
    faces = [
        stream.table(size, CORNERS[kind]) for kind, size in zip(UGRID_FACES, sizes, strict=False)
    ]
    numbers = [stream.take("n", len(rows)) for rows in faces]
    cells = [stream.table(n, CORNERS[kind]) for kind, n in zip(UGRID_CELLS, sizes[2:], strict=True)]
    cells[1] = cells[1][:, APEX]
    stream.take("i", mark)
    content = stream.content(places, singles=EVERYTHING if "4" in form else ())
    numbers += [np.zeros(len(rows), np.int64) for rows in cells]
    blocks = [
        (k, rows - 1)
        for k, rows in zip((*UGRID_FACES, *UGRID_CELLS), [*faces, *cells], strict=True)
    ]
    grid = Grid(content.points, blocks, {}, {"ugrid:ref": numbers})
    notes = []
    if stream.at < stream.stop:  # the number of tetrahedra in layers, and more
        if not 0 <= stream.one("n") <= sizes[2]:
            raise ValueError("more numbers than the seven counts in front announce.")
        notes.append(
            "what follows the cells (tetrahedra of boundary layers) is not read, and stays."
        )
    return of_grid(path, NAME, content, grid, notes=notes)


def check(path: Path, mesh: MeshLike) -> None:
    check_form(path, mesh, NAME, find_form)
