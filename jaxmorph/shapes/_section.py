"""Place of an airfoil: its chord, and the nodes on its upper side."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from jaxmorph import Mesh
from jaxmorph.extend import Module, checked, finite_array

from ._arguments import Column, Numbers, Positions, Scalar, Vector, known_positions
from ._tolerances import LEVEL, SAME_LENGTH
from ._walls import wall_normals


class Chord(Module):
    """The chord of an airfoil, from point `nose` (d,) to `tail`, and the direction `up` across it.

    By default `up` (d,) is the chord turned to the left; 3-D needs it.

    **Raises:** `ValueError` for a chord without length, and for no `up` in 3-D.
    """

    nose: Vector
    tail: Vector
    up: Vector

    @checked
    def __init__(
        self, nose: Numbers = (0.0, 0.0), tail: Numbers = (1.0, 0.0), up: Numbers | None = None
    ):
        nose = finite_array("nose", nose, (2,), (3,))
        tail = finite_array("tail", tail, nose.shape)
        along = tail - nose
        if not along.any():
            raise ValueError(f"a chord from {nose} to {tail}: expected two different points.")
        if up is None:
            if len(nose) == 3:
                raise ValueError("`up` is missing: a chord in 3-D needs the direction across it.")
            up = np.array([-along[1], along[0]])
        across = finite_array("up", up, nose.shape)
        if not across.any():
            raise ValueError(f"`up` is {across}; expected a direction ({len(nose)},).")
        self.nose = jnp.asarray(nose, float)
        self.tail = jnp.asarray(tail, float)
        self.up = jnp.asarray(across / np.linalg.norm(across), float)

    @property
    def length(self) -> Scalar:
        return jnp.linalg.norm(self.tail - self.nose)

    def coordinates(self, x: Positions) -> tuple[Column, Column]:
        """Computes the place along the chord (0 to 1) and the height across it (in units of x)."""
        chord = (self.tail - self.nose).astype(x.dtype)
        if chord.shape != x.shape[1:]:
            raise ValueError(f"positions in {x.shape[1]}-D and a chord in {len(chord)}-D.")
        arm = x - self.nose.astype(x.dtype)[None, :]
        return arm @ chord / (chord @ chord), arm @ self.up.astype(x.dtype)

    @staticmethod
    @checked
    def along(points: Numbers) -> "Chord":
        """Finds the chord of an airfoil in 2-D from its nodes (m, 2).

        The tail has the largest x, the nose is farthest from the tail. Of several such nodes, as of
        a blunt tail, the mean counts.
        """
        known = known_positions(points, "points")
        last = known[:, 0].max()
        slack = SAME_LENGTH * max(np.ptp(known[:, 0]), 1e-300)
        tail = known[known[:, 0] > last - slack].mean(axis=0)
        distance = np.linalg.norm(known - tail, axis=1)
        return Chord(known[distance > (1 - SAME_LENGTH) * distance.max()].mean(axis=0), tail)


@checked
def upper_side(mesh: Mesh, *patches: str, chord: Chord | None = None) -> Bool[ndarray, " m"]:
    """Marks the nodes of an airfoil or wing whose normals look to the upper side, as SU2 does.

    Where a normal is along the chord, as at a symmetric nose or on a blunt tail, nodes on the chord
    and above it count as upper ones.

    **Arguments:**

    - `mesh`, `patches`: the wall, as `wall_normals` takes it.
    - `chord`: the airfoil's. Default: in 2-D `Chord.along` of its nodes.

    **Returns:** mask (m,), in the order of `mesh.patch(*patches)`. **Raises:** `ValueError` without
    `chord` in 3-D, and as `wall_normals` does.
    """
    x = np.asarray(mesh.points, float)[mesh.patch(*patches)]
    if chord is None:
        if x.shape[1] == 3:
            raise ValueError("`chord` is missing: a wing in 3-D needs one, with its `up`.")
        chord = Chord.along(x)
    normals = wall_normals(mesh, *patches)
    upward = normals @ np.asarray(chord.up)
    height = np.asarray(chord.coordinates(jnp.asarray(x))[1])
    is_level = np.abs(upward) <= LEVEL * np.linalg.norm(normals, axis=1)
    return np.where(is_level, height >= -LEVEL * float(chord.length), upward > 0)
