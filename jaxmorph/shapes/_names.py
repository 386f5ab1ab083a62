"""Names of design variables: one for each number of a shape's parameters."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from .._host.package.arguments import checked
from .._host.package.text import similar
from ._arguments import check_parameters

LISTED = 12
"""Names in a message, at most."""


@checked
def names(parameters: PyTree) -> list[str]:
    """Names each number of parameters, in the order of `jax.flatten_util.ravel_pytree`.

    Keys are joined by dots, places in an array follow in brackets: `wing.twist`, `wing.box[2,1,0]`.

    **Arguments:**

    - `parameters`: what a shape takes.

    **Returns:** a name for each number.
    """
    check_parameters(parameters)
    return [name for stem, leaf in _leaves(parameters) for name in _of_numbers(stem, np.shape(leaf))]


@checked
def varied(parameters: PyTree, changes: Mapping[str, Any]) -> PyTree:
    """Sets some parameters by name, on the host.

    **Arguments:**

    - `parameters`: what a shape takes.
    - `changes`: values by the names that `names` gives, or by names of whole arrays (`wing.box`).
      The end of a name is enough where no other name ends like it (`twist`).

    **Returns:** parameters in their structure, as NumPy's floats.

    **Raises:** `ValueError` for names that are unknown or that several parameters share, counts
    that differ, and values that are not finite.
    """
    check_parameters(parameters)
    stems, leaves = zip(*_leaves(parameters), strict=True) if jax.tree.leaves(parameters) else ((), ())
    values = [np.array(leaf, float) for leaf in leaves]
    places: dict[str, tuple[int, Any]] = {}
    for k, (stem, value) in enumerate(zip(stems, values, strict=True)):
        places[stem] = k, ...
        places |= {
            name: (k, at) for name, at in zip(_of_numbers(stem, value.shape), np.ndindex(value.shape), strict=True)
        }
    for name, change in changes.items():
        matches = _called(name, places)
        if len(matches) != 1:
            listed = ", ".join((matches or list(stems))[:LISTED]) or "none"
            if matches:
                raise ValueError(f"{len(matches)} design variables are called {name}; take one of: {listed}.")
            array = _called(name.partition("[")[0], stems)
            if "[" in name and len(array) == 1:
                raise ValueError(
                    f"there is no design variable {name}: {array[0]} has shape {values[stems.index(array[0])].shape}."
                )
            raise ValueError(f"there is no design variable {name}{_hint(name, stems)}; there are: {listed}.")
        k, at = places[matches[0]]
        value, target = np.asarray(change, float), values[k][at]
        if value.size != target.size or not np.isfinite(value).all():
            count = "one finite number" if target.size == 1 else f"{target.size} finite numbers"
            raise ValueError(f"{name} takes {count}, found {value.ravel().tolist()}.")
        values[k][at] = value.reshape(target.shape)
    return jax.tree.unflatten(jax.tree.structure(parameters), values)


def _called(name: str, known: Iterable[str]) -> list[str]:
    """Lists the name itself, or all names that end with it."""
    known = list(known)
    return [name] if name in known else [other for other in known if other.endswith(f".{name}")]


def _hint(name: str, known: Sequence[str]) -> str:
    """Suggests a known name, or the end of a known name, that is similar."""
    near = similar(name, [*known, *(stem.rpartition(".")[2] for stem in known)])
    return f" (did you mean {near!r}?)" if near else ""


def _leaves(parameters: PyTree) -> Iterator[tuple[str, Any]]:
    for path, leaf in jax.tree_util.tree_flatten_with_path(parameters)[0]:
        yield jax.tree_util.keystr(path, simple=True, separator=".") or "parameters", leaf


def _of_numbers(stem: str, shape: tuple[int, ...]) -> list[str]:
    return [f"{stem}[{','.join(map(str, at))}]" for at in np.ndindex(shape)] if shape else [stem]
