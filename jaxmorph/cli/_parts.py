"""Flags of several commands: boundary, method, quality limits, output."""

import dataclasses
from typing import Any, ClassVar

import jaxmorph as jm
from jaxmorph._advice.methods import METHODS

from ._parser import flag, flag_of, one_of, switch

SEVERAL: dict[str, Any] = {"metavar": "NAME", "nargs": "+", "default": ()}
"""Settings of flags of several patches."""

NAMES = [entry.name for entry in METHODS]


@dataclasses.dataclass(frozen=True)
class Boundary:
    """Patches by what they do: names, patterns or groups."""

    SECTION: ClassVar = "surface"

    fixed: tuple[str, ...] = flag("patches that stay", everyday=True, action="extend", **SEVERAL)
    symmetry: tuple[str, ...] = flag("plane patches in which nodes slide", everyday=True, action="extend", **SEVERAL)
    sliding: tuple[str, ...] = flag("patches whose nodes slide along their faces", action="extend", **SEVERAL)
    periodic: tuple[str, ...] = flag(
        "pairs of patches that repeat each other, one name after the other", action="extend", **SEVERAL
    )
    free: tuple[str, ...] = flag("patches whose nodes follow like inner nodes", action="extend", **SEVERAL)


@dataclasses.dataclass(frozen=True)
class Method:
    """The method by its name, its number of sources, and the precision.

    With None the method has its own number of sources on the moving patches.
    """

    SECTION: ClassVar = "method"

    method: str = flag(
        "one of the methods listed below",
        metavar="NAME",
        choices=NAMES,
        type=one_of("method", NAMES),
        default="default",
    )
    sources: int | None = flag(
        "about how many nodes of the moving patches are sources", metavar="N", type=int, everyday=True
    )
    dtype: str = flag(
        "precision of the calculation; float32 takes half the memory, and is too coarse for boundary layers",
        choices=("float64", "float32"),
        default="float64",
    )


def _limit(what: str) -> Any:
    return flag(what, metavar="X", type=float)


@dataclasses.dataclass(frozen=True)
class Gates:
    """Limits of quality, by the names of their flags."""

    SECTION: ClassVar = "quality gates"

    max_aspect_ratio: float | None = _limit("largest aspect ratio")
    max_non_orthogonality: float | None = _limit("largest non-orthogonality in degrees")
    max_skewness: float | None = _limit("largest skewness of a cell, 0 to 1")
    max_face_skewness: float | None = _limit("largest skewness of a face, as checkMesh measures it")
    max_face_aspect_ratio: float | None = _limit("largest aspect ratio from areas of faces, as checkMesh measures it")
    min_jacobian_ratio: float | None = _limit("smallest corner Jacobian over its initial value")
    proven: bool = switch(
        "every cell is proven to fold nowhere inside, by bounds on det J: during the whole motion, or in a mesh alone"
    )
    preset: str | None = flag(
        "limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, skewness 4",
        choices=("checkmesh",),
    )

    def __post_init__(self):
        wrong = [name for name, limit in vars(self).items() if limit != limit]
        if wrong:
            raise ValueError(f"{flag_of(wrong[0])} needs a number, found nan.")

    @property
    def limits(self) -> "jm.Limits":
        """The preset's limits, replaced by those of flags."""
        flags = {name: limit for name, limit in vars(self).items() if name != "preset" and limit not in (None, False)}
        return dataclasses.replace(jm.Limits.checkmesh() if self.preset else jm.Limits(), **flags)


@dataclasses.dataclass(frozen=True)
class Speech:
    """Flags of how a command speaks."""

    SECTION: ClassVar = "output"

    json: bool = switch("print one JSON object in place of text")
    verbose: bool = switch("print how long each stage took")
