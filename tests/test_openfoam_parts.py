"""Decomposed OpenFOAM cases: parts are read, moved, judged and written as the whole case is."""

import re
import shutil
import sys
import types

import foam
import numpy as np
import pytest
from meshes import grid
from runs import all_refused, mpi_run, printed, runs
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.package.ranks import Alone
from jaxmorph._mesh.topology import OuterFaces
from jaxmorph.cli import main
from jaxmorph.cli._decomposed import STARTED, _ranks, _say_warnings_of_all
from jaxmorph.cli._output import Output


def cubes(shape=(3, 2, 2)):
    """Points of a box of cubes, and the faces of each cell."""
    mesh = grid(*(np.arange(n + 1.0) for n in shape))
    return np.asarray(mesh.points), foam.hexahedra(mesh.cells["hexahedron"])


def box(points):
    """Patches of the box, by a test of a face's nodes."""
    high = points.max(axis=0)
    floor, roof = (
        (lambda nodes: (points[nodes, 2] == 0).all()),
        (lambda nodes: (points[nodes, 2] == high[2]).all()),
    )
    return [
        ("floor", "wall", floor),
        ("roof", "wall", roof),
        ("sides", "patch", lambda nodes: True),
    ]


@pytest.fixture
def divided(tmp_path):
    """A case of twelve cubes and its two parts, the second of which has the cells beyond the first plane."""
    points, cells = cubes()
    case = tmp_path / "case"
    foam.write_case(case, points, cells, box(points))
    foam.write_parts(
        case, points, cells, box(points), [0 if k < 4 else 1 for k in range(len(cells))]
    )
    return case


def test_a_part_has_no_boundary_to_other_parts(divided):
    whole, part = io.read(divided), io.read(divided / "processor1")
    ids = io.global_nodes(part)
    np.testing.assert_array_equal(whole.points[ids], part.points)
    assert list(part.patches) == ["floor", "roof", "sides"]
    between = np.asarray(part.between)
    assert between.shape == (4, 4)
    assert (part.points[between][:, :, 0] == 1).all()
    inner = np.setdiff1d(np.arange(len(ids)), part.patch("floor", "roof", "sides"))
    assert len(inner) == 2  # one between the parts, one between the last cells
    left = jm.Boundary(part, "floor", "roof", free="sides").left
    assert left is not None
    assert left.total == 20  # of 24 around these eight cubes


def test_parts_of_a_region_are_those_of_a_case(divided, tmp_path):
    """The parts of a region, constant/fluid in each processor's folder, move into the region's folders."""
    plain = io.Decomposed(divided)
    shutil.copytree(divided, tmp_path / "regions")
    for part in ("", "processor0", "processor1"):
        constant = tmp_path / "regions" / part / "constant"
        for region in ("fluid", "solid"):
            shutil.copytree(constant / "polyMesh", constant / region / "polyMesh")
        shutil.rmtree(constant / "polyMesh")
    fluid = tmp_path / "regions" / "constant" / "fluid"
    with pytest.raises(
        ValueError, match=rf"name one of the regions fluid, solid, as {re.escape(str(fluid))}"
    ):
        io.Decomposed(tmp_path / "regions")
    shutil.rmtree(tmp_path / "regions" / "constant")
    with pytest.raises(
        ValueError,
        match=r"It is decomposed, and has the regions fluid, solid: .*decomposed \S+fluid",
    ):
        io.read(tmp_path / "regions")
    case = io.Decomposed(fluid)
    surface = case.surface()
    np.testing.assert_array_equal(surface.points, plain.surface().points)
    before = foam.tree(tmp_path / "regions")
    with case.writing(tmp_path / "new") as writer:
        for k in range(len(case)):
            writer.add(k, case.read(k).moved(case.read(k).points * 2))
    after = foam.tree(tmp_path / "new")
    changed = [name for name in before if name in after and after[name] != before[name]]
    assert changed == [f"processor{k}/constant/fluid/polyMesh/points" for k in range(2)]
    np.testing.assert_array_equal(
        io.Decomposed(tmp_path / "new/constant/fluid").surface().points, surface.points * 2
    )


