"""Plans in files: every bit comes back, and nothing in a file is ever run."""

import enum
import json
import os
import pickle
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, extension, few, motion
from runs import over

import jaxmorph as jm
from jaxmorph import cases


class Law(enum.Enum):
    LINEAR = 1
    CUBIC = 3


class Power(jm.AbstractBasis):
    """r to the power of a law; every kind of field that a file holds."""

    law: Law = eqx.field(static=True)
    scale: jax.Array
    weights: dict
    notes: tuple = eqx.field(static=True)
    min_degree = 1

    def __call__(self, r2):
        return self.scale * (r2 + 1e-12) ** (self.law.value / 2)


def power():
    weights = {"whole": np.arange(3, dtype=np.int16), "pair": [np.float32(0.1), jnp.ones(2, bool)]}
    return Power(Law.CUBIC, jnp.asarray(0.5), weights, (1, -2.5, float("inf"), None, ("a", True)))


def planned(method, symmetry=(), dtype=np.float64):
    one = body(2)
    return jm.prepare(
        one.points.astype(dtype), one.moving, one.fixed, method=method, symmetry=symmetry
    )


GAUSS = jm.GaussPoints()
METHODS = {
    "default": (lambda: jm.SurfaceReconstruction(few(), jm.NearWall(width=0.2)), ()),
    "greedy": (
        lambda: jm.RBF(jm.WendlandC2(3), jm.Greedy(9, np.ones((2, 31, 2))), jm.AllPoints()),
        (),
    ),
    "gauss": (
        lambda: jm.RBF(
            jm.Multiquadric(0.1), jm.KDTree(np.int64(4), GAUSS, extremes=True), degree=0
        ),
        (),
    ),
    "own basis": (lambda: jm.RBF(power(), jm.AllPoints(), jm.AllPoints()), (Power, Law)),
}


def method(name):
    """Returns what makes a method, and the classes that a reader of its plan has to know."""
    if name == "own method":
        return extension().Shepard, (extension().Shepard, extension().ShepardField)
    return METHODS[name]


@over("name", ["default", "own basis", "own method"], nightly=["greedy"])
def test_a_loaded_plan_is_the_same_to_the_last_bit(tmp_path, name):
    make, classes = method(name)
    plan = planned(make())
    jm.save(tmp_path / "a.plan", plan)
    again = jm.load(tmp_path / "a.plan", classes)
    leaves, structure = jax.tree.flatten(plan)
    found, same = jax.tree.flatten(again)
    if name not in (
        "greedy",
        "own basis",
    ):  # a Greedy is compared by identity, dictionaries and arrays have no hash
        assert same == structure
    assert str(same) == str(structure)
    for a, b in zip(leaves, found, strict=True):
        assert (type(a), a.dtype, getattr(a, "weak_type", None)) == (
            type(b),
            b.dtype,
            getattr(b, "weak_type", None),
        )
        np.testing.assert_array_equal(a, b)
    u = motion(body(2).points[body(2).moving])
    np.testing.assert_array_equal(jm.deform(again, u), jm.deform(plan, u))
    assert os.listdir(tmp_path) == ["a.plan"]


@pytest.mark.nightly
def test_fields_keep_their_types(tmp_path):
    """Also where other types are equal: NumPy's numbers, lists, what is infinite, and arrays that no leaf holds."""
    for name in ("own basis", "greedy", "gauss"):
        plan = planned(METHODS[name][0]())
        jm.save(tmp_path / "a.plan", plan)
        again = jm.load(tmp_path / "a.plan", METHODS[name][1])
        if name == "own basis":
            assert again.method.basis.law is Law.CUBIC
            assert again.method.basis.notes == power().notes
            assert type(again.method.basis.weights["pair"]) is list
        else:
            for field, value in vars(plan.method.reduction).items():
                assert type(vars(again.method.reduction)[field]) is type(value)
    assert again.method.reduction.largest_box == np.inf


@pytest.mark.slow
def test_steps_symmetry_and_single_precision(tmp_path):
    points = np.concatenate([body(2).points, [[-9.0, -9], [-9, 9], [9, -9], [9, 9]]])
    far = [*range(len(points) - 4, len(points))]
    plane = jm.Plane([0, 1], [0, -9.0])
    plan = jm.prepare(
        points.astype(np.float32), body(2).moving, far, method=jm.DelaunayGraph(), symmetry=plane
    )
    u = motion(points[body(2).moving])
    path = np.stack([0.3 * u, u]).astype(np.float32)
    plans, end = jm.march(plan, path)
    jm.save(tmp_path / "one", plan)
    jm.save(tmp_path / "two", (plans[0], [plans[1], plan]))
    again, rest = jm.load(tmp_path / "two")
    assert type(rest) is list
    assert again.points.dtype == np.float32
    np.testing.assert_array_equal(jm.replay((again, rest[0]), path), jm.replay(plans, path))
    np.testing.assert_allclose(jm.replay((again, rest[0]), path), end, atol=1e-5)
    # what the steps have in common is in the file once, and one array afterwards
    assert (tmp_path / "two").stat().st_size < 1.7 * (tmp_path / "one").stat().st_size
    assert again.surface.nodes is rest[0].surface.nodes


class Callable(jm.AbstractBasis):
    phi: object = eqx.field(static=True)

    def __call__(self, r2):
        return self.phi(r2)


