"""Plans in files, and `jmplan.h`, which moves a mesh by them: against `deform` and `pullback`, and on damaged files."""

import ctypes
import pathlib
import shutil
import subprocess

import numpy as np
import pytest
from cases import BY_NAME, NAMES, body, motion
from meshes import between_half_planes, capsule, joined, ring, sector
from runs import all_refused, over, printed, refused, runs

import jaxmorph as jm
from jaxmorph import cases, io, native
from jaxmorph.cli import main

COMPILER = shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O3", "-march=native")
NAMED = ("dimension", "count", "moving", "layer")

REFUSED = {
    *(
        "elasticity",
        "torsional",
        "springs",
        "laplacian",
        "laplacian-uniform",
        "laplacian-near-wall",
        "biharmonic",
    ),
    *(
        "inverse-distance-turning",
        "compact",
        "compact-automatic",
        "iterative",
        "iterative-wendland-none",
    ),
    *("notebook's method", "notebook's basis"),
}
"""Cases of the contract that no file holds: solves on cells or by iterations, turns, classes of the user."""


def compiled(folder: pathlib.Path, *flags: str, name: str = "plan.so") -> ctypes.CDLL:
    source = folder / "plan.c"
    source.write_text('#define JMPLAN_IMPLEMENTATION\n#include "jmplan.h"\n')
    target = folder / name
    subprocess.run(
        [COMPILER, *flags, "-fPIC", "-shared", f"-I{native.folder}", source, "-o", target, "-lm"],
        check=True,
    )
    library = ctypes.CDLL(str(target))
    library.jm_open.restype = library.jm_rest.restype = library.jm_nodes.restype = ctypes.c_void_p
    library.jm_error.restype = ctypes.c_char_p
    for each in NAMED:
        getattr(library, f"jm_{each}").restype = ctypes.c_int64
    return library


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("native"), *STRICT)


class Opened:
    """A plan in C, with arrays of NumPy."""

    def __init__(self, library: ctypes.CDLL, path: pathlib.Path):
        self.library, self.plan = library, ctypes.c_void_p(library.jm_open(str(path).encode()))
        self.error = library.jm_error(self.plan)
        if self.error is None:
            self.d, self.n, self.m = (
                getattr(library, f"jm_{name}")(self.plan) for name in NAMED[:3]
            )

    def __enter__(self):
        assert self.error is None, self.error
        return self

    def __exit__(self, *_):
        self.library.jm_close(self.plan)

    def deform(self, u):
        return self._call(self.library.jm_deform, u, self.n)

    def pullback(self, bar):
        return self._call(self.library.jm_pullback, bar, self.m)

    def _call(self, function, values, rows):
        given, result = np.ascontiguousarray(values, float), np.full((rows, self.d), np.nan)
        assert (
            function(self.plan, *(ctypes.c_void_p(array.ctypes.data) for array in (given, result)))
            == 0
        )
        return result

    def nodes(self):
        pointer = ctypes.cast(self.library.jm_nodes(self.plan), ctypes.POINTER(ctypes.c_int64))
        return np.ctypeslib.as_array(pointer, (self.m,)).copy()


def check(library, plan, path, u, back):
    """The header moves as `deform` does, walls bit for bit, and its transpose is the transpose.

    `back` bounds the difference of both pullbacks, relative to their largest entry: round-off times the condition of the system.
    """
    jm.export(plan, path)
    moved = np.asarray(jm.deform(plan, u))
    extent = np.ptp(moved, axis=0).max()
    bar = np.random.default_rng(0).normal(size=moved.shape)
    base, wall = np.asarray(plan.points), np.asarray(plan.moving_points)
    near = (
        bar * np.exp(-10 * np.linalg.norm(base - wall.mean(axis=0), axis=1) / np.ptp(wall))[:, None]
    )
    with Opened(library, path) as opened:
        points, of_all, of_near = opened.deform(u), *map(opened.pullback, (bar, near))
    np.testing.assert_allclose(points, moved, rtol=0, atol=1e-13 * extent)
    if plan.method.exact:
        held = np.append(np.asarray(plan.moving), np.asarray(plan.fixed))
        np.testing.assert_array_equal(points[held], moved[held])
    shift = points - base
    assert abs((shift * bar).sum() - (u * of_all).sum()) < 1e-13 * np.linalg.norm(
        shift
    ) * np.linalg.norm(bar)
    for found, cotangent in ((of_all, bar), (of_near, near)):
        wanted = np.asarray(jm.pullback(plan, u, cotangent))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=back * np.abs(wanted).max())


EXPORTED = [pair for pair in NAMES if pair[0] not in REFUSED]
FAST = [(name, 2) for name in ("default", "published", "multiscale", "inverse-distance")] + [
    ("default with faces", 3)
]


