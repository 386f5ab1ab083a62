"""Public names of a package, whose modules are imported when a name is first used."""

import functools
import importlib
import pathlib
import re
import sys
from typing import Any


class Names:
    """The names that a package's `_public.py` imports, and submodules of the package."""

    def __init__(self, package: str, submodules: tuple[str, ...] = ()):
        self._package = package
        self._submodules = submodules

    @functools.cached_property
    def _modules(self) -> dict[str, str]:
        """The module of each public name, in the lines of `_public.py`."""
        folder = sys.modules[self._package].__path__[0]
        lines = pathlib.Path(folder, "_public.py").read_text()
        return {name: module for module, name in re.findall(r"(?m)^from (\S+) import \w+ as (\w+)$", lines)}

    def found(self, name: str) -> Any:
        """Imports what a name stands for, as the package's `__getattr__`."""
        if name in self._submodules:
            return importlib.import_module(f"{self._package}.{name}")
        if name == "__all__":
            return sorted({*self._modules, *self._submodules})
        if name.startswith("_") or name not in self._modules:
            raise AttributeError(f"module {self._package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(self._modules[name], self._package), name)
        setattr(sys.modules[self._package], name, value)
        return value

    def listed(self) -> list[str]:
        """Lists all names, as the package's `__dir__`."""
        own = {name for name in vars(sys.modules[self._package]) if name.startswith("__")}
        return sorted({*self.found("__all__"), *own})
