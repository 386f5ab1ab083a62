"""`jaxmorph quality` and `jaxmorph info`."""

import argparse
import sys

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._progress import Progress
from ._tables import alone, compared, inverted_cells


def quality(arguments: argparse.Namespace) -> int:
    """Prints the quality of a mesh, or of two with the same cells. Returns the exit status."""
    progress = Progress("jaxmorph quality")
    with progress("reading"):
        mesh = io.read(arguments.file)
        moved = None if arguments.moved is None else io.read(arguments.moved)
    with progress("judging the cells"):
        report = jm.quality(mesh)
        if moved is None:
            text = alone(report)
        else:
            _check_same(arguments, mesh, moved)
            before, report = report, jm.quality(mesh, moved.points)
            text = compared(before, report)
    print(text)
    bad = inverted_cells(report)
    if bad:
        print(f"jaxmorph quality: {bad}", file=sys.stderr)
    return 1 if bad else 0


def info(arguments: argparse.Namespace) -> int:
    """Prints what a mesh file holds. Returns the exit status."""
    with Progress("jaxmorph info")("reading"):
        mesh = io.read(arguments.file)
    points = np.asarray(mesh.points)
    n, d = points.shape
    print(f"{arguments.file.name}: {d}-D, {n} points")
    print("cells    " + ", ".join(f"{len(corners)} {kind}" for kind, corners in mesh.cells.items()))
    for name, low, high in zip("xyz", points.min(axis=0), points.max(axis=0), strict=False):
        print(f"{name:<9}{low:.6g} to {high:.6g}")
    print("patches" if mesh.patches else "patches  none")
    width = max(map(len, mesh.patches), default=0)
    for name, nodes in mesh.patches.items():
        print(f"  {name:<{width}}  {len(nodes):>9} nodes")
    return 0


def _check_same(arguments: argparse.Namespace, mesh: Mesh, moved: Mesh) -> None:
    a, b = tuple(mesh.points.shape), tuple(moved.points.shape)
    if a != b:
        raise ValueError(f"{arguments.moved} has points of shape {b}, {arguments.file} of {a}: not the same mesh.")
    same = mesh.cells.keys() == moved.cells.keys() and all(
        np.array_equal(corners, moved.cells[kind]) for kind, corners in mesh.cells.items()
    )
    if not same:
        raise ValueError(f"{arguments.moved} has other cells than {arguments.file}: not the same mesh, moved.")
