"""Extensions of your own: shapes, a method on cells, a stiffness, a placing method, a reduction, search points, `jaxmorph.extend`."""

import dataclasses
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, extend, shapes

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
wall = mesh.points[mesh.patch("airfoil")]
u = 0.05 * np.sin(np.pi * wall[:, :1]) * np.array([0.0, 1.0])


class Sag(shapes.AbstractLinearShape):
    """Lowers positions by a sine's half wave; the parameter is its depth."""

    def neutral(self):
        return jnp.zeros(())

    def at(self, x):
        weight = jnp.sin(jnp.pi * jnp.clip(x[:, 0], 0, 1))
        return lambda depth: jnp.zeros_like(x).at[:, 1].set(-depth * weight)


class Droop(shapes.AbstractShape):
    """Turns what lies before a hinge; the parameter is an angle."""

    hinge: float

    def neutral(self):
        return jnp.zeros(())

    def __call__(self, x, angle):
        turned = shapes.rotate(x, angle, (self.hinge, 0.0))
        return jnp.where(x[:, :1] < self.hinge, turned, x)


assert isinstance(Sag(), shapes.AbstractShape)
both = shapes.Chain({"sag": Sag(), "droop": Droop(0.2)})
assert shapes.names(both.neutral()) == ["droop", "sag"]


class BySize(jm.AbstractStiffness):
    """As stiff as the inverse root of a cell's volume."""

    def __call__(self, volume, distance):
        return volume**-0.5


class EqualSprings(jm.AbstractCellMethod):
    """Springs of one stiffness along all pairs of a cell's corners."""

    def entries(self, kind, corners, distance):
        return -jnp.ones(len(self.pairs(kind)), corners.dtype)


class Nearest(jm.AbstractPlacing):
    """A point moves like the surface's node nearest to it, by a share that fades with the distance."""

    def connect(self, surface: jm.Surface, points):
        tree = extend.Tree(surface.points)
        return None, np.asarray(tree.query(points)[1], dtype=np.int32)

    def fit(self, ids, surface, points):
        return None

    def place(self, x, ids, factors, surface):
        return ids, jnp.exp(-jnp.sum((x - surface[ids]) ** 2))

    def control(self, ids):
        return jm.Control()  # no row controls the field more than others

    def field(self, ids, factors, surface, u):
        return NearestField(u)


class NearestField(jm.AbstractField):
    u: jax.Array

    def __call__(self, x, ids):
        node, share = ids
        return share * self.u[node]


@dataclasses.dataclass(frozen=True)
class Edges(jm.AbstractSearchPoints):
    """The middles of a box's sides."""

    def local(self, dimension):
        return np.concatenate([np.eye(dimension), -np.eye(dimension)])


@dataclasses.dataclass(frozen=True)
class EveryOther(jm.AbstractReduction):
    """Every second point."""

    def __call__(self, points):
        return np.arange(0, len(points), 2)


class Quintic(jm.AbstractBasis):
    """phi(r) = r^5, with a linear polynomial."""

    min_degree = 1
    scale_free = True

    def __call__(self, r2):
        positive = r2 > 0
        return jnp.where(positive, jnp.where(positive, r2, 1.0) ** 2.5, 0.0)


few = jm.RBF(reduction=jm.KDTree(8, Edges()))
for method in (
    jm.LinearElasticity(BySize()),
    EqualSprings(),
    Nearest(),
    jm.SurfaceReconstruction(few, Nearest()),
    jm.RBF(reduction=EveryOther()),
    jm.SurfaceReconstruction(jm.RBF(Quintic(), jm.FarthestPoints(8), jm.FarthestPoints(8))),
):
    assert isinstance(method, jm.AbstractMethod)
    plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
    print(type(method).__name__, int(jm.quality(mesh, jm.deform(plan, u)).inverted), "inverted")


# What the package gives to extensions: arguments, paths, arrays, geometry, processes.
@extend.checked
def scaled(points: np.ndarray, factor: float) -> np.ndarray:
    """Scales points; another type is an error that names the argument."""
    extend.between("factor", factor, 0)
    return factor * extend.finite_array("points", points, (None, 2), (None, 3))


assert scaled(wall, 2.0).shape == extend.real_array("wall", wall, (None, 2)).shape
assert extend.whole("steps", 3) == 3
assert list(extend.rows_of("nodes", [2, 0], len(wall))) == [2, 0]
assert extend.is_known(1.0, wall)
assert extend.patch_names(["air.*"], mesh.patches, {}) == ("airfoil",)
assert extend.decoded("flügel".encode("latin-1")) == "flügel"
with extend.complete(extend.output_path("note.txt", ".txt")) as file:
    file.write_text("appears when it is whole\n")
assert extend.input_path("note.txt").exists()
assert set(extend.solid(mesh.cells, 2)) == {"quad"}
assert extend.spacing(wall).min() > 0
assert extend.fans(np.arange(4), np.array([4])).shape == (2, 3)
assert list(extend.join_ids(mesh.cells.values())) == list(mesh.cells["quad"].ravel())
assert list(extend.parts_of(np.array([0]), np.array([2]), 3)) == [0, 1, 0]
edges = wall[jnp.array([[0, 1], [1, 2]])]
assert np.allclose(extend.norm(extend.area_vectors(edges)), extend.norm(edges[:, 1] - edges[:, 0]))
near = extend.closest(np.array([[[0.0, 0], [1, 0]]]), np.array([[0.5, 1.0]]))
print("closest:", near)
order2: extend.Lagrange = extend.lagrange_types()["quad9"]
assert order2.order == 2


def ascending(values: np.ndarray) -> np.ndarray:
    """A function of NumPy arrays, which traced code calls."""
    return np.sort(values)


class Weights(extend.Module):
    """A module with a hash, also with arrays: `jax.jit` looks functions up by it."""

    values: jax.Array = eqx.field(converter=jnp.asarray)


assert isinstance(hash(Weights([1.0, 2.0])), int)
with extend.float64_mode(), extend.quickly_compiled():
    shape = jax.ShapeDtypeStruct((3,), jnp.float64)
    answer = jax.jit(lambda x: extend.host_call(ascending, shape, x))(jnp.array([3.0, 1.0, 2.0]))
assert answer.tolist() == [1, 2, 3]
alone = extend.Alone()  # or mpi4py's communicator
assert extend.together(alone, lambda: 7) == 7
shared = extend.Agreement(alone)  # nodes of several parts get equal values
crossings = extend.wall_crossings(plan, mesh, np.asarray(u)[None])
print("crossings:", crossings)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    extend.warn("a warning names the line of the user's own code")
assert len(caught) == 1


@extend.by_place
def shares(points, rows):
    """Counts how often rows are named, and marks the first point: by NumPy, or compiled."""
    xp = extend.namespace(points)
    count = extend.add_at(xp.zeros(len(points)), rows, xp.ones(len(rows)))
    return extend.put_at(count, xp.asarray([0]), xp.asarray([-1.0]))


rows = np.array([1, 2, 2])
for points in (np.asarray(wall), extend.as_jax(np.asarray(wall))):
    assert np.array_equal(shares(points, rows)[:3], [-1, 1, 2])
print(extend.cad_model.__name__, "makes the model of a CAD file, where OpenCASCADE is installed")
