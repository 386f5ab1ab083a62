"""What shapes, formats and couplings of your own share with the package.

`shapes`, `plot`, `cases`, `integrations` and the command line are built on these names and on the
public ones of `jaxmorph`, as an extension outside of the package would be. The first use of a name
imports its module: NumPy, SciPy and JAX come with those that need them.
"""

import ast as _ast
import importlib as _importlib
import sys as _sys


def attached(module, file):
    """Makes `__getattr__`, `__dir__` and `__all__` of a module by the relative imports in its stub,
    the file for type checkers beside it, as `attach_stub` of lazy-loader does.
    """
    with open(f"{file.rpartition('.')[0]}.pyi", encoding="utf-8") as stub:
        body = _ast.parse(stub.read()).body
    imports = [node for node in body if isinstance(node, _ast.ImportFrom) and node.level]
    homes = {each.name: f".{node.module or ''}" for node in imports for each in node.names}
    is_package = file.rpartition(".")[0].endswith("__init__")  # also of bytecode alone
    package = module if is_package else module.rpartition(".")[0]

    def attribute(name):
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        if homes[name] == ".":
            return _importlib.import_module(f".{name}", module)
        value = getattr(_importlib.import_module(homes[name], package), name)
        setattr(_sys.modules[module], name, value)  # the next use is as fast as that of any name
        return value

    names = [*homes, "__version__"] if module == __package__ else list(homes)
    return attribute, lambda: sorted(names), list(homes)


def listing(names):
    """Makes `__dir__` of a module, of its `globals()`: completion offers public names alone."""
    return lambda: sorted(name for name in names if not name.startswith("_"))


__getattr__, __dir__, __all__ = attached(__name__, __file__)
