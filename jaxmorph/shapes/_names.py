"""Names of design variables: one for each number of a shape's parameters."""

from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

LISTED = 12
"""Names in a message, at most."""


def names(parameters: PyTree) -> list[str]:
    """Names each number of parameters, in the order of `jax.flatten_util.ravel_pytree`.

    Keys are joined by dots, places in an array follow in brackets: `wing.twist`, `wing.box[2,1,0]`.

    **Arguments:**

    - `parameters`: what a shape takes.

    **Returns:** a name for each number.
    """
    return [name for stem, leaf in _leaves(parameters) for name in _of_numbers(stem, np.shape(leaf))]


def varied(parameters: PyTree, changes: Mapping[str, Any]) -> PyTree:
    """Sets some parameters by name, on the host.

    **Arguments:**

    - `parameters`: what a shape takes.
    - `changes`: values by the names that `names` gives, or by those of whole arrays (`wing.box`). The end of a name is enough
      where one name alone ends so (`twist`).

    **Returns:** parameters of the same structure, as NumPy's floats.

    **Raises:** `ValueError` for names that are unknown or that several parameters share, counts that differ, and values
    that are not finite.
    """
    stems, leaves = zip(*_leaves(parameters), strict=True) if jax.tree.leaves(parameters) else ((), ())
    values = [np.array(leaf, float) for leaf in leaves]
    places: dict[str, tuple[int, Any]] = {}
    for k, (stem, value) in enumerate(zip(stems, values, strict=True)):
        places[stem] = k, ...
        places |= {
            name: (k, at) for name, at in zip(_of_numbers(stem, value.shape), np.ndindex(value.shape), strict=True)
        }
    for name, change in changes.items():
        matches = [name] if name in places else [each for each in places if each.endswith(f".{name}")]
        if len(matches) != 1:
            listed = ", ".join((matches or list(stems))[:LISTED]) or "none"
            what = f"{len(matches)} design variables are called" if matches else "there is no design variable"
            raise ValueError(f"{what} {name}; {'take one of' if matches else 'there are'}: {listed}.")
        k, at = places[matches[0]]
        given, target = np.asarray(change, float), values[k][at]
        if given.size != target.size or not np.isfinite(given).all():
            raise ValueError(f"{name} takes {np.size(target)} finite numbers, found {given.ravel().tolist()}.")
        values[k][at] = given.reshape(target.shape)
    return jax.tree.unflatten(jax.tree.structure(parameters), values)


def _leaves(parameters: PyTree) -> Iterator[tuple[str, Any]]:
    for path, leaf in jax.tree_util.tree_flatten_with_path(parameters)[0]:
        yield jax.tree_util.keystr(path, simple=True, separator=".") or "parameters", leaf


def _of_numbers(stem: str, shape: tuple[int, ...]) -> list[str]:
    return [f"{stem}[{','.join(map(str, at))}]" for at in np.ndindex(shape)] if shape else [stem]