SLOW = [("default", 3), ("fitted", 3), ("reduced", 3), ("multiscale", 3), ("gaussian-1", 2)]


@over(
    "name dimension",
    fast=FAST,
    slow=SLOW,
    nightly=[pair for pair in EXPORTED if pair not in FAST + SLOW],
)
def test_the_header_moves_as_deform_does(library, tmp_path, name, dimension):
    mesh = body(dimension)
    plan = BY_NAME[name].prepared(mesh.points, mesh.moving, mesh.fixed)
    check(library, plan, tmp_path / "body.plan", motion(mesh.points[mesh.moving]), back=1e-11)


@over(
    "name",
    fast=["elasticity", "inverse-distance-turning", "notebook's basis"],
    nightly=sorted(REFUSED),
)
def test_other_methods_are_refused_by_name(tmp_path, name):
    dimension = BY_NAME[name].dimensions[0]
    mesh = body(dimension)
    plan = BY_NAME[name].prepared(mesh.points, mesh.moving, mesh.fixed)
    with pytest.raises(ValueError, match=r"cannot be exported|is not linear"):
        jm.export(plan, tmp_path / "body.plan")
    assert not list(tmp_path.iterdir())


BASES = (
    jm.LinearSpline(),
    jm.CubicSpline(),
    jm.Gaussian(0.3),
    jm.Multiquadric(0.1),
    jm.InverseMultiquadric(0.2),
)
COMPACT = (
    jm.WendlandC0,
    jm.WendlandC2,
    jm.WendlandC4,
    jm.WendlandC6,
    jm.CompactC0,
    jm.CompactC1,
    jm.CompactC2a,
    jm.CompactC2b,
)


@over("basis", slow=BASES[:2], nightly=[*BASES[2:], *(kind(1.5) for kind in COMPACT)])
def test_every_basis(library, tmp_path, basis):
    mesh = body(2)
    few = {"reduction": jm.KDTree(3), "fixed_reduction": jm.KDTree(3)}
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.RBF(basis, **few))
    check(library, plan, tmp_path / "body.plan", motion(mesh.points[mesh.moving]), back=1e-10)


def wing(**boundary):
    return jm.prepare(
        cases.wing(points=300, stations=5, first_cell=1e-3), "wing", "farfield", **boundary
    )


BOUNDARIES = {
    "one plane": lambda: wing(symmetry="root", free="tip"),
    "a sector": lambda: jm.prepare(capsule(30), "wall", "far", symmetry=between_half_planes(30)),
    "parallel planes": lambda: wing(symmetry=("root", "tip")),
    "sliding": lambda: wing(sliding=("root", "tip")),
    "periodic": lambda: quarter(),
    "a node of no cell": lambda: jm.prepare(with_loose_node(), "wall", "far"),
}


def quarter() -> jm.Plan:
    points, moving, fixed, sides, _ = sector(2)
    return jm.prepare(points, moving, fixed, periodic=[joined(2, sides)])


def with_loose_node() -> jm.Mesh:
    mesh = ring()
    return jm.Mesh(np.vstack([mesh.points, [[0.1, 40.0]]]), mesh.cells, mesh.patches)


@over(
    "name",
    slow=["periodic", "one plane", "a sector", "a node of no cell"],
    nightly=["sliding", "parallel planes"],
)
def test_boundaries(library, tmp_path, name):
    plan = BOUNDARIES[name]()
    wall = np.asarray(plan.moving_points)
    u = plan.of_surface(motion(wall / np.ptp(wall)) * np.ptp(wall))[: plan.n_moving]
    check(library, plan, tmp_path / "mesh.plan", u, back=1e-8)


def test_parts_move_as_the_whole_bit_for_bit(library, tmp_path):
    mesh = body(3)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    u = motion(mesh.points[mesh.moving])
    jm.export(plan, tmp_path / "whole.plan")
    with Opened(library, tmp_path / "whole.plan") as opened:
        whole = opened.deform(u)
    for nodes in (np.arange(100, 400), np.random.default_rng(1).permutation(len(whole))[:77]):
        jm.export(plan, tmp_path / "part.plan", nodes=nodes)
        with Opened(library, tmp_path / "part.plan") as opened:
            np.testing.assert_array_equal(opened.deform(u), whole[nodes])
            here = opened.nodes()
        np.testing.assert_array_equal(np.isin(mesh.moving, nodes), here >= 0)
        np.testing.assert_array_equal(nodes[here[here >= 0]], mesh.moving[here >= 0])


