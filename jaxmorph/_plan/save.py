"""Plans in files: arrays, and a description of the tree that holds the arrays.

A file is a NumPy archive (.npz) of plain arrays and of one array of bytes, the description in JSON
with names of classes. `load` looks these up among the package's classes and the caller's, fills in
the fields, and runs no code.
"""

import dataclasses
import enum
import functools
import hashlib
import importlib
import json
import math
import pkgutil
import sys
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._host.package.arguments import checked
from .._host.package.files import PathLike, complete, input_path, output_path, read_arrays
from .._host.sources.reduction import AbstractReduction, AbstractSearchPoints
from .halves import SurfaceHalf
from .plan import Plan

ROOTS = (eqx.Module, AbstractReduction, AbstractSearchPoints)


def known_classes(added: Sequence[type] = ()) -> dict[str, type]:
    """The classes that a file may name: subclasses of `ROOTS` of the package, and `added`."""
    _import_methods()
    package = __name__.partition(".")[0]
    classes: dict[str, type] = {}
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        classes |= {
            kind.__name__: kind for kind in vars(sys.modules[name]).values() if _is_of(kind, name)
        }
    for kind in added:
        if not _is_data(kind):
            raise ValueError(
                f"`classes` are dataclasses (equinox modules among them) and enums; {kind!r} is "
                "neither."
            )
        if classes.get(kind.__name__, kind) is not kind:
            raise ValueError(
                f"two classes are called {kind.__name__}: {classes[kind.__name__]!r} and {kind!r}."
            )
        classes[kind.__name__] = kind
    return classes


@functools.cache
def _import_methods() -> None:
    """Imports all methods and reductions: a name of the package is imported at its first use."""
    package = __name__.partition(".")[0]
    for folder in (f"{package}._methods", f"{package}._host.sources"):
        paths = importlib.import_module(folder).__path__
        for module in pkgutil.walk_packages(paths, f"{folder}."):
            importlib.import_module(module.name)


def _is_data(kind: Any) -> bool:
    return isinstance(kind, type) and (
        dataclasses.is_dataclass(kind) or issubclass(kind, enum.Enum)
    )


def _is_of(kind: Any, module: str) -> bool:
    return isinstance(kind, type) and issubclass(kind, ROOTS) and kind.__module__ == module


FORMAT = "jaxmorph plan"
VERSION = 4
_HEADER = "description"
_UNREADABLE = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    RecursionError,
    OverflowError,
)


@checked
def save(path: PathLike, plan: Plan | SurfaceHalf | Sequence[Any]) -> None:
    """Writes a plan, the plans of a `march`, or a `SurfaceHalf`, to a file that `load` reads.

    All arrays keep their bits. Besides arrays, fields may hold None, booleans, numbers, strings,
    members of an `enum`, tuples, lists, dictionaries by string, and objects of dataclasses (also of
    `equinox.Module`). The file has a temporary name until it is complete.

    **Raises:** `ValueError`, with the place in the plan, for other fields (functions, say), and
    your own class with the name of a jaxmorph class. Also for a plan laid over devices (save the
    plan that `prepare` returned), and a `path` that is a folder, or whose folder is missing.
    """
    path = output_path(path)
    if not _is_plans(plan):
        raise ValueError(
            f"{type(plan).__name__} is no plan, and no list of the plans of several steps."
        )
    writer = _Writer()
    header = {"format": FORMAT, "version": VERSION, "tree": writer.node(plan, "plan")}
    members: dict[str, Any] = {
        _HEADER: np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    }
    members |= {str(i): array for i, array in enumerate(writer.arrays)}
    with complete(path) as partial, partial.open("wb") as file:
        np.savez(file, **members)


@checked
def load(path: PathLike, classes: Sequence[type] = ()) -> Any:
    """Reads what `save` wrote. Arrays go to JAX's default device.

    `classes` are your own classes that the plan may hold: a basis, a method and its factors, a
    reduction. A file can name only these and jaxmorph's classes, so that a file from elsewhere does
    no harm.

    **Raises:** `ValueError` for a file that is no plan, is damaged or cut short, or is of another
    version. Also for a class that is unknown or has other fields, and for float64 while JAX's x64
    mode is off. `OSError` for a file that cannot be opened.
    """
    path = input_path(path)
    members = read_arrays(path, "a saved plan")
    try:
        header = json.loads(members[_HEADER].tobytes())
        arrays = [members[str(i)] for i in range(len(members) - 1)]
        kind = header["format"]
        version = int(header["version"])
    except _UNREADABLE as error:
        detail = " ".join(str(error).split())[:120]
        raise ValueError(
            f"{path}: not a saved plan, or a damaged one ({type(error).__name__}: {detail})."
        ) from error
    if kind != FORMAT:
        raise ValueError(f"{path}: not a saved plan; its format is {kind!r}.")
    if version != VERSION:
        raise ValueError(
            f"{path}: of version {version}, but this jaxmorph reads {VERSION}: prepare the plan "
            "anew and save it."
        )
    try:
        plan = _Reader(arrays, known_classes((SurfaceHalf, *classes))).node(header["tree"])
    except _Refused as error:
        raise ValueError(f"{path}: {error}") from error
    except _UNREADABLE as error:
        raise ValueError(f"{path}: a damaged plan ({type(error).__name__}: {error}).") from error
    if not _is_plans(plan):
        raise ValueError(f"{path}: holds a {type(plan).__name__}, not a plan.")
    return plan


