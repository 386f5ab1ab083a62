"""The list of methods, read by the command line, `compare` and the benchmarks."""

import dataclasses
import functools
import importlib
import typing
from collections.abc import Callable, Mapping
from typing import Any

if typing.TYPE_CHECKING:
    from .._methods.base import AbstractMethod


MOST_POINTS = {2: 100_000, 3: 40_000}  # points of a mesh, by dimension, up to which methods on its cells are tried


@dataclasses.dataclass(frozen=True)
class Lengths:
    moving: Any
    fixed: Any

    @property
    def size(self) -> float:
        return float((self.moving.max(axis=0) - self.moving.min(axis=0)).max())


@dataclasses.dataclass(frozen=True)
class Entry:
    """One method of the list."""

    name: str  # its name as a word, for flags and the table of `compare`
    path: str  # in `_methods`: `cells.equations.Laplacian` is a class in `cells/equations.py`
    sentence: str  # for help and the output of commands
    needs_cells: bool = False  # True where it solves on the mesh's cells
    sources: str = "none"  # nodes of the wall that are sources: `some` (then the number is free), `all` or `none`
    is_tried: bool = False  # True where `compare` tries it, beside the default
    is_cure: bool = False  # True where `jaxmorph deform` tries it after the default has inverted cells
    title: str = ""  # its name in tables of the benchmarks, where that is not `name`
    numbers: Callable[[Lengths], tuple[float, ...]] = lambda wall: ()  # its arguments, from the lengths of a boundary
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # further arguments

    def make(self, wall: Lengths) -> "AbstractMethod":
        return _constructor(self.path)(*self.numbers(wall), **self.options)


def _constructor(path: str) -> Any:
    """Imports a class or constructor; its module ends before the first capital letter."""
    words = path.split(".")
    first = next(k for k, word in enumerate(words) if word[0].isupper())
    module = importlib.import_module("." + ".".join(words[:first]), "jaxmorph._methods")
    return functools.reduce(getattr, words[first:], module)


_COARSE = "reduced radial basis functions"

# fmt: off
METHODS = (
    Entry("default", "reconstruction.SurfaceReconstruction", f"{_COARSE} + near-wall correction", sources="some"),
    Entry("published", "reconstruction.SurfaceReconstruction.published", f"{_COARSE} + graph", sources="some"),
    Entry("rbf", "rbf.rbf.RBF.classic", "full radial basis functions", sources="all", title="classic RBF"),
    Entry("graph", "delaunay.DelaunayGraph", "Delaunay graph mapping", is_tried=True),
    Entry("multiscale", "multiscale.Multiscale.whole", "compact functions from the largest scale to the smallest",
          numbers=lambda wall: (2 * wall.size, 0.1), is_tried=True),
    Entry("laplacian", "cells.equations.Laplacian", "Laplace's equation, diffusivity 1/distance^2",
          needs_cells=True, title="Laplacian 1/d^2"),
    Entry("biharmonic", "cells.equations.Biharmonic", "the biharmonic equation", needs_cells=True, is_tried=True),
    Entry("elasticity", "cells.equations.LinearElasticity", "linear elasticity, stiff by 1/volume",
          needs_cells=True, is_tried=True, is_cure=True, title="elasticity 1/V"),
    Entry("springs", "cells.equations.SpringAnalogy", "springs along the edges", needs_cells=True, title="springs 1/l^2"),
    Entry("torsional", "cells.equations.TorsionalSprings", "torsional springs",
          needs_cells=True, is_tried=True, is_cure=True, title="torsional springs"),
    Entry("inverse-distance", "inverse_distance.InverseDistance", "inverse distances",
          sources="all", title="inverse distance"),
    Entry("turning", "inverse_distance.InverseDistance", "inverse distances, with nodes that turn",
          sources="all", is_tried=True, title="inverse distance, turning", options={"rotations": True}),
    Entry("compact", "rbf.compact.CompactRBF", "radial basis functions of compact support",
          sources="all", title="compact RBF"),
)
# fmt: on
"""Methods in the order in which `compare` tries them. Methods that are linear in `u` come first."""


def entry(name: str) -> Entry:
    return next(entry for entry in METHODS if entry.name == name)