@pytest.mark.slow
def test_ranges_and_threads_give_equal_bits(library, tmp_path):
    mesh = cases.naca0015(points=6000)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    u = motion(np.asarray(plan.moving_points))
    jm.export(plan, tmp_path / "airfoil.plan")
    threads = compiled(tmp_path, *STRICT, "-fopenmp", name="threads.so")
    with (
        Opened(library, tmp_path / "airfoil.plan") as one,
        Opened(threads, tmp_path / "airfoil.plan") as many,
    ):
        whole = one.deform(u)
        np.testing.assert_array_equal(many.deform(u), whole)
        np.testing.assert_array_equal(many.pullback(whole), one.pullback(whole))
        library.jm_fit.restype = ctypes.c_void_p
        fit = ctypes.c_void_p(library.jm_fit(one.plan, ctypes.c_void_p(u.ctypes.data)))
        part = np.empty((1234, 2))
        library.jm_move(
            one.plan,
            fit,
            ctypes.c_int64(700),
            ctypes.c_int64(1234),
            ctypes.c_void_p(part.ctypes.data),
        )
        ctypes.CDLL(None).free(fit)
        np.testing.assert_array_equal(part, whole[700:1934])


def test_a_layer_of_cells(library, tmp_path):
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    points = np.repeat(np.arange(len(mesh.points)), 2)
    jm.export(plan, tmp_path / "layer.plan", layer=jm.Layer(points, (0, 2)))
    with Opened(library, tmp_path / "layer.plan") as opened:
        pointer, axes = ctypes.POINTER(ctypes.c_int32)(), (ctypes.c_int * 2)()
        count = library.jm_layer(opened.plan, ctypes.byref(pointer), axes)
        np.testing.assert_array_equal(np.ctypeslib.as_array(pointer, (count,)), points)
    assert list(axes) == [0, 2]


def test_what_no_file_holds_is_told(tmp_path):
    mesh, file = body(2), tmp_path / "body.plan"
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    single = jm.prepare(mesh.points.astype(np.float32), mesh.moving, mesh.fixed)
    all_refused(
        (lambda: jm.export(single, file), "float32.*jax_enable_x64"),
        (lambda: jm.export(plan, file, nodes=[1, 1]), "1 points more than once"),
        (lambda: jm.export(plan, file, nodes=[999999]), "not in 0 to"),
        (lambda: jm.export(plan, tmp_path / "none" / "body.plan"), "none"),
        (
            lambda: jm.export(plan, file, layer=jm.Layer(np.array([len(mesh.points)]), (0, 1))),
            "layer.points",
        ),
        (lambda: jm.Layer(np.array([0]), (0, 5)), "`axes` must be two of 0, 1, 2"),
    )
    assert not list(tmp_path.iterdir())


def small_plan(file: pathlib.Path) -> bytes:
    mesh = body(2)
    jm.export(jm.prepare(mesh.points, mesh.moving, mesh.fixed), file)
    return file.read_bytes()


def test_a_damaged_file_is_refused(library, tmp_path):
    file = tmp_path / "body.plan"
    whole = small_plan(file)
    rng = np.random.default_rng(0)
    damaged = {
        b"": b"no plan",
        b"JMPLAN": b"no plan",
        whole[:-8]: b"cut",
        whole + bytes(8): b"cut",
        whole[:200]: b"cut",
    }
    damaged[whole[:8] + b"\2" + whole[9:]] = b"version"
    for place in (40, 8 * 20, *rng.integers(144, len(whole), 20)):
        damaged[whole[:place] + bytes([whole[place] ^ 64]) + whole[place + 1 :]] = (
            b"changed|damaged"
        )
    for content, words in damaged.items():
        file.write_bytes(content)
        opened = Opened(library, file)
        assert opened.error, content[:20]
        assert any(word in opened.error for word in words.split(b"|")), opened.error
        library.jm_close(opened.plan)
    assert b"opened" in Opened(library, tmp_path / "none").error


