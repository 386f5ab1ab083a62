"""The list of methods, and the small meshes, that every law in `test_contract.py` is tried on. A new method is one more line."""

import dataclasses
import functools
import pathlib
import sys
import types
from collections.abc import Callable

import jax
import jax.numpy as jnp
import nbformat
import numpy as np
from meshes import sphere
from scipy.spatial import Delaunay

import jaxmorph as jm


@dataclasses.dataclass(frozen=True)
class Case:
    """`make(length)` builds the method, with its lengths in units of `length`. The rest is what the method claims.

    `exact`: the surface's nodes go where they are told. `affine`: an affine motion of the whole boundary is reproduced;
    `translates`: a translation at least. `turns`: the answer does not depend on the axes (a box reduction's does).
    `faces`: it takes the mesh, for its boundary faces.
    """

    name: str
    make: Callable[[float], jm.AbstractMethod]
    exact: bool = True
    affine: bool = True
    translates: bool = True
    turns: bool = True
    dimensions: tuple[int, ...] = (2, 3)
    faces: bool = False

    def prepared(self, points, moving, fixed=(), length=1.0, order=None) -> jm.Plan:
        """Prepares a plan for points of `body`, nodes `order` of it, or the whole mesh for a method that needs cells."""
        method = self.make(length)
        if not (method.needs_cells or self.faces):
            return jm.prepare(points, moving, fixed, method=method)
        cells = body(points.shape[1]).cells if method.needs_cells else body(points.shape[1]).outside
        number = np.arange(len(points)) if order is None else np.argsort(order)
        mesh = jm.Mesh(points, {"triangle" if points.shape[1] == 2 else "tetra": number[cells]})
        return jm.prepare(mesh, moving, fixed, method=method, free=np.arange(len(points)))


def full(basis, degree):
    return jm.RBF.classic(basis, degree=degree)


def iterative(basis, **options):
    """The classic method by iterations, small enough that the sparse part of the preconditioner has work to do."""
    solver = jm.Iterative(1e-13, neighbours=12, dense=12)
    return jm.RBF(basis, jm.AllPoints(), jm.AllPoints(), solver=solver, **options)


def few(leaves=2):
    return jm.RBF(reduction=jm.KDTree(leaves), fixed_reduction=jm.KDTree(2))


def farthest(count=8):
    return jm.RBF(reduction=jm.FarthestPoints(count, extremes=True), fixed_reduction=jm.Graded())


@functools.cache
def extension():
    """What `notebooks/07_extend.ipynb` defines, as it stands there."""
    path = pathlib.Path(__file__).parents[1] / "notebooks" / "07_extend.ipynb"
    cells = nbformat.read(path, as_version=4).cells
    source = "\n".join(
        cell.source for cell in cells if "extension" in cell.metadata.get("tags", ())
    )
    module = types.ModuleType("extension")
    sys.modules[module.__name__] = module  # for pickle
    vars(module).update(jm=jm, jnp=jnp, jax=jax)
    exec(compile(source, str(path), "exec"), vars(module))
    return module


FIXED_AXES, ALONE = {"turns": False}, {"affine": False, "translates": False}


def reconstruction(coarse, correction):
    return lambda length: jm.SurfaceReconstruction(coarse, correction)


