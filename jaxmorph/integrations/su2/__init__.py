"""SU2's config files as shapes; modules load at first use, for checks of a file without JAX."""

import importlib
import typing

if typing.TYPE_CHECKING:
    from ._config import Config as Config
    from ._config import read_config as read_config
    from ._motion import DesignVariables as DesignVariables
    from ._options import checked_options as checked_options
    from ._sensitivity import Sensitivity as Sensitivity
    from ._sensitivity import read_sensitivity as read_sensitivity
    from ._sensitivity import write_gradient as write_gradient

_MODULES = {
    "Config": "_config",
    "DesignVariables": "_motion",
    "Sensitivity": "_sensitivity",
    "checked_options": "_options",
    "read_config": "_config",
    "read_sensitivity": "_sensitivity",
    "write_gradient": "_sensitivity",
}
__all__ = sorted(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> typing.Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