FUZZ = r"""
#define JMPLAN_IMPLEMENTATION
#include "jmplan.h"
static uint64_t state;
static uint64_t next(void) { state ^= state << 13; state ^= state >> 7; state ^= state << 17; return state; }
int main(int count, char **words) {
    int good = 0;
    FILE *file = fopen(words[1], "rb");
    fseek(file, 0, SEEK_END);
    const long size = ftell(file);
    int64_t *whole = malloc(size), *copy = malloc(size);
    rewind(file);
    if (count < 4 || fread(whole, size, 1, file) != 1) return 2;
    fclose(file);
    for (int k = 0; k < atoi(words[3]); k++) {
        uint64_t sums[2];
        state = 88172645463325252u + 977u * k;
        memcpy(copy, whole, size);
        for (int j = next() % 3; j >= 0; j--) {        /* words of header and tables are changed more often than numbers */
            const long place = (next() % 2 ? next() % 400 : next()) % (size / 8 - 5) + 5;
            const uint64_t value = next();
            const int64_t other = copy[value % (size / 8)], more = (int64_t)((uint64_t)copy[place] + 1);
            const int64_t words[] = {(int64_t)value, (int64_t)(value % 64), -1, more, INT64_MAX, other};
            copy[place] = words[next() % 6];
        }
        jm_sums(copy + 5, size / 8 - 5, sums);
        copy[3] = (int64_t)sums[0];
        copy[4] = (int64_t)sums[1];
        file = fopen(words[2], "wb");
        fwrite(copy, size, 1, file);
        fclose(file);
        jm_plan *plan = jm_open(words[2]);
        if (!jm_error(plan)) {
            double *u = calloc(jm_moving(plan) * jm_dimension(plan) + 1, 8);
            double *points = calloc(jm_count(plan) * jm_dimension(plan) + 1, 8);
            jm_deform(plan, u, points);
            jm_pullback(plan, points, u);
            free(u);
            free(points);
            good++;
        }
        jm_close(plan);
    }
    free(whole);
    free(copy);
    printf("%d\n", good);
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("rounds", runs(fast=[100], nightly=[5000]))
def test_files_with_wrong_words_and_right_sums_do_no_harm(tmp_path, rounds):
    """Under the sanitizers of addresses and of undefined behaviour; most such files are refused, some are read."""
    program, source = tmp_path / "fuzz", tmp_path / "fuzz.c"
    source.write_text(FUZZ)
    flags = (
        "-g",
        "-O1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        f"-I{native.folder}",
    )
    built = subprocess.run(
        [COMPILER, *flags, source, "-o", program, "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode:
        pytest.skip(f"no sanitizers: {built.stderr.splitlines()[-1]}")
    for make in (
        small_plan,
        *([lambda file: jm.export(wing(sliding=("root", "tip")), file)] if rounds > 100 else []),
    ):
        make(tmp_path / "good.plan")
        words = [program, tmp_path / "good.plan", tmp_path / "bad.plan", str(rounds)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        assert 0 < int(done.stdout) < rounds


@over("language", ["c"], slow=["c++", "f90"])
def test_the_examples_move_the_wall_up(tmp_path, language):
    file = tmp_path / "body.plan"
    small_plan(file)
    examples, header = native.folder / "examples", native.folder / "jmplan.h"
    build = ["-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", f"-I{native.folder}"]
    if language == "f90":
        fortran = shutil.which("gfortran")
        if fortran is None:
            pytest.skip("no gfortran")
        subprocess.run(
            [
                COMPILER,
                *build,
                "-x",
                "c",
                "-DJMPLAN_IMPLEMENTATION",
                "-c",
                header,
                "-o",
                tmp_path / "jm.o",
            ],
            check=True,
        )
        words = [
            fortran,
            "-Wall",
            "-Werror",
            f"-J{tmp_path}",
            examples / "move.f90",
            tmp_path / "jm.o",
        ]
    else:
        source = tmp_path / "move.cc"
        source.write_text(
            (examples / "move.c")
            .read_text()
            .replace("= calloc", "= (double *)calloc")
            .replace("= malloc", "= (double *)malloc")
        )
        compiler = shutil.which("c++") if language == "c++" else COMPILER
        words = [compiler, *build, *(["-std=c99"] if language == "c" else ["-std=c++11"])]
        words.append(examples / "move.c" if language == "c" else source)
    subprocess.run([*words, "-o", tmp_path / "move", "-lm"], check=True)
    done = subprocess.run([tmp_path / "move", file], capture_output=True, text=True, check=True)
    mesh = body(2)
    wanted = jm.deform(
        jm.prepare(mesh.points, mesh.moving, mesh.fixed), np.tile([0, 0.1], (len(mesh.moving), 1))
    )
    np.testing.assert_allclose(
        np.array(done.stdout.split(), float).reshape(-1, 2), wanted, atol=1e-13
    )


def test_the_command_exports(library, tmp_path, capsys):
    io.write(tmp_path / "ring.su2", ring())
    words = [
        "export",
        str(tmp_path / "ring.su2"),
        str(tmp_path / "ring.plan"),
        "--moving",
        "wall",
        "--fixed",
        "far",
    ]
    assert "24 moving nodes" in printed(capsys, words)
    with Opened(library, tmp_path / "ring.plan") as opened:
        assert (opened.d, opened.n, opened.m) == (2, len(ring().points), 24)
    refused(capsys, [words[0], words[1], *words[3:]], "OUT is missing")
    assert main([*words, "--method", "elasticity"]) == 2
    assert "LinearElasticity cannot be exported" in capsys.readouterr().err
    refused(capsys, [*words, "--dtype", "float32"], "double precision. Leave the flag away")
    assert printed(capsys, ["native"]).strip() == str(native.folder)