CASES = [
    Case("default", lambda length: jm.SurfaceReconstruction(), **FIXED_AXES),
    Case("default with faces", lambda length: jm.SurfaceReconstruction(), **FIXED_AXES, faces=True),
    Case(
        "published",
        lambda length: jm.SurfaceReconstruction.published(),
        **FIXED_AXES,
        dimensions=(2,),
    ),
    Case("few-sources", reconstruction(few(), jm.DelaunayGraph()), **FIXED_AXES),
    Case("farthest", reconstruction(farthest(), jm.DelaunayGraph()), **FIXED_AXES, dimensions=(2,)),
    Case(
        "near-wall",
        lambda length: jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3 * length)),
        **FIXED_AXES,
    ),
    Case(
        "near-wall-alone", lambda length: jm.NearWall(), affine=False, **FIXED_AXES, dimensions=(2,)
    ),
    Case("multiscale", reconstruction(few(), jm.Multiscale()), **FIXED_AXES),
    Case("multiscale-whole", lambda length: jm.Multiscale.whole(2 * length, 0.2), **ALONE),
    Case("multiscale-alone", lambda length: jm.Multiscale(), **ALONE, dimensions=(2,)),
    Case("local", reconstruction(few(), jm.LocalCorrection()), **FIXED_AXES),
    Case("local-alone", lambda length: jm.LocalCorrection(2 * length), **ALONE, dimensions=(2,)),
    Case("delaunay", lambda length: jm.DelaunayGraph()),
    Case(
        "delaunay-coarse", reconstruction(jm.DelaunayGraph(), jm.DelaunayGraph()), dimensions=(2,)
    ),
    Case(
        "fitted",
        lambda length: jm.FittedRBF(few(), ell=0.2 * length, mu=0.1 * length),
        **FIXED_AXES,
        exact=False,
        faces=True,
    ),
    Case("reduced", lambda length: few(), **FIXED_AXES, exact=False),
    Case("thin-plate-1", lambda length: full(jm.ThinPlateSpline(), 1), dimensions=(3,)),
    Case(
        "wendland-none",
        lambda length: full(jm.WendlandC2(2 * length), None),
        **ALONE,
        dimensions=(2,),
    ),
    Case("notebook's basis", lambda length: full(extension().Cubic(), 1), dimensions=(3,)),
    Case("notebook's method", lambda length: extension().Shepard(), affine=False, dimensions=(2,)),
    Case("elasticity", lambda length: jm.LinearElasticity(), affine=False),
    Case("torsional", lambda length: jm.TorsionalSprings(), affine=False),
    Case("springs", lambda length: jm.SpringAnalogy(), affine=False, dimensions=(2,)),
    Case("laplacian", lambda length: jm.Laplacian(), affine=False),
    Case("laplacian-uniform", lambda length: jm.Laplacian(jm.ByVolume(0.0)), dimensions=(2,)),
    Case("biharmonic", lambda length: jm.Biharmonic(), affine=False, dimensions=(2,)),
    Case(
        "laplacian-near-wall",
        lambda length: jm.SurfaceReconstruction(jm.Laplacian(), jm.NearWall()),
        **FIXED_AXES,
        affine=False,
        dimensions=(2,),
    ),
    Case("inverse-distance", lambda length: jm.InverseDistance(), affine=False),
    Case(
        "inverse-distance-turning",
        lambda length: jm.InverseDistance(rotations=True),
        affine=False,
        dimensions=(2,),
        faces=True,
    ),
    Case("compact", lambda length: jm.CompactRBF(2 * length), **ALONE),
    Case(
        "compact-automatic", reconstruction(few(), jm.CompactRBF()), **FIXED_AXES, dimensions=(2,)
    ),
    Case(
        "ridge",
        lambda length: dataclasses.replace(jm.RBF.classic(), ridge=1e-4),
        exact=False,
        dimensions=(2,),
    ),
    Case("iterative", lambda length: iterative(jm.ThinPlateSpline())),
    Case(
        "iterative-wendland-none",
        lambda length: iterative(jm.WendlandC2(2 * length), degree=None),
        **ALONE,
        dimensions=(2,),
    ),
    Case("gaussian-1", lambda length: full(jm.Gaussian(0.1 * length), 1), dimensions=(2,)),
    Case(
        "multiquadric-0",
        lambda length: full(jm.Multiquadric(0.1 * length), 0),
        affine=False,
        dimensions=(2,),
    ),
]
NAMES = [(case.name, dimension) for case in CASES for dimension in case.dimensions]
BY_NAME = {case.name: case for case in CASES}


