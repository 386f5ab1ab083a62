"""SU2's config files as shapes; modules load at first use, for checks of a file without JAX."""

import importlib
import typing

if typing.TYPE_CHECKING:
    from ._config import Config as Config
    from ._config import Sensitivity as Sensitivity
    from ._config import read_config as read_config
    from ._config import read_sensitivity as read_sensitivity
    from ._config import write_gradient as write_gradient
    from ._motion import DesignVariables as DesignVariables
    from ._options import checked_options as checked_options

_MODULES = {
    "Config": "_config",
    "DesignVariables": "_motion",
    "Sensitivity": "_config",
    "checked_options": "_options",
    "read_config": "_config",
    "read_sensitivity": "_config",
    "write_gradient": "_config",
}
__all__ = sorted(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> typing.Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
