"""What an optimiser needs: the smallest Jacobian ratio as a smooth constraint, and a history of
iterations in a small file, which goes on after a kill.
"""

import dataclasses
import functools
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy import ndarray

from jaxmorph import DesignedMesh
from jaxmorph.extend import (
    Module,
    PathLike,
    between,
    checked,
    finite_array,
    input_path,
    output_path,
    real_array,
    whole,
)

from ._arguments import Numbers, Scalar, Vector


@dataclasses.dataclass(frozen=True)
class QualityRows:
    """The smallest Jacobian ratios at corners of a moved mesh, with their derivatives.

    - `values` (k,): the ratios less the bound, ascending; below 0 the bound is broken.
    - `matrix` (k, p): derivatives by the design variables. A step `s` gives `values + matrix @ s`.
    - `cells` (k,): the cells, in the order of `quality`.
    """

    values: Float[ndarray, " k"]
    matrix: Float[ndarray, "k p"]
    cells: Int[ndarray, " k"]


class LastDesign:
    """Mutable, so that a guard compares it by identity."""

    value: Float[ndarray, " p"] | None = None


class MeshGuard(Module):
    """A constraint that keeps the mesh valid: a soft smallest Jacobian ratio less a bound.

    The soft ratio is -log(sum(exp(-sharpness ratio))) / sharpness over all corners of cells, and
    centres of hexahedra. It lies below the smallest ratio, by log(count) / sharpness at most: a
    design with a constraint of 0 or more is feasible. It is twice differentiable, along any motion.

        motion = lambda p: shapes.displacement(bumps, plan, p)
        guard = shapes.MeshGuard(jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.1))
        options = {"jac": True, "method": "SLSQP", "constraints": guard.constraint()}
        scipy.optimize.minimize(guard.guarded(drag), start, **options)

    **Arguments:**

    - `mesh`: a `DesignedMesh`, moved by design variables (p,), with its bound.
    - `sharpness`: positive, default 100. A larger value is closer to the smallest ratio, and bends
      more.

    **Raises:** `ValueError` for a sharpness that is not positive.
    """

    mesh: DesignedMesh
    sharpness: float = eqx.field(static=True)
    last: LastDesign = eqx.field(static=True)

    @checked
    def __init__(self, mesh: DesignedMesh, *, sharpness: float = 100.0):
        between("sharpness", sharpness, 0)
        self.mesh = mesh
        self.sharpness = float(sharpness)
        self.last = LastDesign()

    def __call__(self, design: Any) -> Scalar:
        ratios = self.mesh.ratios(design)
        return (
            -jax.scipy.special.logsumexp(-self.sharpness * ratios) / self.sharpness
            - self.mesh.bound
        )

    def value(self, design: Numbers) -> float:
        """Computes the constraint at design variables (p,), for NumPy."""
        return float(eqx.filter_jit(self)(_flat(design)))

    def smallest(self, design: Numbers) -> float:
        """Computes the smallest ratio itself, which has kinks, at design variables (p,)."""
        return float(eqx.filter_jit(self.mesh.ratios)(_flat(design)).min())

    def gradient(self, design: Numbers) -> Float[ndarray, " p"]:
        """Computes the derivative by each design variable (p,), for NumPy."""
        return np.asarray(eqx.filter_jit(eqx.filter_grad(self))(_flat(design)), float)

    def quality_rows(self, design: Numbers, count: int) -> QualityRows:
        """Finds the `count` smallest ratios at design variables (p,), and their derivatives: rows
        of a linear program whose step keeps all corners above the bound.

        **Raises:** `ValueError` for more rows than the cells have Jacobians.
        """
        values, chosen, matrix = eqx.filter_jit(self._rows)(
            _flat(design), self._checked_count(count)
        )
        cells = self.mesh.cells[np.asarray(chosen)]
        return QualityRows(np.asarray(values, float), np.asarray(matrix, float), cells)

    def _checked_count(self, count: int) -> int:
        if whole("count", count) > (total := (self.mesh.cells >= 0).sum()):
            raise ValueError(f"`count` is {count}; the cells have {total} Jacobians.")
        return count

    def _rows(
        self, design: Vector, count: int
    ) -> tuple[Float[Array, " k"], Int[Array, " k"], Float[Array, "k p"]]:
        ratios = self.mesh.ratios(design)
        chosen = jax.lax.top_k(-ratios, count)[1]
        slopes = jax.jacfwd if len(design) <= count else jax.jacrev
        matrix = slopes(lambda design: self.mesh.ratios(design)[chosen])(design)
        return ratios[chosen] - self.mesh.bound, chosen, matrix

    def constraint(self, count: int | None = None) -> dict[str, Any]:
        """Makes the constraint of `scipy.optimize.minimize` with its derivative: on the soft
        smallest ratio, or on the ratios of the `count` smallest corners.
        """
        if count is None:
            return {"type": "ineq", "fun": self.value, "jac": self.gradient}
        count = self._checked_count(count)
        rows = functools.lru_cache(1)(
            lambda design: self.quality_rows(np.frombuffer(design), count)
        )
        at = lambda design: rows(np.asarray(design, float).tobytes())  # noqa: E731
        return {
            "type": "ineq",
            "fun": lambda design: at(design).values,
            "jac": lambda design: at(design).matrix,
        }

    def guarded(self, objective: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Makes an objective that is infinite, without a flow, for an infeasible design: line
        searches step back. The objective takes design variables (p,), and returns its value and
        derivative (p,).
        """

        def guard(design: Any) -> tuple[float, Any]:
            if self.smallest(design) < self.mesh.bound:
                return np.inf, np.zeros(np.shape(design))
            self.last.value = np.array(design, float)
            return objective(design)

        return guard

    @checked
    def callback(self, function: Callable[[Any], Any]) -> Callable[..., Any]:
        """Makes the `callback` of `scipy.optimize.minimize`, for a history of feasible designs.

        It calls the function with the last design (p,) that `guarded` let through. SLSQP gives the
        first trial of each line search, which may invert cells.
        """
        return lambda *_: None if self.last.value is None else function(self.last.value)


def _flat(design: Any) -> Vector:
    return jnp.asarray(finite_array("design", design, (None,)), float)


Named = Mapping[str, Any] | None
FIELDS = ("design", "value", "constraints", "measures")  # fields of an iteration in the file


class History:
    """Iterations of an optimisation: lines of JSON, on the disk as soon as they are added.

        history = shapes.History("wing.jsonl")
        start = history.designs[-1] if len(history) else np.zeros(20)
        measures = {"jacobian_ratio": guard.smallest(design)}
        history.add(design, drag, constraints={"lift": lift}, measures=measures)

    An existing file is read first, less a truncated last line: the run goes on from its last
    iteration. Each new one is a line on the error stream too, with the seconds since the one
    before; the first takes longer, for it compiles. `plot.convergence(history)` draws it.

    **Raises:** `ValueError` for a file of anything else, with its line, and a missing folder.
    """

    @checked
    def __init__(self, path: PathLike):
        self.path = output_path(path)
        self.rows: list[dict[str, Any]] = []
        self._end = 0
        self._began = time.monotonic()
        self._word = ", with compiling"
        if not self.path.exists():
            return
        content = input_path(self.path).read_bytes()
        self._end = content.rfind(b"\n") + 1
        for number, line in enumerate(content[: self._end].splitlines(), start=1):
            try:
                row: Any = json.loads(line)
            except (ValueError, RecursionError):
                row = None
            good = (
                isinstance(row, dict)
                and set(row) == set(FIELDS)
                and isinstance(row["design"], list)
            )
            if not good or (self.rows and len(row["design"]) != len(self.rows[0]["design"])):
                raise ValueError(
                    f"{self.path}, line {number}: no iteration of one optimisation; found "
                    f"{line[:60]!r}."
                )
            self.rows.append(row)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def designs(self) -> Float[ndarray, "k p"]:
        """The design variables of each iteration."""
        return np.array([row["design"] for row in self.rows], float).reshape(len(self), -1)

    @property
    def values(self) -> Float[ndarray, " k"]:
        """The objective of each iteration; NaN where it was not finite."""
        return np.array([row["value"] for row in self.rows], float)

    @checked
    def column(self, name: str) -> Float[ndarray, "k *n"]:
        """Collects one constraint or measure over the iterations; NaN where an iteration lacks it.

        **Raises:** `ValueError` for a name that no iteration has.
        """
        values = [(row["constraints"] | row["measures"]).get(name) for row in self.rows]
        like = next((value for value in values if value is not None), None)
        if like is None:
            known = ", ".join(self.names) or "none"
            raise ValueError(f"no iteration has `name` {name!r}; there are: {known}.")
        return np.array(
            [np.full(np.shape(like), np.nan) if value is None else value for value in values], float
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of constraints and measures, in the order in which they came."""
        return tuple(
            dict.fromkeys(
                name for row in self.rows for name in (*row["constraints"], *row["measures"])
            )
        )

    @checked
    def add(
        self, design: Any, value: Any, *, constraints: Named = None, measures: Named = None
    ) -> None:
        """Adds an iteration, and writes it to the disk.

        It has design variables (p,), the objective, and numbers or lists of numbers by name; a
        number that is not finite becomes null.

        **Raises:** `ValueError` for another number of design variables, and for what is no number.
        """
        variables = finite_array("design", design, (None,))
        if self.rows and len(variables) != len(self.rows[0]["design"]):
            raise ValueError(
                f"`design` has {len(variables)} variables; {self.path} has "
                f"{len(self.rows[0]['design'])}."
            )
        row = {"design": variables.astype(float).tolist(), "value": _count_numbers("value", value)}
        for kind, given in (("constraints", constraints), ("measures", measures)):
            row[kind] = {
                name: _count_numbers(name, numbers) for name, numbers in (given or {}).items()
            }
        with self.path.open("r+b" if self.path.exists() else "xb") as file:
            file.truncate(self._end)  # a line that was cut off
            file.seek(self._end)
            file.write((json.dumps(row, allow_nan=False) + "\n").encode())
            file.flush()
            os.fsync(file.fileno())
            self._end = file.tell()
        others = [
            f"{name} {_show_variable(numbers)}"
            for name, numbers in (row["constraints"] | row["measures"]).items()
        ]
        shown = ", ".join([_show_variable(row["value"]), *others])
        seconds = f"{time.monotonic() - self._began:.3g}"
        print(
            f"iteration {len(self)}: {shown} ({seconds} s{self._word})", file=sys.stderr, flush=True
        )
        self.rows.append(row)
        self._began = time.monotonic()
        self._word = ""


def _show_variable(value: Any) -> str:
    numbers = np.array(value, float).ravel()
    ends = (
        dict.fromkeys(f"{end:.6g}" for end in (numbers.min(), numbers.max()))
        if numbers.size
        else ["none"]
    )
    return " to ".join(ends)


def _count_numbers(name: str, value: Any) -> Any:
    array = real_array(
        name, value if isinstance(value, list | tuple) else np.asarray(value), (), (None,)
    )
    return np.where(np.isfinite(array), array, np.array(None)).tolist()
