"""Periodic patches, as a user names them."""

import dataclasses

import numpy as np

from .._host.package.arguments import between, check_patch, finite_array, whole


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Periodic:
    """Two patches of which the second repeats the first.

    Examples are passages of a cascade, sectors of a wheel and ends of a duct. The transform repeats
    the surface before a method sees it, so that the field knows the neighbours. Then every pair of
    nodes takes its mean displacement. Both patches move: they may change shape, but stay copies of
    each other.

    Without `translation`, `rotation`, `about` and `axis`, the transform is the translation between
    the middles of the patches. If the patches do not match, it is a rotation about an axis of
    coordinates (in 2-D about the origin).

    **Arguments:**

    - `patch`, `partner`: names of patches, or ids of their nodes. The transform leads from `patch`
      to `partner`.
    - `translation`: vector (d,), in the mesh's units. Default: found.
    - `rotation`: angle in radians. Default: found from the middles of the patches.
    - `about`: a point (d,) on the axis of the rotation. Default: the origin.
    - `axis`: direction (3,) of the rotation's axis, only in 3-D.
    - `copies`: images of the surface on either side. Default 1. With 2, cells are a little better,
      and work takes longer.

    **Raises:** `ValueError` for a translation with a rotation, and for less than one copy.
    """

    patch: str | np.ndarray
    partner: str | np.ndarray
    translation: np.ndarray | None
    rotation: float | None
    about: np.ndarray | None
    axis: np.ndarray | None
    copies: int

    def __init__(self, patch, partner, *, translation=None, rotation=None, about=None, axis=None, copies: int = 1):
        if translation is not None and not (rotation is None and about is None and axis is None):
            raise ValueError("a periodic pair has a translation or a rotation, not both.")
        whole("copies", copies)
        check_patch("patch", patch)
        check_patch("partner", partner)
        if rotation is not None:
            between("rotation", rotation)
            rotation = float(rotation)
        vectors = {
            name: None if vector is None else finite_array(name, vector, (2,), (3,)).astype(float)
            for name, vector in (("translation", translation), ("about", about), ("axis", axis))
        }
        fields = {"patch": patch, "partner": partner, "rotation": rotation, "copies": int(copies)}
        for name, value in (fields | vectors).items():
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """The names of both patches, for a message."""
        names = [
            repr(side) if isinstance(side, str) else f"of {len(side)} nodes" for side in (self.patch, self.partner)
        ]
        return f"the periodic patches {names[0]} and {names[1]}"

    @property
    def is_rotation(self) -> bool:
        """True for a rotation, False for a translation."""
        return not (self.rotation is None and self.about is None and self.axis is None)
