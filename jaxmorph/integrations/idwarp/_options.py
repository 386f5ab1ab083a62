"""Options of IDWarp: options that choose a method, and options without a counterpart."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

import jaxmorph as jm

OPTIONS: dict[str, tuple[tuple[type, ...], Any]] = {
    "gridFile": ((str,), None),
    "fileType": ((str,), "CGNS"),
    "specifiedSurfaces": ((list, tuple), None),
    "symmetrySurfaces": ((list, tuple), None),
    "symmetryPlanes": ((list, tuple, np.ndarray), None),
    "symmTol": ((int, float), 1e-6),
    "useRotations": ((bool,), None),
    "aExp": ((int, float), 3.0),
    "bExp": ((int, float), 5.0),
    "alpha": ((int, float), 0.25),
    "LdefFact": ((int, float), 1.0),
    "errTol": ((int, float), 5e-4),
    "evalMode": ((str,), "fast"),
    "zeroCornerRotations": ((bool,), True),
    "cornerAngle": ((int, float), 30.0),
    "restartFile": ((str,), None),
    "bucketSize": ((int,), 8),
}
"""IDWarp's options: the types that each takes beside None, and its default."""
WEIGHTS = ("aExp", "bExp", "alpha")
"""Options of IDWarp's own method alone."""
WITHOUT = ("LdefFact", "errTol", "evalMode", "zeroCornerRotations", "cornerAngle", "restartFile", "bucketSize")
"""Options that nothing here corresponds to."""
FILE = ("gridFile", "fileType")
"""Options that say what is read."""
KINDS = {kind.lower(): kind for kind in ("CGNS", "OpenFOAM", "PLOT3D")}


def checked(options: Any) -> dict[str, Any]:
    """Completes options by IDWarp's defaults; names may be in any case.

    Raises `ValueError` for one that IDWarp does not have, or of another type.
    """
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise ValueError(f"`options` must be a dictionary of options by name, such as gridFile, not {options!r}.")
    values = {name_of(name): value for name, value in options.items()}
    for name, value in values.items():
        types = OPTIONS[name][0]
        if value is not None and (not isinstance(value, types) or (isinstance(value, bool) and bool not in types)):
            raise ValueError(f"`{name}` is {value!r}; expected {' or '.join(kind.__name__ for kind in types)}.")
    _check_lists(values)
    values["fileType"] = KINDS.get((values.get("fileType") or "CGNS").lower())
    if values.get("gridFile") is None or values["fileType"] is None:
        raise ValueError(f"`gridFile` must be the name of a grid, and `fileType` one of {', '.join(KINDS.values())}.")
    return {name: values.get(name, default) for name, (_, default) in OPTIONS.items()} | {"told": tuple(values)}


def changed(options: Mapping[str, Any], name: str, value: Any) -> dict[str, Any]:
    """Returns options with another value of one of them. Raises `ValueError` as `checked` does."""
    return checked({key: options[key] for key in options["told"]} | {name: value})


def name_of(name: str) -> str:
    """Finds an option by its name in any case. Raises `ValueError` for an unknown name."""
    known = {option.lower(): option for option in OPTIONS}
    if not isinstance(name, str) or name.lower() not in known:
        raise ValueError(f"`options`: IDWarp has no option {name}; it has {', '.join(OPTIONS)}.")
    return known[name.lower()]


def _check_lists(values: Mapping[str, Any]) -> None:
    for name in ("specifiedSurfaces", "symmetrySurfaces"):
        if not all(isinstance(entry, str) for entry in values.get(name) or ()):
            raise ValueError(f"`{name}` is {values[name]!r}; expected names of patches.")
    planes = values.get("symmetryPlanes")
    if planes is not None and len(planes):
        try:
            shape = np.asarray(planes, dtype=float).shape
        except (TypeError, ValueError):
            shape = None
        if shape is None or shape[1:] != (2, 3):
            raise ValueError(
                f"`symmetryPlanes` is {planes!r}; expected a point and a normal for each: [[[0, 0, 0], [0, 1, 0]]]."
            )


def warn_of(options: Mapping[str, Any]) -> None:
    """Names the options that were told and that nothing corresponds to."""
    without = WITHOUT if options["useRotations"] is not None else (*WEIGHTS, *WITHOUT)
    told = [name for name in without if name in options["told"] and options[name] is not None]
    if told:
        by = "IDWarp's, not approximated" if without is WITHOUT else "the default of jaxmorph.prepare"
        warnings.warn(
            f"options of IDWarp that nothing corresponds to here: {', '.join(told)}. The method is {by}.", stacklevel=3
        )


def method(options: Mapping[str, Any], is_loose: bool) -> jm.AbstractMethod | None:
    """Makes the method; None is `prepare`'s default.

    The default is not for a mesh that `is_loose`: free, and fixed nowhere.
    """
    turns = options["useRotations"]
    if turns is None and not is_loose:
        return None
    far, near, alpha = (options[name] for name in WEIGHTS)
    return jm.InverseDistance(far=far, near=near, alpha=alpha, rotations=turns is not False)
