"""Programs of direct calls, kept in a folder: a later process neither traces nor lowers them.

A command keeps all programs. In a user's process `prepare` and `deform` keep their own, in JAX's
folder of compiled code.

JAX's own cache finds machine code by the program, so that every process first makes the program.
Here the name of a function, the shapes of its arguments and the package's files find the code.
"""

import contextlib
import contextvars
import dataclasses
import functools
import hashlib
import io
import os
import pathlib
import pickle
import platform
import secrets
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jaxlib import version

from .contexts import holding
from .values import array

BASES = ("jax", "jaxlib", "equinox", "numpy")
"""Packages that programs are made with."""

KNOWN = ("jaxmorph", *BASES, "jaxtyping", "builtins", "collections", "functools")
"""Packages whose classes and functions arguments may hold. A user's own may change any time."""

SETTINGS = ("JAX", "XLA")
"""Beginnings of environment variables that change programs."""

HOST = "callback"
"""A word of programs that call Python, at an address of this process."""

LATEST = 64
"""Programs that a process holds at most."""

DIGEST = hashlib.sha256().digest_size
"""Bytes before a program in its file."""

SWITCH = "JAXMORPH_CACHE"
"""The environment variable by which nothing is kept."""

T = TypeVar("T")

_folder: Any = None
_in_jaxs_folder = contextvars.ContextVar("_in_jaxs_folder", default=False)
_programs: "dict[str, Program]" = {}
_names: dict[Any, str | None] = {}
"""Names of programs by the form of a call, which is quickly made; None: nothing is kept."""


@dataclasses.dataclass(frozen=True)
class _Shape:
    """Stands for an array among arguments: shape and type, and whether the type is weak."""

    text: str
    is_weak: bool

    @classmethod
    def of(cls, leaf: Any) -> "_Shape":
        kind = jax.typeof(leaf)
        return cls(str(kind), bool(getattr(kind, "weak_type", False)))


@dataclasses.dataclass(frozen=True)
class _Place:
    """Stands for an array among results: a row of the program's results, or of its arguments."""

    row: int
    is_argument: bool


@dataclasses.dataclass(frozen=True)
class Program:
    """A compiled function of arrays, and the form of its results with a `_Place` for each array."""

    call: Callable[..., Any]
    form: Any

    def __call__(self, leaves: list[Any]) -> Any:
        results = self.call(*leaves)

        def filled(leaf: Any) -> Any:
            if not isinstance(leaf, _Place):
                return leaf
            return array(leaves[leaf.row]) if leaf.is_argument else results[leaf.row]

        return jax.tree.map(filled, self.form)


class _UnkeptError(Exception):
    """Ends the search for the name of a program that cannot be kept."""


class _Pickler(pickle.Pickler):
    """Writes objects, if all classes and functions in them are of known packages."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type) or (callable(obj) and hasattr(obj, "__qualname__")):
            _name(obj)
        return NotImplemented


def is_off() -> bool:
    """Checks whether `JAXMORPH_CACHE` says that nothing is kept."""
    return os.environ.get(SWITCH, "").lower() in ("off", "0", "no", "false")


def machine() -> str:
    """Names the kind of processor, on which another kind's code may not run."""
    facts = [platform.machine(), platform.processor()]
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        facts += sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))})
    except OSError:
        pass
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]


def keep(folder: str, limit: int) -> None:
    """Keeps the programs of all calls in JAX's folder of compiled code, at most `limit` bytes.

    It is for a process that runs one command. The first call of a program takes longer to name it.
    """
    global _folder
    _folder = _opened(folder, limit)


def kept_in_jaxs_folder() -> contextlib.AbstractContextManager[None]:
    """Keeps the programs of calls within in JAX's folder of compiled code, if JAX has one."""
    return holding(_in_jaxs_folder, True)


def _jaxs_folder() -> Any:
    config: Any = jax.config
    path, limit = config.jax_compilation_cache_dir, config.jax_compilation_cache_max_size
    return _opened(path, limit) if path and config.jax_enable_compilation_cache and not is_off() else None


@functools.cache
def _opened(folder: str, limit: int) -> Any:
    """Opens a folder of programs; None where this JAX has no such folders or lacks a package."""
    try:  # private names of JAX: without them nothing is kept
        from jax._src.config import trace_context  # noqa: F401
        from jax._src.lru_cache import LRUCache
        from jaxlib import lapack

        lapack.prepare_lapack_call("getrf_ffi", np.dtype(float))  # finds LAPACK, as lowering would
        return LRUCache(folder, max_size=limit)
    except Exception:
        return None


def kept(
    function: Callable, leaves: list[Any], tree: Any, state: tuple[bool, ...], options: Callable[[], dict[str, Any]]
) -> Callable[[], Any] | None:
    """Finds or makes the program of a call; None where no program can be kept.

    `leaves` and `tree` are those of the arguments, a tuple and a dictionary. `state` is what the
    program depends on besides. `options` gives the compiler's options for a program that is made.
    """
    folder = _jaxs_folder() if _folder is None and _in_jaxs_folder.get() else _folder
    config: Any = jax.config
    if folder is None or config.jax_disable_jit or config.jax_debug_nans or config.jax_debug_infs:
        return None
    if jax.device_count() > 1 or jax.default_backend() != "cpu":
        return None
    key = _held(_names, _form(function, leaves, tree, state), lambda: _key(function, leaves, tree, state))
    if key is None:
        return None
    program = _held(
        _programs, key, lambda: _loaded(folder, key) or _made(folder, key, function, leaves, tree, options())
    )
    return functools.partial(program, [leaf for leaf in leaves if _is_array(leaf)])