OTHER = type("WendlandC2", (jm.ThinPlateSpline,), {})
UNSAVED = [
    (
        lambda plan: by(plan, jm.RBF(Callable(np.exp), degree=None)),
        r"plan.method.basis.phi is a ufunc, which a plan file cannot",
    ),
    (
        lambda plan: by(plan, jm.RBF(OTHER())),
        r"plan.method.basis is of a class WendlandC2 that is not jaxmorph's",
    ),
    (
        lambda plan: jm.shard(plan, jax.devices()[:1]),
        r"is laid over devices: save the plan that `prepare` returned",
    ),
    (lambda plan: plan.method, r"must be a Plan .*not a DelaunayGraph"),
]


def by(plan, method):
    return eqx.tree_at(lambda plan: plan.method, plan, method)


@pytest.mark.parametrize(("change", "words"), UNSAVED)
def test_what_cannot_be_saved_says_where(tmp_path, change, words):
    with pytest.raises(ValueError, match=words):
        jm.save(tmp_path / "a", change(planned(jm.DelaunayGraph())))
    assert os.listdir(tmp_path) == []


def altered(path, change):
    """The file with another description."""
    with np.load(path) as archive:
        members = dict(archive)
    header = json.loads(members["description"].tobytes())
    change(header)
    members["description"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path.with_name("b.npz"), **members)
    return path.with_name("b.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.update(version=1), "of version 1, but this jaxmorph reads 4: prepare the plan anew and save it"),
        (lambda h: h.update(format="other"), "not a saved plan; its format is 'other'"),
        (lambda h: h.pop("tree"), "a damaged plan"),
        (lambda h: h["tree"].update({"class": "Popen"}), r"the class 'Popen' is unknown; pass your own class as load\(path, cl"),
        (lambda h: h["tree"].update({"class": "os.system"}), "the class 'os.system' is unknown"),
        (lambda h: h["tree"].update({"class": "AbstractMethod", "fields": {}}), "a damaged plan"),
        (lambda h: h["tree"]["fields"].pop("n_moving"), "Plan has the fields method, .* in the file, but carried, .* here"),
        (lambda h: h["tree"]["fields"].update(volume={"jax": 10**6}), "a damaged plan"),
        (lambda h: h["tree"]["fields"].update(volume={}), "a damaged plan"),
        (lambda h: h.update(tree={"tuple": []}), "holds a tuple, not a plan"),
        (lambda h: h.update(tree=h["tree"]["fields"]["method"]), "holds a DelaunayGraph, not a plan"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_said(tmp_path, change, message):
    jm.save(tmp_path / "a.npz", planned(jm.DelaunayGraph()))
    with pytest.raises(ValueError, match=message):
        jm.load(altered(tmp_path / "a.npz", change))


def test_damaged_files_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    jm.save(path, planned(jm.DelaunayGraph()))
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    for damaged in (flipped, *(whole[: int(share * len(whole))] for share in (0, 0.3, 0.9, 0.999))):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"a\.npz: not a saved plan, or a damaged one"):
            jm.load(path)
    with pytest.raises(FileNotFoundError):
        jm.load(tmp_path / "none")


class Mark:
    """Leaves a trace when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_nothing_in_a_file_is_run(tmp_path):
    trace = str(tmp_path / "trace")
    evil = np.empty(1, object)
    evil[0] = Mark(trace)
    np.savez(tmp_path / "objects.npz", description=evil)
    np.save(tmp_path / "object.npy", evil)
    (tmp_path / "a.pickle").write_bytes(pickle.dumps(Mark(trace)))
    for name in ("objects.npz", "object.npy", "a.pickle"):
        with pytest.raises(ValueError, match="not a saved plan"):
            jm.load(tmp_path / name)
    assert not os.path.exists(trace)
    pickle.loads((tmp_path / "a.pickle").read_bytes())
    assert os.path.exists(trace)  # it does harm where it is let


@pytest.mark.parametrize(
    ("classes", "words"),
    [
        (
            (),
            r"the class 'Power' is unknown; pass your own class as load\(path, classes=\(Power,\)\)",
        ),
        ((type("RBF", (jm.RBF,), {}),), "two classes are called RBF"),
        ((print,), "`classes` must be a list, each a class"),
    ],
)
def test_classes_are_checked(tmp_path, classes, words):
    jm.save(tmp_path / "a", planned(jm.RBF(power(), jm.AllPoints(), jm.AllPoints())))
    with pytest.raises(ValueError, match=words):
        jm.load(tmp_path / "a", classes)


def test_a_new_process_knows_every_class(tmp_path):
    """The package imports a name at its first use; a file may hold one that nobody has used."""
    mesh = cases.naca0015(points=300)
    jm.save(tmp_path / "a", jm.prepare(mesh, "airfoil", "farfield", method=jm.SpringAnalogy()))
    code = "import jax, jaxmorph as jm, sys; jax.config.update('jax_enable_x64', True); print(jm.load(sys.argv[1]))"
    words = [sys.executable, "-c", code, str(tmp_path / "a")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "SpringAnalogy" in done.stdout, done.stderr


@pytest.mark.slow
def test_double_precision_needs_its_mode(tmp_path):
    jm.save(tmp_path / "a", planned(jm.DelaunayGraph()))
    code = "import jaxmorph as jm, sys; jm.load(sys.argv[1])"
    words = [sys.executable, "-c", code, str(tmp_path / "a")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "the plan is in float64, but JAX's x64 mode is off" in done.stderr
