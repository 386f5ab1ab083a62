"""The list of methods: the command line, `choose` and the benchmarks read it. A new method is one more entry."""

import dataclasses
import functools
import importlib
import typing
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

if typing.TYPE_CHECKING:
    from .._methods.base import AbstractMethod


@runtime_checkable
class Lengths(Protocol):
    """Lengths of a boundary, in the mesh's units: the moving nodes' extent, and the gap to the nearest fixed node."""

    @property
    def size(self) -> float: ...

    @property
    def gap(self) -> float: ...


@dataclasses.dataclass(frozen=True)
class Entry:
    """One method of the list.

    - `name`: its name as a word, for flags and the table of `choose`.
    - `make`: makes it for the lengths of a boundary. The module of the method is imported then, not before.
    - `sentence`: what it is, for help and the output of commands.
    - `needs_cells`: True where it solves on the mesh's cells.
    - `sources`: which nodes of the wall are sources: `some` (then the number is free), `all` or `none`.
    - `is_tried`: True where `choose` tries it, beside the radial functions that it varies itself.
    - `is_cure`: True where `jaxmorph deform` tries it after the default has inverted cells.
    - `title`: its name in tables of the benchmarks. Default `name`.
    """

    name: str
    make: "Callable[[Lengths], AbstractMethod]"
    sentence: str
    needs_cells: bool = False
    sources: str = "none"
    is_tried: bool = False
    is_cure: bool = False
    title: str = ""

    def __post_init__(self):
        object.__setattr__(self, "title", self.title or self.name)


def _made(path: str, *numbers: Any, **options: Any) -> Any:
    """Calls a class or constructor of `_methods`: `cells.springs.TorsionalSprings` stands in `cells/springs.py`."""
    words = path.split(".")
    first = next(k for k, word in enumerate(words) if word[0].isupper())
    module = importlib.import_module("." + ".".join(words[:first]), "jaxmorph._methods")
    return functools.reduce(getattr, words[first:], module)(*numbers, **options)


def _corrected(coarse: Any) -> Any:
    """Corrects a coarse field near the wall."""
    return _made("reconstruction.SurfaceReconstruction", coarse, _made("nearwall.NearWall"))


METHODS = (
    Entry(
        "default",
        lambda wall: _made("reconstruction.SurfaceReconstruction"),
        "reduced radial basis functions + near-wall correction",
        sources="some",
    ),
    Entry(
        "published",
        lambda wall: _made("reconstruction.SurfaceReconstruction.published"),
        "reduced radial basis functions + graph",
        sources="some",
    ),
    Entry(
        "rbf",
        lambda wall: _made("rbf.rbf.RBF.classic"),
        "full radial basis functions",
        sources="all",
        title="classic RBF",
    ),
    Entry("graph", lambda wall: _made("delaunay.DelaunayGraph"), "Delaunay graph mapping", is_tried=True),
    Entry(
        "multiscale",
        lambda wall: _made("multiscale.Multiscale.whole", 2 * wall.size, 0.1),
        "compact functions from the largest scale to the smallest",
        is_tried=True,
    ),
    Entry(
        "laplacian",
        lambda wall: _made("cells.laplacian.Laplacian"),
        "Laplace's equation, diffusivity 1/distance^2",
        needs_cells=True,
        title="Laplacian 1/d^2",
    ),
    Entry(
        "biharmonic",
        lambda wall: _made("cells.laplacian.Biharmonic"),
        "the biharmonic equation",
        needs_cells=True,
        is_tried=True,
    ),
    Entry(
        "elasticity",
        lambda wall: _made("cells.elasticity.LinearElasticity"),
        "linear elasticity, stiff by 1/volume",
        needs_cells=True,
        is_tried=True,
        is_cure=True,
        title="elasticity 1/V",
    ),
    Entry(
        "springs",
        lambda wall: _made("cells.springs.SpringAnalogy"),
        "springs along the edges",
        needs_cells=True,
        title="springs 1/l^2",
    ),
    Entry(
        "torsional",
        lambda wall: _made("cells.springs.TorsionalSprings"),
        "torsional springs",
        needs_cells=True,
        is_tried=True,
        is_cure=True,
        title="torsional springs",
    ),
    Entry(
        "inverse-distance",
        lambda wall: _made("inverse_distance.InverseDistance"),
        "inverse distances",
        sources="all",
        title="inverse distance",
    ),
    Entry(
        "turning",
        lambda wall: _made("inverse_distance.InverseDistance", rotations=True),
        "inverse distances, with nodes that turn",
        sources="all",
        is_tried=True,
        title="inverse distance, turning",
    ),
    Entry(
        "rigid",
        lambda wall: _corrected(_made("rigid.RigidBlend", 0.25 * wall.size, wall.gap)),
        "a rigid motion that fades + near-wall correction",
        is_tried=True,
    ),
    Entry(
        "compact",
        lambda wall: _made("rbf.compact.CompactRBF"),
        "radial basis functions of compact support",
        sources="all",
        title="compact RBF",
    ),
)
"""Methods in the order in which `choose` tries them; ones that are not linear in `u` come after those that are."""


def entry(name: str) -> Entry:
    """Finds the entry of a name that is in the list."""
    return next(each for each in METHODS if each.name == name)
