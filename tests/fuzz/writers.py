"""Attacks every writer: kills it, fills its device, lets others write as well: `writers.py KILLS SEED [NAME ...]`.

One process imports the library and forks one for each attack, so that fifty kills take a second. A line of JSON tells each fault,
and a last one for each format how many kills fell inside the writing.
"""

import contextlib
import dataclasses
import functools
import gc
import json
import multiprocessing
import os
import pathlib
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from concurrent import futures

import jax
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))

import cgns
import foam
import meshio
from matplotlib.figure import Figure
from meshes import bricks
from mfem_meshes import straight
from plot3d import box
from plot3d import write as write_plot3d

import jaxmorph as jm
from jaxmorph import io, plot
from jaxmorph._host.package import files

NOBODY = 65534


@dataclasses.dataclass(frozen=True)
class Output:
    """What is written: the name of its file or folder, and the function that writes the state `k` to a path."""

    name: str
    write: Callable[[pathlib.Path, int], None]
    source: pathlib.Path | None = None
    """The file that the mesh was read from, where `io.write` would write to it."""
    is_folder: bool = False
    is_new: bool = False
    """Whether the folder must be a new one."""


def moved(mesh: jm.Mesh, k: int) -> jm.Mesh:
    return mesh.moved(np.asarray(mesh.points) * (1 + (k + 1) / 7))


def of_mesh(name: str, mesh: jm.Mesh, source: pathlib.Path | None = None, **more) -> Output:
    """A mesh, moved by `k`."""
    return Output(name, lambda path, k: io.write(path, moved(mesh, k)), source=source, **more)


def new(name: str) -> Callable[[pathlib.Path], Output]:
    return lambda folder: of_mesh(name, bricks(12))


def again(name: str, write: Callable[[pathlib.Path], None]) -> Callable[[pathlib.Path], Output]:
    """A mesh that was read from a file of the same format."""

    def output(folder: pathlib.Path) -> Output:
        source = folder / f"source-{name}"
        write(source)
        return of_mesh(name, io.read(source), source)

    return output


def of_rows(
    name: str, write: Callable[[pathlib.Path, np.ndarray], None]
) -> Callable[[pathlib.Path], Output]:
    """Something that is written from 2,197 rows of three numbers."""
    rows = np.asarray(bricks(12).points)
    return lambda folder: Output(name, lambda path, k: write(path, rows + k))


def plain(version: str, binary: bool) -> Callable[[pathlib.Path], None]:
    mesh = bricks(12)
    rows = meshio.Mesh(
        np.asarray(mesh.points), [("hexahedron", np.asarray(mesh.cells["hexahedron"]))]
    )
    return lambda path: meshio.gmsh.write(str(path), rows, fmt_version=version, binary=binary)


WALL = [("all", "wall", lambda face: True)]


def foam_case(form: str, name: str) -> Callable[[pathlib.Path], Output]:
    """A case of 10 x 10 x 10 hexahedra: into a new one, or into a time folder of it."""

    def output(folder: pathlib.Path) -> Output:
        mesh = bricks(10)
        cells = foam.hexahedra(mesh.cells["hexahedron"])
        foam.write_case(folder / "case", np.asarray(mesh.points), cells, WALL, foam.FORMS[form])
        return of_mesh(name, io.read(folder / "case"), is_folder=True, is_new=name == "new")

    return output