def _is_plans(plan: Any) -> bool:
    if isinstance(plan, tuple | list):
        return len(plan) > 0 and all(map(_is_plans, plan))
    return isinstance(plan, Plan | SurfaceHalf)


class _Refused(ValueError):
    """A message for the user, without the name of the file."""


@dataclasses.dataclass
class _Writer:
    """Describes a tree and collects its `arrays`, equal ones once: steps of a march share most."""

    arrays: list[np.ndarray] = dataclasses.field(default_factory=list)
    places: dict[Any, int] = dataclasses.field(default_factory=dict)

    def node(self, value: Any, where: str) -> Any:
        if type(value) in (type(None), bool, int, str):
            return value
        if type(value) is float:
            return value if math.isfinite(value) else {"float": repr(value)}
        if type(value) in (tuple, list):
            return {
                type(value).__name__: [
                    self.node(item, f"{where}[{i}]") for i, item in enumerate(value)
                ]
            }
        if type(value) is dict and set(map(type, value)) <= {str}:
            return {
                "dict": {key: self.node(item, f"{where}[{key!r}]") for key, item in value.items()}
            }
        is_array = isinstance(value, jax.Array | np.ndarray | np.generic)
        return self._array(value, where) if is_array else self._object(value, where)

    def _object(self, value: Any, where: str) -> dict[str, Any]:
        if isinstance(value, enum.Enum):
            return {"enum": self._name(type(value), where), "member": value.name}
        if not dataclasses.is_dataclass(value) or isinstance(value, type):
            kind = type(value).__name__
            raise ValueError(
                f"{where} is a {kind}, which a plan file cannot hold. `pickle` may serve, among "
                "people you trust."
            )
        if isinstance(value, Plan) and value.layout is not None:
            raise ValueError(
                f"{where} is laid over devices: save the plan that `prepare` returned, and "
                "`shard` the loaded plan."
            )
        names = [field.name for field in dataclasses.fields(value)]
        fields = {name: self.node(getattr(value, name), f"{where}.{name}") for name in names}
        return {"class": self._name(type(value), where), "fields": fields}

    def _array(self, value: Any, where: str) -> dict[str, Any]:
        array = np.ascontiguousarray(np.asarray(value)).reshape(np.shape(value))
        if array.dtype.kind not in "biufc" or array.dtype.type.__module__ != "numpy":
            raise ValueError(
                f"{where} holds {array.dtype}; a plan file holds booleans and ordinary numbers."
            )
        key = (array.dtype.str, array.shape, hashlib.blake2b(array.tobytes()).digest())
        place = self.places.setdefault(key, len(self.arrays))
        if place == len(self.arrays):
            self.arrays.append(array)
        kind = (
            "jax"
            if isinstance(value, jax.Array)
            else "numpy"
            if isinstance(value, np.ndarray)
            else "scalar"
        )
        weak = {"weak": True} if getattr(value, "weak_type", False) else {}
        return {kind: place} | weak

    def _name(self, kind: type, where: str) -> str:
        if known_classes().get(kind.__name__, kind) is not kind:
            raise ValueError(
                f"{where} is of a class {kind.__name__} that is not jaxmorph's: give it another "
                "name."
            )
        return kind.__name__


@dataclasses.dataclass
class _Reader:
    arrays: list[np.ndarray]
    classes: dict[str, type]
    built: dict[tuple[int, str], Any] = dataclasses.field(default_factory=dict)

    def node(self, node: Any) -> Any:
        if not isinstance(node, dict):
            return node
        kind = next(iter(node), None)
        content = node[kind]
        if kind == "float":
            return float(content)
        if kind in ("jax", "numpy", "scalar"):
            key = (content, kind)
            if key not in self.built:
                self.built[key] = self._array(self.arrays[content], kind, "weak" in node)
            return self.built[key]
        if kind in ("tuple", "list"):
            return (tuple if kind == "tuple" else list)(map(self.node, content))
        if kind == "dict":
            return {name: self.node(item) for name, item in content.items()}
        if kind == "enum":
            return self._class(content, enum.Enum)[node["member"]]
        return self._object(node["class"], node["fields"])

    def _array(self, array: np.ndarray, kind: str, weak: bool) -> Any:
        if kind != "jax":
            return array if kind == "numpy" else array[()]
        if jax.dtypes.canonicalize_dtype(array.dtype) != array.dtype:
            raise _Refused(
                f"the plan is in {array.dtype}, but JAX's x64 mode is off. Call "
                'jax.config.update("jax_enable_x64", True) first.'
            )
        exact = jnp.asarray(array)
        made = jnp.asarray(array.item()) if weak and array.ndim == 0 else exact
        return made if made.dtype == exact.dtype else exact

    def _object(self, name: str, fields: dict[str, Any]) -> Any:
        kind = self._class(name, object)
        expected = {field.name for field in dataclasses.fields(kind)}
        if expected != fields.keys():
            raise _Refused(
                f"{name} has the fields {', '.join(fields)} in the file, but "
                f"{', '.join(sorted(expected))} here: the file was "
                "written with another version of the class."
            )
        made = object.__new__(kind)
        for field, value in fields.items():
            object.__setattr__(made, field, self.node(value))
        return made

    def _class(self, name: str, base: type) -> Any:
        kind = self.classes.get(name)
        if kind is None or not issubclass(kind, base):
            raise _Refused(
                f"the class {name!r} is unknown; pass your own class as load(path, "
                f"classes=({name},))."
            )
        return kind