def test_the_surface_is_that_of_the_whole(divided):
    whole, case = io.read(divided), io.Decomposed(divided)
    surface = case.surface()
    ids = io.global_nodes(surface)
    np.testing.assert_array_equal(surface.points, whole.points[ids])
    for name in whole.patches:
        np.testing.assert_array_equal(ids[surface.patch(name)], whole.patch(name))
    named = jm.Boundary(surface, "floor", "roof", free="sides")
    named = named.with_faces(OuterFaces.numbered(surface.cells))
    expected = jm.Boundary(whole, "floor", "roof", free="sides")
    np.testing.assert_array_equal(ids[named.nodes], expected.nodes)
    assert named.is_open == expected.is_open
    assert str(named.left) == str(expected.left)
    of_whole, of_parts = expected.surface_faces or {}, named.surface_faces or {}
    assert of_whole
    for kind, corners in of_whole.items():
        there = {frozenset(row) for row in of_parts[kind].tolist()}
        assert {frozenset(row) for row in corners.tolist()} == there


def test_an_export_says_which_plans_it_replaces(divided, capsys):
    words = ["export", str(divided), "--moving", "floor", "--fixed", "roof", "--free", "sides"]
    first = printed(capsys, words)
    (divided / "processor1" / "constant" / "jaxmorph.plan").unlink()
    second = printed(capsys, words)
    plans = ["constant", "processor0/constant", "processor1/constant"]
    for said, replaced in ((first, []), (second, plans[:2])):
        wrote = [line for line in said.splitlines() if line.startswith("wrote ")]
        assert [line.split()[1] for line in wrote] == [
            str(divided / plan / "jaxmorph.plan") for plan in plans
        ]
        assert [line.endswith(", in place of an older file") for line in wrote] == [
            plan in replaced for plan in plans
        ]


def test_summaries_of_parts_add_up_to_the_whole(divided):
    """Cells, inverted cells, extremes, means by volume and cells beyond a gate; not skewness, which faces between parts have."""
    whole, case = io.read(divided), io.Decomposed(divided)
    points = whole.points + 0.4 * np.random.default_rng(3).normal(size=whole.points.shape)
    limits = jm.Limits(max_face_aspect_ratio=2.0)
    expected = jm.judge(whole, points, limits)
    parts = [case.read(k) for k in range(2)]
    moved = [points[io.global_nodes(part)] for part in parts]
    found = jm.Verdict.together([jm.judge(parts[k], moved[k], limits, part=k) for k in range(2)])
    assert (found.cells, found.inverted, found.spoilt) == (
        expected.cells,
        expected.inverted,
        expected.spoilt,
    )
    assert 0 < found.inverted < 12
    first = {0: 0, 1: 4}
    aspect = "face_aspect_ratio"
    for row in (("max", aspect), ("min", "pyramid"), ("min", "volume_ratio"), ("mean", aspect)):
        assert found.rows[row].value == pytest.approx(expected.rows[row].value, rel=1e-12)
        if row[0] != "mean":
            number = found.rows[row]
            assert first[number.part] + number.cell == expected.rows[row].cell
            np.testing.assert_allclose(number.near, expected.rows[row].near, rtol=1e-12)
    (gate,), (of_whole,) = found.gates, expected.gates
    assert (gate.beyond, gate.extreme.value) == (
        of_whole.beyond,
        pytest.approx(of_whole.extreme.value, rel=1e-12),
    )
    cells = [first[cell.part] + cell.cell for cell in gate.worst]
    assert cells == [cell.cell for cell in of_whole.worst]
    assert len(cells) == 5


