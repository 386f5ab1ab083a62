"""A CAD model as design variables: the nodes of a wall stay where they are on its faces."""

import functools
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree
from numpy import ndarray

import jaxmorph as jm
from jaxmorph import Facets, Mesh, Plan
from jaxmorph.extend import between, checked, finite_array, host_call, is_known, warn, whole

from ._arguments import Numbers, Positions, positions
from ._cad_cells import ParameterMesh
from ._cad_wall import Builder, WallOnModel, wall_on_model
from ._shape import AbstractShape, Move

STEP = 1e-5
"""Of differences: share of a number where the model starts, or the step of one that is 0 there."""

Design = Float[Array, " p"]
KEPT = 16  # models that are kept, by their numbers


class CAD(AbstractShape):
    """Moves a wall with a CAD model that is built anew from other numbers.

    Each node is found once, on a face, an edge or a vertex of the model. It stays there: at its
    share of the edge, at its parameters of the face. Where the border of a face moves in these
    parameters, as beside a fillet that grows, its inner nodes are carried by `LinearElasticity`.
    The nodes are on the model also at `x0`, where they may have been off by the tolerance.

        def build(x):
            return cadquery.Workplane().box(x[0], x[1], 1.0)

        wall = shapes.CAD(build, [2.0, 3.0], mesh, "wing")
        points = jm.deform(plan, wall([2.1, 3.0]))  # of jm.prepare(mesh, "wing", "farfield")

    Derivatives are central differences: two models for each number. In traced code numbers without
    a model give displacements that are not finite, and a warning says why.

    **Arguments:**

    - `build`: takes numbers as `x0` has them to a shape of OpenCASCADE, CadQuery or build123d.
    - `x0`: numbers (p,), or a pytree such as a dict by name, of the model that was meshed.
    - `mesh`, `patches`: a mesh in 3-D in the model's unit, and patches of the wall. Row i is node
      `mesh.patch(*patches)[i]`.
    - `tolerance`: how far a node may be off the model. Default: 0.01 of the shortest edge at the
      node. A node on an edge or vertex is as near to it as the farthest node is to the model.
    - `step`: of the differences, one for all or (p,). Default: 1e-5 of each number of `x0`.
    - `processes`: that build models for derivatives, if `build` can be imported. A script then
      needs `if __name__ == "__main__":`. Default 1, this one.

    **Raises:** `ImportError` without OpenCASCADE. `ValueError` for nodes off the model. When
    called: where `build` fails, and where the model has other faces or edges.
    """

    x0: PyTree
    plan: Plan | None
    models: "ModelsByNumbers" = eqx.field(static=True)

    @checked
    def __init__(
        self,
        build: Callable[[Any], Any],
        x0: PyTree,
        mesh: Mesh,
        *patches: str,
        tolerance: float | None = None,
        step: Any = None,
        processes: int = 1,
    ):
        whole("processes", processes, 1)
        if tolerance is not None:
            between("tolerance", tolerance, 0)
        if mesh.points.shape[1] != 3:
            raise ValueError("a CAD model moves walls of meshes in 3-D; this mesh is in 2-D.")
        for leaf in jax.tree.leaves(x0):
            finite_array("x0", np.ravel(leaf), (None,))
        self.x0 = jax.tree.map(lambda leaf: np.array(leaf, float), _row_as_array(x0))
        leaves, structure = jax.tree.flatten(self.x0)
        start = np.concatenate([np.zeros(0), *map(np.ravel, leaves)])
        if not len(start):
            raise ValueError("`x0` holds no numbers; a model is built from one or more.")
        builder = Builder(build, structure, tuple(map(np.shape, leaves)))
        step = STEP * np.where(start != 0, np.abs(start), 1) if step is None else step
        step = finite_array("step", np.ravel(step), (1,), start.shape) + 0 * start
        if (step <= 0).any():
            raise ValueError("`step` must be above 0.")
        points = np.asarray(mesh.points, float)[mesh.patch(*patches)]
        triangles = np.asarray(Facets.of(mesh, *patches).faces)
        wall, cells = wall_on_model(builder, start, points, triangles, tolerance)
        self.plan = _flat_plan(cells)
        self.models = ModelsByNumbers(wall, step, processes)

    def neutral(self) -> PyTree:
        return self.x0

    def at(self, x: Numbers) -> Move:
        """Returns the function from numbers to displacements (m, 3), those of `x` (m, 3) too."""
        positions(x, like=self.models.wall.points.shape)
        return self._displacement

    def __call__(self, x: Any, parameters: Any = None) -> Positions:
        """Moves positions (m, 3). Of numbers alone it computes the displacement (m, 3)."""
        if parameters is None:
            return self._displacement(x)
        x = positions(x, like=self.models.wall.points.shape)
        return x + self._displacement(parameters).astype(x.dtype)

    def _displacement(self, parameters: PyTree) -> Positions:
        """Computes the displacement (m, 3) of the wall's nodes. Traced."""
        parameters = _row_as_array(parameters)
        given, needed = (jax.tree.map(np.shape, tree) for tree in (parameters, self.x0))
        if given != needed:
            raise ValueError(f"the numbers have shapes {given}; this model takes {needed}.")
        x = ravel_pytree(jax.tree.map(jnp.asarray, parameters))[0]
        x = x.astype(jnp.result_type(x.dtype, jnp.float32))
        return _follow(x, self.plan, self.models)


def _row_as_array(numbers: PyTree) -> PyTree:
    if isinstance(numbers, list | tuple) and not any(map(np.ndim, numbers)):
        return np.array(numbers, float) if is_known(numbers) else jnp.stack(numbers)
    return numbers


