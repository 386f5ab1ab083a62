"""The iterations of an optimisation in a small file, which goes on after a kill."""

import json
import math
import os
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph.extend import checked, finite_array, input_path, output_path

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
    def __init__(self, path: str | os.PathLike[str]):
        self.path = output_path(path)
        self.rows: list[dict[str, Any]] = []
        self._end, self._began, self._word = 0, time.monotonic(), ", with compiling"
        if not self.path.exists():
            return
        content = input_path(self.path).read_bytes()
        self._end = content.rfind(b"\n") + 1
        for number, line in enumerate(content[: self._end].splitlines(), start=1):
            try:
                row: Any = json.loads(line)
            except (ValueError, RecursionError):
                row = None
            if not self._is_like(row):
                raise ValueError(f"{self.path}, line {number}: no iteration of one optimisation; found {line[:60]!r}.")
            self.rows.append(row)

    def _is_like(self, row: Any) -> bool:
        good = isinstance(row, dict) and set(row) == set(FIELDS) and isinstance(row["design"], list)
        return good and (not self.rows or len(row["design"]) == len(self.rows[0]["design"]))

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def designs(self) -> Float[np.ndarray, "k p"]:
        """The design variables of each iteration."""
        return np.array([row["design"] for row in self.rows], float).reshape(len(self), -1)

    @property
    def values(self) -> Float[np.ndarray, " k"]:
        """The objective of each iteration; NaN where it was not finite."""
        return np.array([row["value"] for row in self.rows], float)

    @checked
    def column(self, name: str) -> Float[np.ndarray, "k *n"]:
        """Collects one constraint or measure over the iterations; NaN where an iteration lacks it.

        **Raises:** `ValueError` for a name that no iteration has.
        """
        values = [({**row["constraints"], **row["measures"]}).get(name) for row in self.rows]
        like = next((value for value in values if value is not None), None)
        if like is None:
            known = ", ".join(self.names) or "none"
            raise ValueError(f"no iteration has `name` {name!r}; there are: {known}.")
        return np.array([np.full(np.shape(like), np.nan) if value is None else value for value in values], float)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of constraints and measures, in the order in which they came."""
        return tuple(dict.fromkeys(name for row in self.rows for name in (*row["constraints"], *row["measures"])))

    @checked
    def add(
        self,
        design: Any,
        value: Any,
        *,
        constraints: Mapping[str, Any] | None = None,
        measures: Mapping[str, Any] | None = None,
    ) -> None:
        """Adds an iteration, and writes it to the disk.

        It has design variables (p,), the objective, and numbers or lists of numbers by name; a
        number that is not finite becomes null.

        **Raises:** `ValueError` for another number of design variables, and for what is no number.
        """
        variables = finite_array("design", design, (None,))
        if self.rows and len(variables) != len(self.rows[0]["design"]):
            raise ValueError(f"`design` has {len(variables)} variables; {self.path} has {len(self.rows[0]['design'])}.")
        row = {
            "design": variables.astype(float).tolist(),
            "value": _numbers("value", value),
            "constraints": {name: _numbers(name, numbers) for name, numbers in (constraints or {}).items()},
            "measures": {name: _numbers(name, numbers) for name, numbers in (measures or {}).items()},
        }
        with self.path.open("r+b" if self.path.exists() else "xb") as file:
            file.truncate(self._end)  # a line that was cut off
            file.seek(self._end)
            file.write((json.dumps(row, allow_nan=False) + "\n").encode())
            file.flush()
            os.fsync(file.fileno())
            self._end = file.tell()
        print(self._line(row), file=sys.stderr, flush=True)
        self.rows.append(row)
        self._began, self._word = time.monotonic(), ""

    def _line(self, row: dict[str, Any]) -> str:
        others = [f"{name} {_shown(numbers)}" for name, numbers in (row["constraints"] | row["measures"]).items()]
        seconds = f"{time.monotonic() - self._began:.3g} s{self._word}"
        return f"iteration {len(self)}: {', '.join([_shown(row['value']), *others])} ({seconds})"


def _shown(value: Any) -> str:
    numbers = [float("nan") if number is None else number for number in (value if isinstance(value, list) else [value])]
    ends = dict.fromkeys(f"{end(numbers):.6g}" for end in (min, max)) if numbers else ["none"]
    return " to ".join(ends)


def _numbers(name: str, value: Any) -> Any:
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        raise ValueError(f"`{name}` is {str(value)[:40]!r}; a number, or a list of numbers, expected.") from None
    if array.ndim > 1:
        raise ValueError(f"`{name}` has shape {array.shape}; a number, or a list of numbers, expected.")
    plain = [number if math.isfinite(number) else None for number in array.ravel().tolist()]
    return plain if array.ndim else plain[0]
