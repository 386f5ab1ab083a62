"""The contract of a method: abstract classes of methods and fields, and converters of numbers."""

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._host.package.arguments import between
from .._kernels.module import Module
from .._kernels.values import is_known
from .surface import Surface

matmul = functools.partial(jnp.matmul, precision="highest")
einsum = functools.partial(jnp.einsum, precision="highest")

Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Point = Float[Array, " d"]
Points = Float[Array, "n d"]  # coordinates or displacements of a mesh's points
Rows = Float[Array, "b d"]  # coordinates or displacements of the rows of a surface
Pairs = Int[Array, "e 2"]  # of nodes

POINT_BLOCK = 512  # points in a block: memory, also of derivatives, is that of one block


@dataclasses.dataclass(frozen=True)
class Control:
    """Rows of the surface that control a field, and how far the field reaches.

    - `sources` (s,): the field's control points, the centres of its functions.
    - `matched` (k,): rows whose displacement the field reproduces: nothing is left to a correction.
    - `reach`: how far from the surface the field extends.
    """

    sources: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    matched: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    reach: float = float("inf")


class AbstractField(Module):
    """Evaluates a displacement field, written for one point."""

    @abc.abstractmethod
    def __call__(self, x: Point, ids: PyTree) -> Point:
        """Computes the displacement at `x`; `ids` are those of `connect` or `place` for it."""

    def evaluate(self, points: Float[Array, "c d"], ids: PyTree) -> Float[Array, "c d"]:
        """Computes the displacements of a block of c points; leaves of `ids` have a row for each.
        By default it maps the one-point form; an override is for speed alone.
        """
        return jax.vmap(self)(points, ids)

    @property
    def varying(self) -> PyTree:
        """The arrays that depend on `u`: in `pullback` no others have a derivative. By default all,
        of inner fields those that they name. An override leaves some out, for speed alone.
        """

        def is_inner(part: Any) -> bool:
            return isinstance(part, AbstractField) and part is not self

        parts = jax.tree.leaves(self, is_leaf=is_inner)
        return [part.varying if is_inner(part) else part for part in parts]

    @property
    def block_size(self) -> int | None:
        """Points in a block; None if the memory needs no blocks."""
        return POINT_BLOCK


class AbstractWhole(AbstractField):
    """A field that makes no blocks: its memory is small, or its parts make their own."""

    @property
    def block_size(self) -> None:
        return None


class Remainder(eqx.Module):
    """What a coarse field leaves to a correction at the surface's rows.

    - `u` (b, d): displacements.
    - `offset` (b, d): `u` less the coarse field there (eq. 5).
    - `coarse`: the coarse field, or None if it is known at the mesh's points alone.
    """

    u: Rows
    offset: Rows
    coarse: AbstractField | None