def _held(values: dict[Any, T], key: Any, make: Callable[[], T]) -> T:
    """Returns what a dictionary holds of a key, or makes it; what came first is forgotten."""
    try:
        found = values.get(key, values)
    except TypeError:  # something in the key has no hash
        return make()
    if found is values:
        found = values[key] = make()
        while len(values) > LATEST:
            values.pop(next(iter(values)), None)
    return found  # pyright: ignore[reportReturnType]


def _form(function: Callable, leaves: list[Any], tree: Any, state: tuple[bool, ...]) -> Any:
    """Describes a call as `jax.jit` does: calls of one form have one program in this process."""
    from jax._src.config import trace_context

    kinds = [
        (leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False))
        if _is_array(leaf)
        else (type(leaf), repr(leaf) if isinstance(leaf, float) else leaf)  # 0.0 and -0.0 are equal
        for leaf in leaves
    ]
    return function, tree, tuple(kinds), state, trace_context()


def _key(function: Callable, leaves: list[Any], tree: Any, state: tuple[bool, ...]) -> str | None:
    """Computes the name of a program; None for the user's own functions."""
    file = io.BytesIO()
    shapes = jax.tree.unflatten(tree, [_Shape.of(leaf) if _is_array(leaf) else leaf for leaf in leaves])
    try:
        _Pickler(file).dump((_name(function), state, shapes))
    except (pickle.PicklingError, TypeError, AttributeError, _UnkeptError):
        return None
    return f"jaxmorph-{hashlib.sha256(_world() + _settings() + file.getvalue()).hexdigest()}"


def _name(obj: Any) -> str:
    """Names a class or a function of known packages. Raises `_UnkeptError` for others."""
    module, name = str(getattr(obj, "__module__", "")), str(obj.__qualname__)
    if module.partition(".")[0] not in KNOWN or "<" in name:
        raise _UnkeptError
    return f"{module}.{name}"


@functools.cache
def _world() -> bytes:
    """Describes what all programs depend on: processor, files of packages, versions, settings."""
    facts = [machine(), sys.version, jax.__version__, version.__version__, jax.default_backend()]
    facts += [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith(SETTINGS)]
    own = pathlib.Path(__file__).parents[1]
    files = sorted(os.path.join(where, file) for where, _, names in os.walk(own) for file in names)
    files = [file for file in files if file.endswith(".py")]
    for file in [*files, *(str(sys.modules[name].__file__) for name in BASES)]:
        about = os.stat(file)
        facts.append(f"{file} {about.st_size} {about.st_mtime_ns}")
    return "\n".join(facts).encode()


def _settings() -> bytes:
    """Describes JAX's settings of this moment, in this thread."""
    values = jax.config.values
    return "\n".join(f"{name}={getattr(jax.config, name, values[name])}" for name in sorted(values)).encode()


def _loaded(folder: Any, key: str) -> Program | None:
    """Loads a program; None where it is missing or damaged."""
    try:
        found = folder.get(key) or b""
        digest, content = found[:DIGEST], found[DIGEST:]
        if digest != hashlib.sha256(content).digest():  # machine code of a damaged file may do anything
            return None
        from jax.experimental import serialize_executable

        counts, code, form = pickle.loads(content)
        trees = [jax.tree.structure(tree) for tree in (((0,) * counts[0], {}), (0,) * counts[1])]
        return Program(serialize_executable.deserialize_and_load(code, *trees), form)
    except Exception:  # pickle, the file system and XLA raise a dozen classes
        return None


def _made(folder: Any, key: str, function: Callable, leaves: list[Any], tree: Any, options: dict[str, Any]) -> Program:
    """Compiles a program, and keeps it."""
    arrays, form = [leaf for leaf in leaves if _is_array(leaf)], None

    def flat(*traced: Any) -> tuple[Any, ...]:
        nonlocal form
        arguments, rows, results = iter(traced), {id(leaf): row for row, leaf in enumerate(traced)}, []

        def placed(leaf: Any) -> Any:
            if not _is_array(leaf):
                return leaf
            if id(leaf) in rows:  # an argument that comes back is not copied
                return _Place(rows[id(leaf)], True)
            results.append(leaf)
            return _Place(len(results) - 1, False)

        words, keywords = jax.tree.unflatten(tree, [next(arguments) if _is_array(leaf) else leaf for leaf in leaves])
        form = jax.tree.map(placed, function(*words, **keywords))
        return tuple(results)

    # XLA writes code out incompletely if it has read the code. So JAX's own cache must not have the
    # program: a new name is in no cache.
    flat.__name__ = f"{function.__name__}_{secrets.token_hex(4)}"
    lowered = jax.jit(flat, compiler_options=options).lower(*arrays)
    with _unkept_by_jax():
        compiled = lowered.compile()
    if HOST not in lowered.as_text():
        _write(folder, key, (len(arrays), len(jax.tree.leaves(lowered.out_info))), compiled, form)
    return Program(compiled, form)


def _unkept_by_jax() -> contextlib.AbstractContextManager[Any]:
    """Returns a context in which JAX's own cache keeps nothing of this thread."""
    try:  # a private name of JAX: without it JAX keeps the code a second time
        from jax._src.config import persistent_cache_min_compile_time_secs as shortest

        return shortest(float("inf"))
    except Exception:
        return contextlib.nullcontext()


def _write(folder: Any, key: str, counts: tuple[int, int], compiled: Any, form: Any) -> None:
    """Writes a program, if it can be written."""
    with contextlib.suppress(Exception):  # pickle, the file system and XLA raise a dozen classes
        from jax.experimental import serialize_executable

        file = io.BytesIO()
        _Pickler(file).dump((counts, serialize_executable.serialize(compiled)[0], form))
        content = file.getvalue()
        folder.put(key, hashlib.sha256(content).digest() + content)


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray)