def _flat_plan(cells: ParameterMesh) -> Plan | None:
    count = len(cells.borders.use)
    if not (count and len(cells.inner)):
        return None
    mesh = Mesh(cells.points.astype(jnp.result_type(float)), {"triangle": cells.cells})
    free = np.arange(count, len(cells.points))
    return jm.prepare(mesh, np.arange(count), method=jm.LinearElasticity(), free=free)


def _in_numbers(method: Callable[..., Any]) -> Callable[..., Any]:
    """In traced code nothing raises: without a model the result is not a number."""

    @functools.wraps(method)
    def call(self, *arguments):
        try:
            return method(self, *arguments)
        except ValueError as error:
            warn(str(error))
            return np.nan

    return call


class ModelsByNumbers:
    """What a wall asks of models, by their numbers (p,), on the host. It compares by identity."""

    def __init__(self, wall: WallOnModel, step: Float[ndarray, " p"], processes: int):
        self.wall = wall
        self.step = step
        self.processes = processes
        self.built = functools.lru_cache(KEPT)(lambda data: wall.build(np.frombuffer(data)))

    def __reduce__(self) -> tuple[Any, ...]:
        return ModelsByNumbers, (self.wall, self.step, self.processes)

    def model(self, x: ndarray) -> Any:
        return self.built(np.ascontiguousarray(x, float).tobytes())

    def check(self, x: Design) -> None:
        """Raises `ValueError` for known numbers without a model of this topology."""
        if is_known(x):
            self.model(np.asarray(x))

    @_in_numbers
    def borders(self, x: ndarray) -> Any:
        return self.wall.evaluate(self.model(x), np.zeros((len(self.wall.inner), 2)))[1]

    @_in_numbers
    def displacements(self, x: ndarray, carried: ndarray) -> Any:
        return self.wall.evaluate(self.model(x), carried)[0] - self.wall.points

    @_in_numbers
    def sides(self, x: ndarray, carried: ndarray) -> Any:
        return self.wall.sides(self.model(x), carried)

    @_in_numbers
    def rates(self, x: ndarray, carried: ndarray) -> Any:
        """Derivatives of places and borders (3 m + 2 b, p) by the numbers, `carried` held."""
        x = x.astype(float)
        steps = [sign * row for row in np.diag(self.step) for sign in (1, -1)]
        found = self._evaluated([x + step for step in steps], carried)
        columns = []
        for number, (ahead, behind) in enumerate(zip(found[::2], found[1::2], strict=True)):
            values = [each for each in (ahead, behind) if not isinstance(each, str)]
            if not values:
                raise ValueError(str(ahead))
            if len(values) == 1:  # beyond the last model of this topology
                here = self.wall.values(self.model(x), carried)
                ahead, behind = (
                    here if isinstance(each, str) else each for each in (ahead, behind)
                )
            columns.append((ahead - behind) / (len(values) * self.step[number]))
        return np.stack(columns, axis=1)

    def _evaluated(self, numbers: list[ndarray], carried: ndarray) -> list[Any]:
        evaluate = functools.partial(self.wall.values_or_reason, carried=carried)
        if self.processes == 1:
            return [evaluate(x) for x in numbers]
        try:
            return [*self._pool.map(evaluate, numbers)]
        except (BrokenProcessPool, AttributeError, TypeError, ImportError) as error:
            raise ValueError(
                f"`build` does not run in other processes ({error}): it must be a function of a "
                'module, and a script needs `if __name__ == "__main__":`. Or leave out `processes`.'
            ) from error

    @functools.cached_property
    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.processes, multiprocessing.get_context("spawn"))


def _called(method: Callable[..., Any], shape: tuple[int, ...], *arguments: Array) -> Array:
    return host_call(method, jax.ShapeDtypeStruct(shape, arguments[0].dtype), *arguments)


def _border_motion(x: Design, plan: Plan, models: ModelsByNumbers) -> Float[Array, "b 2"]:
    return _called(models.borders, (plan.n_moving, 2), x).astype(plan.points.dtype)


def _carried(borders: Float[Array, "b 2"], plan: Plan) -> Float[Array, "k 2"]:
    return (jm.deform(plan, borders) - plan.points)[plan.n_moving :]


@eqx.filter_custom_jvp
def _follow(x: Design, plan: Plan | None, models: ModelsByNumbers) -> Positions:
    models.check(x)
    carried = jnp.zeros((0, 2), x.dtype)
    if plan is not None:
        carried = _carried(_border_motion(x, plan, models), plan).astype(x.dtype)
    return _called(models.displacements, models.wall.points.shape, x, carried)


@_follow.def_jvp
def _follow_jvp(primals: Any, tangents: Any) -> tuple[Positions, Positions]:
    x, plan, models = primals
    models.check(x)
    x_dot = jnp.zeros_like(x) if tangents[0] is None else tangents[0]
    m = len(models.wall.points)
    borders = carried = jnp.zeros((0, 2), x.dtype)
    if plan is not None:
        borders = _border_motion(x, plan, models)
        carried = _carried(borders, plan).astype(x.dtype)
    count = 3 * m + 2 * len(models.wall.borders.use)
    rates = _called(models.rates, (count, len(x)), x, carried)
    dot = jnp.matmul(rates, x_dot, precision="highest")
    moved = dot[: 3 * m].reshape(m, 3)
    if plan is not None:
        border_dot = dot[3 * m :].reshape(-1, 2).astype(borders.dtype)
        carried_dot = jax.jvp(lambda rows: _carried(rows, plan), (borders,), (border_dot,))[1]
        sides = _called(models.sides, (len(carried), 2, 3), x, carried)
        change = jnp.einsum("kp,kpd->kd", carried_dot.astype(x.dtype), sides, precision="highest")
        moved = moved.at[models.wall.inner].add(change)
    return _follow(x, plan, models), moved