def test_shared_points_are_written_with_equal_bits(divided, tmp_path):
    case = io.Decomposed(divided)
    rng = np.random.default_rng(1)
    with case.writing(tmp_path / "new") as writer:
        for k in range(len(case)):
            part = case.read(k)
            writer.add(k, part.moved(part.points + 1e-9 * rng.normal(size=part.points.shape)))
    places = {}
    for k in range(2):
        part = io.read(tmp_path / "new" / f"processor{k}")
        for node, place in zip(io.global_nodes(part).tolist(), part.points.tolist(), strict=True):
            assert places.setdefault(node, place) == place
    assert len(places) == 36
    assert not (tmp_path / "new" / "constant" / "polyMesh").exists()
    with pytest.raises(TimeoutError, match=r"^slow$"), case.writing(tmp_path / "none"):
        raise TimeoutError("slow")  # the caller's own
    assert not (tmp_path / "none").exists()


def test_a_writer_takes_each_part_by_its_number_and_once(divided, tmp_path):
    case = io.Decomposed(divided)
    parts = [case.read(0), case.read(1)]

    def written(*pairs):
        with case.writing(tmp_path / "new") as writer:
            for k, part in pairs:
                writer.add(k, part)

    away = parts[1].moved(parts[1].points + np.array([0.3, 0, 0]))
    for pairs, message in (
        ([(0, parts[0])], "1 of 2 parts were not added, first part 1"),
        ([(1, parts[0])], "is not part 1"),
        ([(0, parts[0]), (0, parts[0])], "written already"),
        ([(7, parts[0])], "parts have the numbers 0 to 1"),
        ([(0, parts[0]), (1, away)], r"shares with other parts are 0\.3 away"),
    ):
        with pytest.raises(ValueError, match=message):
            written(*pairs)
    assert not (tmp_path / "new").exists()


def test_what_a_decomposed_case_lacks(divided, tmp_path):
    for k, old, new, message in (
        (
            0,
            "type processor;",
            "type processor; myProcNo 0; neighbProcNo 2;",
            "faces to processor2, which is missing",
        ),
        (
            1,
            r"nFaces \d+",
            "nFaces 0",
            r"processor1: this part has no cells.* decompose into fewer parts",
        ),
    ):
        file = divided / f"processor{k}" / "constant" / "polyMesh" / "boundary"
        text = file.read_text()
        file.write_text(re.sub(old, new, text))
        with pytest.raises(ValueError, match=message):
            io.Decomposed(divided).surface()
        file.write_text(text)
    undivided = io.read(divided)
    shutil.rmtree(divided / "constant")
    all_refused(
        (lambda: io.global_nodes(jm.Mesh(np.zeros((3, 2)))), "was not read from an OpenFOAM case"),
        (lambda: io.global_nodes(undivided), "there is no pointProcAddressing"),
        (lambda: io.Decomposed(tmp_path), "not decomposed, there is no folder processor0"),
        (
            lambda: io.read(divided),
            r"It is decomposed: jaxmorph deform --decomposed .*, or take .*processor0",
        ),
    )
    (divided / "processor1" / "constant" / "polyMesh" / "pointProcAddressing").unlink()
    with pytest.raises(
        ValueError, match=r"there is no pointProcAddressing.* Run reconstructParMesh -constant"
    ):
        io.Decomposed(divided).surface()
    (divided / "processor1").rename(divided / "processor2")
    with pytest.raises(ValueError, match="no folder processor1 among 2"):
        io.Decomposed(divided)


HEAD = "FoamFile {{ version 2.0; format ascii; class dictionary; object {}; }}\n"
CORNERS = "(0 0 0)(2 0 0)(2 1.2 0)(0 1 0)(0 0 1)(2 0 1)(2 1.2 1)(0 1 1)"
PAIR = "front {type cyclic; neighbourPatch back; faces ((4 5 6 7));} back {type cyclic; neighbourPatch front; faces ((0 3 2 1));}"
PLANES = (
    "front {type symmetryPlane; faces ((4 5 6 7));} back {type symmetryPlane; faces ((0 3 2 1));}"
)
EMPTY = "front {type empty; faces ((4 5 6 7)(0 3 2 1));}"
ENDS = "floor {type wall; faces ((0 1 5 4));} roof {type wall; faces ((3 7 6 2));} sides {type patch; faces ((0 4 7 3)(2 6 5 1));}"
CASES = {
    "cyclic": (PAIR, (8, 6, 4), "2 1 2", 4, "ascii", []),
    "symmetry": (PLANES, (8, 6, 4), "1 2 1", 2, "binary", ["--symmetry", "front", "back"]),
    "empty": (EMPTY, (12, 6, 1), "2 2 1", 4, "ascii; writeCompression on", []),
}
"""Patches in front and behind, cells, how it is decomposed, in how many parts, how it is written, more flags."""