def parts(folder: pathlib.Path) -> Output:
    """A decomposed case."""
    mesh = bricks(4)
    cells = foam.hexahedra(mesh.cells["hexahedron"])
    foam.write_parts(folder / "case", np.asarray(mesh.points), cells, WALL, np.arange(64) // 32)
    decomposed = io.Decomposed(folder / "case")

    def write(path: pathlib.Path, k: int) -> None:
        with decomposed.writing(path) as writer:
            for part in range(len(decomposed)):
                writer.add(part, moved(decomposed.read(part), k))

    return Output("new", write, is_folder=True, is_new=True)


def plans(folder: pathlib.Path) -> Output:
    mesh = bricks(12)
    floor, method = mesh.patch("floor"), jm.InverseDistance()
    prepared = [
        jm.prepare(np.asarray(mesh.points) * (k + 1), floor, method=method) for k in range(4)
    ]
    return Output("a.npz", lambda path, k: jm.save(path, prepared[k]))


def collection(folder: pathlib.Path) -> Output:
    steps = np.arange(5000)
    names = [f"{k}.vtu" for k in steps]
    return Output("a.pvd", lambda path, k: io.write_pvd(path, names, (steps + k).tolist()))


def png(folder: pathlib.Path) -> Output:
    """A picture that is drawn already: what is attacked is the writing."""
    drawn = [np.random.default_rng(k).bytes(3_000_000) for k in range(4)]
    mesh = jm.Mesh([[0.0, 0], [1, 0], [0, 1]], {"triangle": [[0, 1, 2]]})

    def write(path: pathlib.Path, k: int) -> None:
        Figure.savefig = lambda self, file, **_: pathlib.Path(file).write_bytes(drawn[k])
        plot.picture(path, mesh, np.asarray(mesh.points), moving=np.arange(3))

    return Output("a.png", write)


TABLE = np.arange(13**3)
FORMATS: dict[str, Callable[[pathlib.Path], Output]] = {
    "SU2": new("a.su2"),
    "SU2 again": again("a.su2", lambda path: io.write(path, bricks(12))),
    "gmsh 2": new("a.msh"),
    "gmsh 2 text again": again("a.msh", plain("2.2", False)),
    "gmsh 4 text again": again("a.msh", plain("4.1", False)),
    "gmsh 4 binary again": again("a.msh", plain("4.1", True)),
    "VTU": new("a.vtu"),
    "VTK": new("a.vtk"),
    "CGNS": again("a.cgns", lambda path: cgns.write(path, bricks(24))),
    "MFEM": again("a.mesh", lambda path: path.write_text(straight(bricks(12), "floor"))),
    "PLOT3D": again(
        "a.xyz", lambda path: write_plot3d(path, [x + 0.123 for x in box(12, 13, 14)], "text", "<")
    ),
    "OpenFOAM": foam_case("ascii", "new"),
    "OpenFOAM, time": foam_case("ascii", "case/0.5"),
    "OpenFOAM, packed": foam_case("ascii-gz", "case/0.5"),
    "OpenFOAM, binary": foam_case("binary", "case/0.5"),
    "OpenFOAM, parts": parts,
    "plans": plans,
    "PVD": collection,
    "sensitivities": of_rows("s.csv", lambda path, rows: io.write_sensitivity(path, TABLE, rows)),
    "sensitivities, packed": of_rows(
        "s.npz", lambda path, rows: io.write_sensitivity(path, TABLE, rows)
    ),
    "gradient": of_rows(
        "g.csv", lambda path, rows: io.write_gradient(path, {"a": rows}, {"a": rows})
    ),
    "gradient, JSON": of_rows(
        "g.json", lambda path, rows: io.write_gradient(path, {"a": rows}, {"a": rows})
    ),
    "lattice": of_rows(
        "a.vts", lambda path, rows: io.write_lattice(path, rows.reshape(13, 13, 13, 3))
    ),
    "PNG": png,
}
"""How each format is written, by its name: with files that take some milliseconds."""


def tree(path: pathlib.Path) -> dict[str, bytes]:
    """Every file at or below a path with its content, and every folder."""
    if not path.is_dir():
        return {"": path.read_bytes()} if path.exists() else {}
    below = sorted(path.rglob("*"))
    return {
        str(each.relative_to(path)): b"folder" if each.is_dir() else each.read_bytes()
        for each in below
    }


def leftovers(folder: pathlib.Path) -> list[str]:
    return [str(each.relative_to(folder)) for each in folder.rglob("*") if ".partial" in each.name]


FORK = multiprocessing.get_context("fork")


def forked(work: Callable[[], object]) -> tuple[int | None, str, str]:
    """What some work in another process ends by: its exit code, the class and the words of its error; empty without one."""
    here, there = FORK.Pipe(duplex=False)

    def run() -> None:
        gc.disable()  # it would copy the pages that the two share
        kind, words = "", ""
        try:
            work()
        except BaseException as error:
            kind = next(
                each.__name__ for each in type(error).__mro__ if each.__module__ == "builtins"
            )
            kind, words = "OSError" if isinstance(error, OSError) else kind, str(error)
        there.send((kind, words))

    process = FORK.Process(target=run)
    process.start()
    there.close()
    try:
        kind, words = here.recv()
    except EOFError:
        kind, words = "died", ""
    process.join()
    return process.exitcode, kind, words


@contextlib.contextmanager
def hooked(hook: Callable[[pathlib.Path], object]) -> Iterator[None]:
    """Calls a function with each temporary file that is made."""
    make = files._make_partial

    def new(*arguments) -> pathlib.Path:
        made = make(*arguments)
        hook(made)
        return made

    files._make_partial = new
    try:
        yield
    finally:
        files._make_partial = make


def to_full_device(partial: pathlib.Path) -> None:
    partial.unlink()
    partial.symlink_to("/dev/full")


class Attack:
    """One format under attack in a folder of its own."""

    def __init__(self, name: str, output: Output, folder: pathlib.Path, seed: int):
        self.name, self.output, self.folder = name, output, folder
        self.target = folder / output.name
        self.rng = np.random.default_rng((seed, zlib.crc32(name.encode())))
        self.states: dict[int, dict[str, bytes]] = {}
        begun = []
        for k in (1, 0):
            with hooked(lambda _: begun.append(time.perf_counter())):
                self.good(k)
            self.duration = time.perf_counter() - begun[-1]
            self.states[k] = self.found()

    def expect(self, is_right: bool, how: str, what: str) -> None:
        if not is_right:
            print(json.dumps({"format": self.name, "attack": how, "fault": what[:500]}), flush=True)

    def good(self, k: int) -> None:
        if self.output.is_new:
            shutil.rmtree(self.target, ignore_errors=True)
        self.output.write(self.target, k)

    def found(self) -> dict[str, bytes]:
        """What stands at the target, but for temporary files."""
        return {
            name: content for name, content in tree(self.target).items() if ".partial" not in name
        }

    def old(self, k: int) -> dict[str, bytes]:
        """Brings the target into the state `k`; a new folder is none."""
        self.good(k)
        if self.output.is_new:
            shutil.rmtree(self.target)
        return {} if self.output.is_new else self.states[k]

    def kills(self, count: int) -> None:
        """Ends writers at random moments: the target stays whole, and the next good write leaves nothing more."""
        inside, tries, halves = 0, 0, 0
        while inside < count and tries < 20 * count:
            old, k, moment = (
                self.old(tries % 2),
                (tries + 1) % 2,
                self.rng.uniform(0, self.duration),
            )
            tries += 1

            def work(k: int = k, moment: float = moment) -> None:
                with hooked(
                    lambda _: signal.setitimer(signal.ITIMER_REAL, moment)
                ):  # its signal ends the process
                    self.output.write(self.target, k)

            inside += (forked(work)[0] or 0) < 0
            left = [self.folder / name for name in leftovers(self.folder)]
            halves += bool(left)
            for each in left:
                shutil.rmtree(each) if each.is_dir() else each.unlink(missing_ok=True)
            when = f"kill {tries} after {moment:.4f} of {self.duration:.4f} s"
            self.expect(
                self.found() in (old, self.states[k]), "kill", f"{when}: neither old nor new"
            )
            self.good(k)
            self.expect(
                not leftovers(self.folder), "kill", f"{when}: left {leftovers(self.folder)}"
            )
            self.expect(
                self.found() == self.states[k], "kill", f"{when}: the next write is not whole"
            )
        print(
            json.dumps({"format": self.name, "kills": inside, "halves": halves, "tries": tries}),
            flush=True,
        )

    def refused(
        self, how: str, work: Callable[[], object], *kinds: str, target: pathlib.Path | None = None
    ) -> None:
        """Expects an error that names the target, what was there before, and nothing else."""
        before = tree(self.folder)
        _, kind, words = forked(work)
        self.expect(kind in (kinds or ("OSError",)), how, f"{kind or 'no error'}: {words}")
        name = str(target or self.target)
        self.expect(name in words and ".partial" not in words, how, f"target not named: {words}")
        after = tree(self.folder)
        changed = sorted(
            name for name in {*before} | {*after} if before.get(name) != after.get(name)
        )
        self.expect(not changed, how, f"changed: {changed}")

    def full(self) -> None:
        """Files that may not grow beyond a limit, and a full device."""
        self.old(0)
        largest = max(len(content) for content in self.states[1].values())
        write = functools.partial(self.output.write, self.target, 1)
        for limit in (0, largest // 2, largest - 1):
            grow = functools.partial(resource.setrlimit, resource.RLIMIT_FSIZE, (limit, limit))
            self.refused(f"limit of {limit} bytes", lambda grow=grow: (grow(), write()))
        if not self.output.is_folder:
            with hooked(to_full_device):
                self.refused("full device", write)

    def forbidden(self) -> None:
        """A folder that this user may not write to."""
        self.old(0)
        inside = self.target if self.output.is_folder and not self.output.is_new else self.folder
        places = [
            inside,
            *(each for each in inside.rglob("*") if each.is_dir() and not self.output.is_new),
        ]
        for place in places:
            place.chmod(0o555)
        self.refused("read-only folder", self._as_nobody)
        for place in places:
            place.chmod(0o755)

    def _as_nobody(self) -> None:
        if os.geteuid() == 0:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        self.output.write(self.target, 1)

    def together(self) -> None:
        """Four processes write one target: it is that of one of them; new folders are refused to the others by name."""
        states = {}
        for k in range(4):
            self.good(k)
            states[k] = self.found()
        self.old(0)
        start = FORK.Barrier(4)

        def work(k: int) -> None:
            start.wait()
            for _ in range(1 if self.output.is_new else 3):
                self.output.write(self.target, k)

        with futures.ThreadPoolExecutor(4) as pool:
            ends = list(pool.map(lambda k: forked(lambda: work(k)), range(4)))
        told = [words for _, kind, words in ends if kind]
        are_named = all(str(self.target) in words and ".partial" not in words for words in told)
        is_right = (self.output.is_new and are_named and len(told) < 4) or not told
        self.expect(is_right, "four writers", f"{ends}")
        self.expect(self.found() in states.values(), "four writers", "the target is no writer's")
        self.expect(not leftovers(self.folder), "four writers", f"left {leftovers(self.folder)}")

    def read_from(self) -> None:
        """The file that the mesh was read from."""
        source = self.output.source
        if source is not None:
            work = lambda: self.output.write(source, 1)  # noqa: E731
            self.refused("output is input", work, "ValueError", target=source)


def main(count: int, seed: int, names: list[str]) -> None:
    warnings.simplefilter("ignore")
    jax.config.update("jax_enable_x64", True)
    time.time = lambda: 1e9  # archives hold the time
    with tempfile.TemporaryDirectory(prefix="jaxmorph-writers-") as top:
        pathlib.Path(top).chmod(0o755)  # for a user who may not write
        for name in names or FORMATS:
            folder = pathlib.Path(top, name)
            folder.mkdir()
            attack = Attack(name, FORMATS[name](folder), folder, seed)
            attack.kills(count)
            attack.full()
            attack.forbidden()
            attack.together()
            attack.read_from()
            shutil.rmtree(folder)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