class AbstractMethod(Module):
    """Turns displacements of the surface into a displacement field.

    A method of your own needs `connect`, `fit` and `field`; all other functions have defaults. A
    method that computes something for each point once per base mesh is an `AbstractPlacing`. The
    surface's b rows are the moving nodes, then those at rest or guided, then images; none twice.
    The arguments of all functions:

    - `surface`: on the host a `Surface`; traced the coordinates (b, d) of its rows.
    - `points`: all points (n, d) of the mesh, in `fit` its base coordinates. `x` is one point (d,).
    - `ids`: results of `connect` for the surface; in the field for a point.
    - `factors`: results of `fit`.
    - `u`: displacements (b, d) of the surface's rows.
    """

    @abc.abstractmethod
    def connect(self, surface: Surface, points: Float[np.ndarray, "n d"]) -> tuple[PyTree, PyTree]:
        """Finds ids for the surface, and for every point (n rows). Once, on the host."""

    @abc.abstractmethod
    def fit(self, ids: PyTree, surface: Rows, points: Points) -> PyTree:
        """Computes the part of the solve that does not depend on `u`. Traced."""

    @abc.abstractmethod
    def field(self, ids: PyTree, factors: PyTree, surface: Rows, u: Rows) -> AbstractField:
        """Makes the displacement field. Traced, and linear in `u` for a method that is `linear`."""

    def correct(
        self, ids: PyTree, factors: PyTree, surface: Rows, left: Remainder
    ) -> AbstractField:
        """Makes the field of what a coarse field leaves, by default that of the offset. Traced."""
        return self.field(ids, factors, surface, left.offset)

    def place(self, x: Point, ids: PyTree, factors: PyTree, surface: Rows) -> PyTree:
        """Returns the ids of a point; an `AbstractPlacing` computes its place. Traced."""
        return ids

    def carry(self, ids: PyTree, factors: PyTree, surface: Rows, points: Points) -> PyTree:
        """Computes factors on the mesh after a step of `march`, by default with `fit`. Traced.
        Factors that belong to the places of points stay as they are.
        """
        return self.fit(ids, surface, points)

    def carry_place(
        self, x: Point, ids: PyTree, factors: PyTree, surface: Rows, placed: PyTree
    ) -> PyTree:
        """Changes a point's place after a step of `march`; it stays by default. Traced."""
        return placed

    def control(self, ids: PyTree) -> Control:
        """Returns the rows that control the field, on the host; none by default."""
        return Control()

    def check(self, ids: PyTree, factors: PyTree, u: Rows) -> None:
        """Raises or warns when the factors are unusable, by a trial displacement `u`. Once, on the
        host, after the first `fit`.
        """

    @property
    def needs_cells(self) -> bool:
        """True if `connect` needs all cells of the mesh: a plan is then not split over devices."""
        return False

    @property
    def linear(self) -> bool:
        """True if the displacement is linear in `u`. The transpose then does not depend on `u`."""
        return True

    @property
    def exact(self) -> bool:
        """True if the field reproduces displacements at the surface: the driver keeps all bits."""
        return True


class AbstractPlacing(AbstractMethod):
    """A method that computes something for each point once per base mesh: its place.

    In `place` and `carry_place`, `ids` is the result of `connect` for the point. The field gets the
    point's place as its `ids`. `carry` and `carry_place` adapt to the mesh after a step of `march`.
    By default the solve is new and points keep their places: a graph stands on the undeformed mesh.
    A method of your own around one that places points is an `AbstractPlacing`, too.
    """

    @abc.abstractmethod
    def place(self, x: Point, ids: PyTree, factors: PyTree, surface: Rows) -> PyTree:
        """Computes the place of a point: its ids, and numbers that do not depend on `u`. Traced."""


def or_one(values: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Makes divisors of values that are not negative."""
    return jnp.where(values > 0, values, 1)


def has_part(method: AbstractMethod, kind: type) -> bool:
    """Checks whether a method is of a kind, or made of such a method."""
    parts = jax.tree.leaves(method, is_leaf=lambda node: isinstance(node, kind))
    return any(isinstance(part, kind) for part in parts)


def check_kind(value: Any, kind: type, name: str, example: str, *, optional: bool = False) -> None:
    if isinstance(value, kind) or (optional and value is None):
        return
    if isinstance(value, type):
        raise ValueError(
            f"`{name}` is the class {value.__name__}: call it, {name}={value.__name__}()."
        )
    what = kind.__name__.removeprefix("Abstract").lower()
    raise ValueError(f"`{name}` must be a {what} object such as {name}={example}, not {value!r}.")


def number(
    name: str, low: float | int = -np.inf, high: float | int = np.inf, ends: str = "()"
) -> Callable[[Any], Any]:
    """A converter to one real number in an interval, `ends` as for `between`, or a `ValueError`."""

    def convert(value: Any) -> Scalar:
        if is_known(value):
            between(name, value, low, high, ends)
        value = jnp.asarray(float(value) if isinstance(value, int) else value)
        return value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)

    return convert


def number_or_none(name: str, *limits: Any) -> Callable[[Any], Any]:
    convert = number(name, *limits)
    return lambda value: None if value is None else convert(value)