def made_by_openfoam(case, name):
    patches, shape, way, count, form, _ = CASES[name]
    foam.write_case(case, *cubes((1, 1, 1)), box(cubes((1, 1, 1))[0]))
    shutil.rmtree(case / "constant" / "polyMesh")
    cells = " ".join(map(str, shape))
    mesh = f"vertices ({CORNERS}); blocks (hex (0 1 2 3 4 5 6 7) ({cells}) simpleGrading (1 2 1)); edges ();"
    mesh += f" boundary ({ENDS} {patches});"
    (case / "system" / "blockMeshDict").write_text(HEAD.format("blockMeshDict") + mesh)
    way = f"numberOfSubdomains {count}; method simple; simpleCoeffs {{ n ({way}); delta 0.001; }}"
    (case / "system" / "decomposeParDict").write_text(HEAD.format("decomposeParDict") + way)
    with (case / "system" / "controlDict").open("a") as file:
        file.write(f"writeFormat {form}; writePrecision 17;\n")
    foam.run(case, "blockMesh")
    foam.run(case, "decomposePar")
    return count


def move(case, new, *flags, more=(), run=main):
    name = ["--moving", "floor", "--fixed", "roof", "--free", "sides", *more, *flags]
    return run(["deform", str(case), str(new), *name])


LIFT = ("--translate", "0.02", "-0.05", "0.1")


@pytest.mark.filterwarnings("ignore:.*the case is decomposed")
@pytest.mark.parametrize("flags", runs(slow=[""], nightly=["--steps 3", "--dtype float32"]))
def test_parts_move_as_their_union(divided, tmp_path, capsys, flags):
    assert move(divided, tmp_path / "whole", *LIFT, *flags.split()) == 0
    assert move(divided, tmp_path / "parts", *LIFT, *flags.split(), "--decomposed") == 0
    assert "in 2 parts" in capsys.readouterr().out
    expected = io.read(tmp_path / "whole").points
    for k in range(2):
        part = io.read(tmp_path / "parts" / f"processor{k}")
        atol = 1e-6 if "float32" in flags else 1e-12
        np.testing.assert_allclose(part.points, expected[io.global_nodes(part)], rtol=0, atol=atol)
        floor = part.patch("floor")
        base = np.asarray(io.read(divided / f"processor{k}").points)
        np.testing.assert_array_equal(part.points[floor], base[floor] + np.array(LIFT[1:], float))


