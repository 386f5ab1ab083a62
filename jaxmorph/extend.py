"""What shapes, formats and couplings of your own share with the package.

`shapes`, `plot`, `cases`, `integrations` and the command line are built on these names and on the
public ones of `jaxmorph`, as an extension outside of the package would be. The first use of a name
imports its module: NumPy, SciPy and JAX come with those that need them.
"""

import importlib
import typing

if typing.TYPE_CHECKING:  # `_NAMES` repeats it
    # isort: off
    from ._host.cells.lagrange import Lagrange as Lagrange, lagrange_types as lagrange_types
    from ._host.package.arguments import (
        between as between,
        checked as checked,
        finite_array as finite_array,
        real_array as real_array,
        rows_of as rows_of,
        whole as whole,
    )
    from ._host.package.errors import warn as warn
    from ._host.package.files import (
        appearing_if as appearing_if,
        complete as complete,
        input_path as input_path,
        output_path as output_path,
    )
    from ._host.package.ranks import Agreement as Agreement, Alone as Alone, together as together
    from ._host.package.text import decoded as decoded, patch_names as patch_names
    from ._host.surface.gaps import closest as closest, fans as fans
    from ._kernels.callback import host_call as host_call
    from ._kernels.compile import float64_mode as float64_mode, quickly_compiled as quickly_compiled
    from ._kernels.module import Module as Module
    from ._kernels.values import is_known as is_known
    # isort: on

_NAMES = {
    "_host.cells.lagrange": "Lagrange lagrange_types",
    "_host.package.arguments": "between checked finite_array real_array rows_of whole",
    "_host.package.errors": "warn",
    "_host.package.files": "appearing_if complete input_path output_path",
    "_host.package.ranks": "Agreement Alone together",
    "_host.package.text": "decoded patch_names",
    "_host.surface.gaps": "closest fans",
    "_kernels.callback": "host_call",
    "_kernels.compile": "float64_mode quickly_compiled",
    "_kernels.module": "Module",
    "_kernels.values": "is_known",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> typing.Any:
    if name == "__all__":
        return list(_MODULES)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f".{_MODULES[name]}", __package__), name)
    return value


def __dir__() -> list[str]:
    return sorted(_MODULES)
