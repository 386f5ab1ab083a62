"""The methods by name, for the command line, `compare` and the benchmarks."""

import dataclasses
import functools
import importlib
import typing
from collections.abc import Callable, Mapping
from typing import Any

if typing.TYPE_CHECKING:
    from .._methods.base import AbstractMethod

MOST_POINTS = {
    2: 100_000,
    3: 40_000,
}  # points of a mesh, by dimension, up to which methods on its cells are tried


@dataclasses.dataclass(frozen=True)
class Entry:
    """A method of the list; `make` takes the size of the wall, the largest extent along an axis."""

    path: str  # its name in `jaxmorph`, or that of its constructor
    sentence: str  # for help and the output of commands
    needs_cells: bool = False  # True where it solves on the mesh's cells
    # nodes of the wall that are sources: `some` (then the number is free), `all` or `none`
    sources: str = "none"
    is_tried: bool = False  # True where `compare` tries it, beside the default
    # True where `jaxmorph deform` tries it after the default has inverted cells
    is_cure: bool = False
    title: str = ""  # its name in tables of the benchmarks, where that is not `name`
    numbers: Callable[[float], tuple[float, ...]] = (
        lambda size: ()
    )  # its arguments, from the wall's size
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # further arguments

    def make(self, size: float) -> "AbstractMethod":
        constructor: Any = functools.reduce(
            getattr, self.path.split("."), importlib.import_module("jaxmorph")
        )
        return constructor(*self.numbers(size), **self.options)


_COARSE = "reduced radial basis functions"

METHODS = {
    "default": Entry("SurfaceReconstruction", f"{_COARSE} + near-wall correction", sources="some"),
    "published": Entry("SurfaceReconstruction.published", f"{_COARSE} + graph", sources="some"),
    "rbf": Entry("RBF.classic", "full radial basis functions", sources="all", title="classic RBF"),
    "graph": Entry("DelaunayGraph", "Delaunay graph mapping", is_tried=True),
    "multiscale": Entry(
        "Multiscale.whole",
        "compact functions from the largest scale to the smallest",
        numbers=lambda size: (2 * size, 0.1),
        is_tried=True,
    ),
    "laplacian": Entry(
        "Laplacian",
        "Laplace's equation, diffusivity 1/distance^2",
        needs_cells=True,
        title="Laplacian 1/d^2",
    ),
    "biharmonic": Entry("Biharmonic", "the biharmonic equation", needs_cells=True, is_tried=True),
    "elasticity": Entry(
        "LinearElasticity",
        "linear elasticity, stiff by 1/volume",
        needs_cells=True,
        is_tried=True,
        is_cure=True,
        title="elasticity 1/V",
    ),
    "springs": Entry(
        "SpringAnalogy", "springs along the edges", needs_cells=True, title="springs 1/l^2"
    ),
    "torsional": Entry(
        "TorsionalSprings",
        "torsional springs",
        needs_cells=True,
        is_tried=True,
        is_cure=True,
        title="torsional springs",
    ),
    "inverse-distance": Entry(
        "InverseDistance", "inverse distances", sources="all", title="inverse distance"
    ),
    "turning": Entry(
        "InverseDistance",
        "inverse distances, with nodes that turn",
        sources="all",
        is_tried=True,
        title="inverse distance, turning",
        options={"rotations": True},
    ),
    "compact": Entry(
        "CompactRBF",
        "radial basis functions of compact support",
        sources="all",
        title="compact RBF",
    ),
}
"""Methods by the words that `--method` and the table of `compare` have for them.

`jm.METHODS["elasticity"].make(chord)` makes one. `compare` tries them in this order.
"""