@pytest.mark.filterwarnings("ignore:.*the case is decomposed")
@pytest.mark.parametrize(
    "name", runs(slow=["empty"], nightly=[name for name in CASES if name != "empty"])
)
def test_parts_move_as_the_whole_case(tmp_path, monkeypatch, capsys, name):
    foam.need_openfoam()
    case, whole, parts = (tmp_path / each for each in ("case", "whole", "parts"))
    count, more = made_by_openfoam(case, name), CASES[name][-1]
    shift = [*("--translate", "0.02", "-0.05"), *([] if name == "empty" else ["0"])]
    assert move(case, whole, *shift, more=more) == 0
    capsys.readouterr()
    assert move(case, parts, *shift, "--decomposed", more=more) == 0
    assert f"in {count} parts" in capsys.readouterr().out
    expected, seen = io.read(whole).source.content.points, {}
    for k in range(count):
        content = io.read(parts / f"processor{k}").source.content
        np.testing.assert_allclose(content.points, expected[content.point_ids], rtol=0, atol=1e-12)
        for node, place in zip(content.point_ids.tolist(), content.points.tolist(), strict=True):
            assert seen.setdefault(node, place) == place  # bit for bit
    assert len(seen) == len(expected)
    said = [foam.verdict(each, "-constant", processes=count) for each in (case, parts)]
    assert said[0] == said[1] == ["Mesh OK."]
    foam.run(parts, "reconstructParMesh", "-constant", "-fullMatch", "-mergeTol", "1e-9")
    again = io.read(parts).source.content.points
    assert len(again) == len(expected)
    assert KDTree(expected).query(again)[0].max() < 1e-12
    assert (
        foam.verdict(parts, "-constant")
        == foam.verdict(whole, "-constant")
        == foam.verdict(case, "-constant")
    )
    far = ["--translate", "0", "1.05", *([] if name == "empty" else ["0"])]
    counts = []
    for flags in ([], ["--decomposed"]):
        assert move(case, tmp_path / "bad", *far, *flags, "--no-dry-run", more=more) == 1
        said = capsys.readouterr().err
        assert "is not written" in said
        counts.append(re.findall(r"(\d+) of (\d+) cells are inverted", said))
    assert counts[0] == counts[1] != []
    assert re.search(r"the worst is processor\d cell \d+ near", said)
    assert not (tmp_path / "bad").exists()


@pytest.mark.slow
def test_processes_of_an_mpi_run_write_the_same_case(divided, tmp_path):
    assert move(divided, tmp_path / "one", *LIFT, "--decomposed") == 0

    def run(words):
        assert mpi_run(2, "jaxmorph", *words).count("quality of") == 1  # one speaks for all
        return 0

    assert move(divided, tmp_path / "two", *LIFT, "--decomposed", run=run) == 0
    one, two = (foam.tree(tmp_path / each) for each in ("one", "two"))
    assert one.keys() == two.keys()
    for k in range(2):
        first, second = (
            io.read(tmp_path / each / f"processor{k}").points for each in ("one", "two")
        )
        np.testing.assert_allclose(first, second, rtol=0, atol=1e-14)


def test_one_process_says_the_warnings_of_all(capsys):
    class Two(Alone):
        size = 2

        def gather(self, value):
            return [value, ["warning: here", "warning: there"]]

    out = Output("deform")
    out.warn("here")
    _say_warnings_of_all(out, Two())
    assert out.facts["warnings"] == ["warning: here", "warning: there"]
    assert capsys.readouterr().err.count("warning: ") == 2


class WithoutLibrary:
    """Stands for mpi4py where there is no MPI library."""

    @property
    def MPI(self):
        raise RuntimeError("cannot load MPI library")


@pytest.mark.parametrize("name", ["SLURM_STEP_NUM_TASKS", "OMPI_COMM_WORLD_SIZE"])
def test_processes_that_cannot_meet_do_not_write_one_case_twice(name, monkeypatch):
    """Two processes of srun without MPI, or of another MPI library than mpi4py's: each would take itself for the only one."""
    for each in STARTED:
        monkeypatch.delenv(each, raising=False)
    assert isinstance(_ranks(), Alone)
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    monkeypatch.setenv(name, "1")
    assert isinstance(_ranks(), Alone)
    monkeypatch.setenv(name, "2")
    for module in (None, WithoutLibrary()):
        monkeypatch.setitem(sys.modules, "mpi4py", module)
        with pytest.raises(
            ImportError, match="srun started this process, but mpi4py or its MPI library is missing"
        ):
            _ranks()
    one = types.SimpleNamespace(MPI=types.SimpleNamespace(COMM_WORLD=types.SimpleNamespace(size=1)))
    monkeypatch.setitem(sys.modules, "mpi4py", one)
    with pytest.raises(
        ValueError, match=r"2 processes were started, and mpi4py sees 1:.*srun --mpi="
    ):
        _ranks()