@dataclasses.dataclass(frozen=True)
class Body:
    """Points between a body, which moves, and a far field, which is fixed."""

    points: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray

    @property
    def boundary(self) -> np.ndarray:
        return np.concatenate([self.moving, self.fixed])

    @property
    def outside(self) -> np.ndarray:
        """Simplices between body and far field, whose outer faces are all on these two."""
        corners = Delaunay(self.points).simplices
        return corners[~np.isin(corners, self.moving).all(axis=1)]

    @property
    def cells(self) -> np.ndarray:
        """Simplices between body and far field that are no slivers."""
        corners = self.outside
        edges = self.points[corners[:, 1:]] - self.points[corners[:, :1]]
        size = np.linalg.norm(edges, axis=2).prod(axis=1)
        return corners[np.abs(np.linalg.det(edges)) > 1e-3 * size]

    @property
    def inner(self) -> np.ndarray:
        return np.setdiff1d(np.arange(len(self.points)), self.boundary)


@functools.cache
def body(dimension: int) -> Body:
    """An ellipse in 310 points, or an ellipsoid in 605, in layers that grow towards a far field; nothing aligned."""
    rng = np.random.default_rng(dimension)
    if dimension == 2:
        angle = np.linspace(0, 2 * np.pi, 31, endpoint=False) + 0.13
        directions, layers = np.stack([np.cos(angle), np.sin(angle)], axis=1), 10
    else:
        directions, layers = sphere(55), 11
    axes = np.array([0.5, 0.23, 0.31])[:dimension]
    wall, far = directions * axes, 4 * directions
    share = np.geomspace(1e-3, 1, layers - 1)
    points = np.concatenate([wall, *(wall + s * (far - wall) for s in share)])
    k = len(wall)
    scatter = (
        0.2 * np.repeat(np.concatenate([[0], share]), k)[:, None] * rng.uniform(-1, 1, points.shape)
    )
    scatter[-k:] *= 0.05
    scatter[-2 * k : -k] *= 0.2
    order = rng.permutation(len(points))
    place = np.argsort(order)
    return Body((points + scatter)[order], place[:k], place[-k:])


def planned(mesh: Body, method=None) -> jm.Plan:
    return jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method)


def moved_by(mesh: Body, method, u) -> np.ndarray:
    """Points (n, d) after a displacement of the body by a method."""
    return np.asarray(jm.deform(planned(mesh, method), u))


def motion(points: np.ndarray) -> np.ndarray:
    """A smooth displacement that no polynomial of degree 1 makes, of a few per cent of the unit length."""
    d = points.shape[1]
    phase = points @ np.array([[2.1, -1.3, 0.7], [0.9, 1.7, -2.2], [-1.1, 0.4, 1.9]])[:d, :d]
    return 0.04 * np.sin(phase + 0.3) + 0.02


def whole_and_part(dimension, planes):
    """A body symmetric in the first `planes` coordinates, whole, and the ids of the part on the positive side."""
    mesh = body(dimension)
    part = mesh.points[(mesh.points[:, :planes] > 0.05).all(axis=1)]
    role = np.zeros(len(mesh.points), int)
    role[mesh.moving], role[mesh.fixed] = 1, 2
    role = role[(mesh.points[:, :planes] > 0.05).all(axis=1)]
    for axis in range(planes):  # a layer of nodes on the plane
        on = part[:: 3 if dimension == 2 else 2].copy()
        on[:, axis] = 0
        part, role = (
            np.concatenate([part, on]),
            np.concatenate([role, role[:: 3 if dimension == 2 else 2]]),
        )
    _, first = np.unique(np.round(part, 9), axis=0, return_index=True)
    part, role = part[np.sort(first)], role[np.sort(first)]
    whole, whole_role, image_of, signs = part, role, np.arange(len(part)), np.ones_like(part)
    for axis in range(planes):
        off = whole[:, axis] != 0
        flip = np.ones(dimension)
        flip[axis] = -1
        whole = np.concatenate([whole, whole[off] * flip])
        whole_role, image_of = (
            np.concatenate([whole_role, whole_role[off]]),
            np.concatenate([image_of, image_of[off]]),
        )
        signs = np.concatenate([signs, signs[off] * flip])
    return part, role, whole, whole_role, image_of, signs


def surface_values(mesh):
    """u on the moving nodes, nothing on the fixed ones."""
    u = motion(mesh.points[mesh.moving])
    return u, np.concatenate([u, np.zeros((len(mesh.fixed), u.shape[1]))])
