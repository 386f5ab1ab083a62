"""Growth and erosion: a wall moves along its normals, as far as its sides leave room."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree
from scipy.spatial import KDTree

from jaxmorph import Facets, Plane
from jaxmorph.extend import between, checked, finite_array

from ._arguments import Numbers, positions
from ._features import SAME
from ._shape import AbstractShape
from ._smooth import Smoother

ROUNDS = 40
"""Most balls that are tried at a node; the last ones hardly differ."""


class Offset(AbstractShape):
    """Moves a wall along its normals: growth of ice, erosion, change of thickness.

    Sides that would meet stop before. A node goes no farther than a `share` of its distance from
    the medial axis: the radius of the largest ball that touches the wall there, and holds no node.
    Up to half of that it goes all the way, beyond smoothly less.

    **Arguments:**

    - `wall`: such as `Facets.of(mesh, "wing")`; its normals look into the mesh.
    - `field`: heights (m,) that a single parameter scales; negative ones erode. Default None: the
      parameters are the heights (m,) of all nodes.
    - `length`: heights are smoothed as by a `Smoother` of this length. Default 0: as they are.
    - `symmetry`: planes in which the border of the wall stays. Default: none.
    - `share`: from 0 to 1. Default 0.9.

    **Raises:** `ValueError` for a field of another shape, and as `Smoother` does.

    Source: Ma, Bae and Choi, 3D medial axis point approximation using nearest neighbors and the
    normal field, The Visual Computer 28, 2012.
    """

    wall: Facets
    field: Float[Array, " m"] | None
    smoother: Smoother | None
    borders: tuple[tuple[Float[np.ndarray | Array, " d"], Int[np.ndarray | Array, " b"]], ...]
    touching: Int[np.ndarray | Array, "2 m"]  # of growth, then of erosion; the node itself: none
    share: float

    @checked
    def __init__(
        self,
        wall: Facets,
        field: Numbers | None = None,
        *,
        length: float = 0.0,
        symmetry: Plane | Sequence[Plane] = (),
        share: float = 0.9,
    ):
        between("share", share, 0, 1, ends="(]")
        between("length", length, 0, ends="[)")
        x, rim = np.asarray(wall.points, float), np.unique(wall.rim)
        planes, slack = (symmetry,) if isinstance(symmetry, Plane) else tuple(symmetry), SAME * np.ptp(x, axis=0).max()
        self.wall, self.share = wall, share
        self.field = None if field is None else jnp.asarray(finite_array("field", field, (len(x),)), wall.points.dtype)
        self.smoother = Smoother(x, np.asarray(wall.faces), length) if length else None
        self.borders = tuple((plane.normal, rim[np.abs(plane.height(x[rim])) <= slack]) for plane in planes)
        normals = np.asarray(self._normals(jnp.asarray(x)), float)
        self.touching = np.stack([_touching(x, sign * normals) for sign in (1, -1)])

    def neutral(self) -> Float[Array, "..."]:
        return jnp.zeros(len(self.wall.points) if self.field is None else (), self.wall.points.dtype)

    def __call__(self, x: Numbers, parameters: PyTree) -> Float[Array, "m d"]:
        x = positions(x)
        heights = jnp.asarray(parameters, x.dtype)
        if x.shape != self.wall.points.shape or heights.shape != self.neutral().shape:
            needed = f"{self.wall.points.shape} and {self.neutral().shape}"
            raise ValueError(f"`x` has shape {x.shape}, `parameters` {heights.shape}; this wall has {needed}.")
        heights = heights if self.field is None else heights * self.field.astype(x.dtype)
        if self.smoother is not None:
            heights = self.smoother.apply(jnp.stack([heights, heights], axis=1))[:, 0]
        normals = self._normals(x)
        room = self.share * jnp.where(
            heights > 0, *(self._radius(x, sign * normals, k) for k, sign in enumerate((1, -1)))
        )
        ratio = jnp.abs(heights) / room
        # equal in value, slope and curvature at one half
        limited = jnp.where(ratio > 0.5, room * (0.5 + 0.5 * jnp.tanh(2 * ratio - 1)), jnp.abs(heights))
        return x + (jnp.where(heights < 0, -1, 1) * limited)[:, None] * normals

    def _normals(self, x: Float[Array, "m d"]) -> Float[Array, "m d"]:
        normals = self.wall.at(x).normals()
        for normal, rows in self.borders:
            own = normals[rows]
            own = own - jnp.matmul(own, normal, precision="highest")[:, None] * normal[None]
            normals = normals.at[rows].set(own / jnp.linalg.norm(own, axis=1)[:, None])
        return normals

    def _radius(self, x: Float[Array, "m d"], ahead: Float[Array, "m d"], side: int) -> Float[Array, " m"]:
        arm = x[self.touching[side]] - x
        above = jnp.sum(arm * ahead, axis=1)
        return jnp.where(above > 0, jnp.sum(arm**2, axis=1) / jnp.where(above > 0, 2 * above, 1), FAR)


FAR = 1e30


def _touching(x: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Finds the node that the largest ball at each node touches; the node itself without one."""
    # A ball shrinks onto the node that is nearest to its centre, until none is inside.
    tree, found = KDTree(x), np.arange(len(x), dtype=np.int64)
    radius, open_ = np.full(len(x), 10 * np.ptp(x, axis=0).max()), np.arange(len(x))
    for _ in range(ROUNDS):
        distance, other = map(np.asarray, tree.query(x[open_] + radius[open_, None] * ahead[open_]))
        arm = x[other] - x[open_]
        above = np.sum(arm * ahead[open_], axis=1)
        is_inside = (distance < radius[open_] * (1 - 1e-9)) & (above > 0)
        open_, other, arm, above = open_[is_inside], other[is_inside], arm[is_inside], above[is_inside]
        radius[open_], found[open_] = np.sum(arm**2, axis=1) / (2 * above), other
        if not len(open_):
            break
    return found
