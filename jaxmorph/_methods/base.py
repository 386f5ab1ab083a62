"""The contract of a method: the abstract classes of methods and their fields."""

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from .._kernels.module import Module
from .surface import Surface

BLOCK = 512
"""Points evaluated together: memory, also for derivatives, is that of one block, whatever the size of the mesh."""


class Located(eqx.Module):
    """Counts how the location of a mesh's points went: answers `repaired`, and points that lie `outside` by round-off."""

    repaired: Int[Array, ""]
    outside: Int[Array, ""]


class AbstractRows(eqx.Module):
    """Rows of a linear operator, one a point, that may carry a table which makes the transpose as fast as the operator.

    What `AbstractPlacing.place` returns may hold such rows. The driver builds and keeps their tables.
    """

    @abc.abstractmethod
    def with_table(self, count: int, parts: int) -> "AbstractRows":
        """Adds a table, on the host, for rows of many points over `count` surface nodes, which lie in `parts` equal shares.

        Each share's table has positions within the share, and as many rows as the others.
        """

    @abc.abstractmethod
    def without_table(self) -> "AbstractRows":
        """Drops the table: every leaf then has one row a point."""

    @abc.abstractmethod
    def with_table_of(self, old: Any) -> "AbstractRows":
        """Takes over the table of rows with equal ids, with the weights of these rows. Traced."""


@dataclasses.dataclass(frozen=True)
class Control:
    """Rows of the surface that control a field, and how far the field reaches.

    - `sources` (s,): rows that are the field's control points, the centres of its functions.
    - `matched` (k,): rows whose displacement the field takes. They leave nothing to a correction.
    - `reach`: how far from the surface the field reaches.
    """

    sources: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    matched: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    reach: float = float("inf")


class AbstractField(Module):
    """Evaluates a displacement field, written for one point."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, " d"], ids: PyTree) -> Float[Array, " d"]:
        """Computes the displacement at `x`; `ids` is what `connect` chose for this point, or `place` made of it."""

    def evaluate(self, points: Float[Array, "c d"], ids: PyTree) -> Float[Array, "c d"]:
        """Computes the displacements of a block of c points. Equal to the mapped one-point form; there for speed alone.

        A leaf of `ids` has one row a point.
        """
        return jax.vmap(self)(points, ids)

    @property
    def block_size(self) -> int | None:
        """Points evaluated together. None if a point needs so little memory that no blocking is required."""
        return BLOCK


class AbstractMethod(Module):
    """Turns displacements of the surface into a displacement field.

    A method of your own needs `connect`, `fit` and `field`; the other functions have defaults. A method that needs of each point
    what its place gives is an `AbstractPlacing`. The surface's b rows are the moving nodes, then the fixed ones,
    no node twice. Arguments have the same meaning in all of a method's functions:

    - `surface`: on the host a `Surface`; traced the coordinates (b, d) of its rows.
    - `points`, `x`: all points (n, d) of the mesh, in `fit` its base coordinates; one of them (d,).
    - `ids`: what `connect` returned for the surface; in the field what it returned for one point.
    - `factors`: what `fit` returned.
    - `u`: displacements (b, d) of the surface's rows.
    """

    @abc.abstractmethod
    def connect(self, surface: Surface, points: Float[np.ndarray, "n d"]) -> tuple[PyTree, PyTree]:
        """Finds ids for the surface, and ids for every point (each leaf has n rows). Called once, on the host."""

    @abc.abstractmethod
    def fit(self, ids: PyTree, surface: Float[Array, "b d"], points: Float[Array, "n d"]) -> PyTree:
        """Computes the part of the solve that does not depend on `u`. Traced."""

    @abc.abstractmethod
    def field(
        self, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], u: Float[Array, "b d"]
    ) -> AbstractField:
        """Makes the displacement field. Traced, and linear in `u` for a method that is `linear`."""

    def control(self, ids: PyTree) -> Control:
        """Returns what controls the field, of the rows that `connect` chose, on the host; by default no row stands out."""
        return Control()

    def check(self, ids: PyTree, factors: PyTree, u: Float[Array, "b d"]) -> None:
        """Raises or warns when the factors are unusable. Called once, on the host, after the first `fit`.

        `u` is a displacement to try.
        """

    @property
    def needs_cells(self) -> bool:
        """True if `connect` needs the cells of the whole mesh. The solve is of all nodes: a plan is not laid over devices."""
        return False

    @property
    def linear(self) -> bool:
        """True if the displacement is linear in `u`. The transpose then does not depend on `u`."""
        return True

    @property
    def exact(self) -> bool:
        """True if the field takes the given displacements at the surface's nodes; they are then assigned bit for bit."""
        return True


def check_kind(value: Any, kind: type, name: str, example: str, *, optional: bool = False) -> None:
    """Raises `ValueError`, with the call to make, where an argument is not an object of its kind: a string, a class, a number."""
    if isinstance(value, kind) or (optional and value is None):
        return
    what = kind.__name__.removeprefix("Abstract").lower()
    if isinstance(value, type):
        raise ValueError(f"`{name}` is the class {value.__name__}: call it, {name}={value.__name__}().")
    raise ValueError(f"`{name}` must be a {what} object such as {name}={example}, not {value!r}.")
