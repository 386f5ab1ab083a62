"""Decomposed cases, each part read and written by itself; plans for OpenFOAM's motion solver."""

import contextlib
import itertools
import pathlib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from jaxmorph import Layer, Mesh, Periodic, Plan, export
from jaxmorph._host.cells.topology import Pair
from jaxmorph._host.package.arguments import checked, shown
from jaxmorph._host.package.files import PathLike, complete, name_errors_by, output_path
from jaxmorph._host.package.ranks import Agreement, Alone, Ranks, together
from jaxmorph._host.rows import Rows, first_of_equals, join_ids
from jaxmorph._mesh.exchange import gathered

from .._format import Source, content_of
from .case import (
    NAME,
    check_new_folder,
    compute_file_points,
    copy_case,
    list_regions,
    read,
    write_points,
)
from .file import load_file, read_patches
from .plane import list_cyclic_pairs

PLAN = "jaxmorph.plan"
"""The file of a plan, which `native/openfoam` reads in `constant`."""
REMEDY = "Run decomposePar, or leave --decomposed away"

COLLATED = re.compile(r"s\d*(_\d+-\d+)?")
"""The end of the names of folders that hold several parts, after `processor`."""

AGREE = 1e-5
"""Distance between copies of a shared point, relative to coordinates: single precision."""


class Side(NamedTuple):
    """The outside of one part of a mesh: what the whole mesh's surface is gathered from.

    All ids are the whole mesh's.

    - `nodes` (k,), `points` (k, d): ids, ascending, and coordinates of the nodes on boundary faces.
    - `faces`: boundary faces (f, corners) by type, without those to other parts.
    - `patches`, `groups`, `kinds`: by name, the nodes of patches, groups of patches, types of
      patches.
    - `pairs`, `symmetry`: pairs of cyclic patches, and patches in symmetry planes.
    """

    nodes: ndarray
    points: ndarray
    faces: Mapping[str, ndarray]
    patches: Mapping[str, ndarray]
    groups: Mapping[str, tuple[str, ...]]
    pairs: tuple[tuple[str, str], ...]
    symmetry: tuple[str, ...]
    kinds: Mapping[str, str]


class Decomposed:
    """Reads and writes a decomposed OpenFOAM case part by part, in the memory of one part.

    ```python
    case = io.Decomposed("case")
    surface = case.surface()
    known = {"nodes": io.global_nodes(surface), "faces": surface.cells}
    half = jm.prepare_surface(jm.Boundary(surface, "wall", "inlet"), **known)
    with case.writing("moved") as writer:
        for k in range(len(case)):
            part = case.read(k)
            plan = half.attach(part.points, io.global_nodes(part))
            writer.add(k, part.moved(jm.deform(plan, u)))
    ```

    **Arguments:**

    - `path`: the folder of the case, which has folders `processor0` to `processorN`. Of a case of
      several regions `case/constant/REGION`.

    **Raises:** `ValueError` for missing folders, and for a case of several regions without the name
    of one.
    """

    @checked
    def __init__(self, path: PathLike):
        self.path, self.region = _find_region(pathlib.Path(path))
        if not self.path.is_dir():
            raise ValueError(f"{self.path}: no folder of an OpenFOAM case.")
        self.count = _count_parts(self.path)
        found = list_regions(self.path / "processor0" / "constant")
        is_there = (
            self.region in found
            if self.region
            else (self.path / "processor0/constant/polyMesh").is_dir()
        )
        if found and not is_there:
            first = self.path / "constant" / found[0]
            raise ValueError(f"{path}: name one of the regions {', '.join(found)}, as {first}.")
        self._last: tuple[int, Mesh] | None = None

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        return f"Decomposed({str(self.path)!r}, {self.count} parts)"

    def _mesh_folder(self, k: int) -> pathlib.Path:
        return self.folder(k) / "constant" / self.region / "polyMesh"

    def folder(self, k: int) -> pathlib.Path:
        """Returns the folder of part `k`. Raises `ValueError` for a part that is not there."""
        if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 0 <= k < self.count:
            raise ValueError(
                f"{self.path}: `k` is {k!r}; parts have the numbers 0 to {self.count - 1}."
            )
        return self.path / f"processor{k}"

    def read(self, k: int) -> Mesh:
        """Reads part `k` as `io.read` does; the last one is kept."""
        folder = self._mesh_folder(k).parent if self.region else self.folder(k)
        if self._last is None or self._last[0] != k:
            self._last = None  # before the next one is read
            self._last = k, Mesh(*read(folder))
        return self._last[1]

    def side(self, k: int) -> Side:
        boundary = read_patches(load_file(self._mesh_folder(k), "boundary"))
        if not sum(patch.size for patch in boundary):
            raise ValueError(
                f"{self.folder(k)}: this part has no cells; empty parts are not moved: decompose "
                "into fewer parts, or by scotch."
            )
        mesh = self.read(k)
        last = max(patch.part for patch in boundary)
        if last >= self.count:
            raise ValueError(
                f"{self.folder(k)}: it has faces to processor{last}, which is missing. {REMEDY}."
            )
        ids = global_nodes(mesh)
        outer = mesh.outer_faces
        corners = {} if outer is None else outer.corners
        rows = np.unique(join_ids((*corners.values(), *mesh.patches.values())))
        rows = rows[np.argsort(ids[rows])]
        return Side(
            nodes=ids[rows],
            points=np.asarray(mesh.points)[rows],
            faces={kind: ids[rows] for kind, rows in corners.items()},
            patches={name: ids[np.asarray(nodes)] for name, nodes in mesh.patches.items()},
            groups=mesh.source.groups,
            pairs=tuple((a.name, b.name) for a, b in list_cyclic_pairs(boundary)),
            symmetry=mesh.source.symmetry,
            kinds=mesh.kinds,
        )

    @checked
    def surface(self, sides: Sequence[Side] | None = None) -> Mesh:
        """Joins all parts' outsides: boundary faces of the mesh as cells, patches, their nodes.

        **Arguments:**

        - `sides`: what `side` gives of all parts. Default: they are read, one after the other.

        **Returns:** a `Mesh` for `prepare_surface(Boundary(surface, ...),
        nodes=io.global_nodes(surface), faces=surface.cells)`.

        **Raises:** `ValueError` where a node lies at different places in different parts.
        """
        sides = [self.side(k) for k in range(len(self))] if sides is None else sides
        if not sides or not all(isinstance(side, Side) for side in sides):
            raise ValueError(
                f"`sides` must be what `side(k)` gives of the {len(self)} parts, not "
                f"{shown(sides)}."
            )
        nodes, points = self._common_points(sides)
        faces = _join_sides(sides, "faces", nodes)
        members = _join_sides(sides, "patches", nodes)
        cells = {kind: corners for kind, corners in faces.items() if len(corners)}
        known = _join_facts(sides, members)
        return Mesh(
            points, cells, members, source=Source(self.path, NAME, None, node_ids=nodes, **known)
        )

    def _common_points(self, sides: Sequence[Side]) -> Pair:
        everywhere = np.concatenate([side.nodes for side in sides])
        places = np.concatenate([side.points for side in sides])
        first, back = first_of_equals(everywhere)
        points = places[first]
        distance = np.abs(places - points[back]).max(axis=1)
        wrong = np.flatnonzero(distance > 1e-9 * np.ptp(points, axis=0).max())
        if len(wrong):
            raise ValueError(
                f"{self.path}: {len(wrong)} points lie at different places in different "
                "processors, first point "
                f"{everywhere[wrong[0]]} of the whole mesh, by {distance[wrong[0]]:.3g}: they are "
                f"not parts of one mesh. {REMEDY}."
            )
        return everywhere[first], points

    @checked
    def check_output(self, path: PathLike) -> None:
        """Raises `ValueError` for a folder that `writing` cannot write, before any work."""
        check_new_folder(
            output_path(path, folder=True), self.path, "a new folder for the moved case"
        )

    @checked
    @contextlib.contextmanager
    def writing(self, path: PathLike, ranks: Ranks | None = None) -> Iterator["Writer"]:
        """Writes a new case part by part; it appears when complete, and not at all on failure.

        It has the `constant`, `system`, `0` and `0.orig` of the case and of each part, with other
        points, but not the undivided mesh in `constant/polyMesh`, whose points would be old.

        **Arguments:**

        - `path`: the new folder.
        - `ranks`: the communicator of processes that write together. Default: one process.
        """
        ranks = Alone() if ranks is None else ranks
        target = pathlib.Path(path)
        undivided = self.path / "constant" / self.region

        def begin() -> pathlib.Path | None:
            self.check_output(target)
            if ranks.rank:
                return None
            new = stack.enter_context(complete(target, folder=True, name_errors=False))
            with name_errors_by(target):
                copy_case(
                    self.path,
                    new,
                    ignore=lambda here, _: ["polyMesh"] * (pathlib.Path(here) == undivided),
                )
            return new

        def end() -> None:
            lacks = sorted({*range(len(self))}.difference(*written))
            if lacks:
                raise ValueError(
                    f"{path}: not written, {len(lacks)} of {len(self)} parts were not added, "
                    f"first part {lacks[0]}."
                )

        with contextlib.ExitStack() as stack:
            writer = Writer(
                self, target, ranks.bcast(together(ranks, begin)), ranks, Agreement(ranks), set()
            )
            yield writer
            written = ranks.allgather(writer.written)
            together(ranks, end)


def _join_sides(sides: Sequence[Side], name: str, nodes: ndarray) -> dict[str, ndarray]:
    """Joins the ids that all sides have by type or patch, and renumbers them by their place."""
    return Rows(nodes).renumbered(
        gathered(item for side in sides for item in getattr(side, name).items())
    )


def _join_facts(sides: Sequence[Side], members: Mapping[str, ndarray]) -> dict[str, Any]:
    """Lists what the sides know; parts have the same patches, of which some are empty."""
    pairs = [Periodic(*pair) for pair in sides[0].pairs if all(len(members[name]) for name in pair)]
    symmetry = dict.fromkeys(itertools.chain(*(side.symmetry for side in sides)))
    kinds = dict(itertools.chain(*(side.kinds.items() for side in sides)))
    return {
        "groups": sides[0].groups,
        "periodic": tuple(pairs),
        "symmetry": tuple(symmetry),
        "kinds": kinds,
    }


def _find_region(path: pathlib.Path) -> tuple[pathlib.Path, str]:
    """Finds the case and the region of `case/constant/REGION`; "" for the folder of a case."""
    return (path.parent.parent, path.name) if path.parent.name == "constant" else (path, "")


def _count_parts(path: pathlib.Path) -> int:
    names = {
        folder.name.removeprefix("processor")
        for folder in path.glob("processor*")
        if folder.is_dir()
    }
    collated = ", ".join(f"processor{name}" for name in sorted(names) if COLLATED.fullmatch(name))
    if collated:
        raise ValueError(
            f"{path}: folders {collated}; collated files are not read: run decomposePar "
            "-fileHandler uncollated."
        )
    numbers = {int(name) for name in names if name.isdecimal()}
    missing = sorted({*range(max(len(numbers), 1))} - numbers)
    if missing:
        lacks = f"there is no folder processor{missing[0]} among {len(numbers)}"
        raise ValueError(f"{path}: the case is not decomposed, {lacks}. {REMEDY}.")
    return len(numbers)


class Writer(NamedTuple):
    """Takes the moved parts of a decomposed case; `Decomposed.writing` makes it."""

    case: Decomposed
    path: pathlib.Path
    folder: pathlib.Path
    ranks: Ranks
    agreement: Agreement
    written: set[int]

    def add(self, k: int | None, moved: Mesh | None) -> None:
        """Writes part `k`, which is `moved`.

        A point that parts share gets the coordinates of the first one that has it. The processes of
        an MPI run call it together, as often as each other: with None where one has no part left.

        **Raises:** `ValueError` where cyclic patches no longer match, and for a mesh that is not
        part `k` or does not fit the other parts.
        """

        def shared() -> tuple[ndarray, ndarray, ndarray]:
            if moved is None:
                return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64)
            if k is None:
                raise ValueError("`k` is None; it is the number of the part that `moved` is.")
            content = content_of(moved, NAME)
            mesh = self.case._mesh_folder(k)
            if content is None or content.topology.resolve() != mesh.resolve():
                raise ValueError(
                    f"`moved` is not part {k} as `read({k})` gives it: write each part by its own "
                    "number."
                )
            if k in self.written:
                raise ValueError(f"part {k} was written already.")
            self.written.add(k)
            return content.shared, compute_file_points(moved), content.point_ids[content.shared]

        rows, points, ids = together(self.ranks, shared)
        points = np.array(points)
        agreed = self.agreement(ids, points[rows])

        def write() -> None:
            distance = np.abs(agreed - points[rows]).max(initial=0.0)
            if distance > AGREE * np.abs(points).max(initial=0.0):
                raise ValueError(
                    f"part {k}: points that it shares with other parts are {distance:.3g} away "
                    "from where these have them. "
                    "Move all parts by plans of one `prepare_surface`."
                )
            points[rows] = agreed
            if moved is not None:
                with name_errors_by(self.path):
                    write_points(self.folder / f"processor{k}", content_of(moved, NAME), points)

        together(self.ranks, write)


@checked
def global_nodes(mesh: Mesh) -> Int[ndarray, " n"]:
    """Returns the whole mesh's number of each node of an OpenFOAM part (`pointProcAddressing`).

    Nodes that parts share have one number. In 2-D it is that of the point in front.

    **Arguments:**

    - `mesh`: what `io.read("case/processor3")` or `io.Decomposed("case").surface()` returned.

    **Returns:** ids (n,) for `half.attach(mesh.points, ids)`.

    **Raises:** `ValueError` for other meshes, and a `pointProcAddressing` that is missing or does
    not fit.
    """
    if isinstance(mesh.source, Source) and mesh.source.node_ids is not None:
        return np.asarray(mesh.source.node_ids)  # the surface of a case
    content = content_of(mesh, NAME)
    if content is None:
        raise ValueError(
            "the mesh was not read from an OpenFOAM case; only a case's processors have global "
            "numbers."
        )
    return np.asarray(
        content.point_ids if content.plane is None else content.point_ids[content.plane.front]
    )


@checked
def export_case(path: PathLike, mesh: Mesh, plan: Plan) -> list[pathlib.Path]:
    """Writes `constant/jaxmorph.plan` for OpenFOAM's motion solver, and one in each `processor*`.

    ```python
    mesh = io.read("case")
    io.export_case("case", mesh, jm.prepare(mesh, "wing", ["inlet", "outlet"]))
    ```

    Nothing is known here of the motions to come: whether walls cross, `inspect` tells of each.

    **Arguments:**

    - `path`: the folder of the case; of a region `case/constant/REGION`.
    - `mesh`: what `io.read(path)` returned.
    - `plan`: what `prepare` made of it, as `jm.export` takes it.

    **Returns:** the files. **Raises:** `ValueError` as `jm.export` does, for a mesh of another
    source, for a case between wedges, and for parts of another mesh.
    """
    place = pathlib.Path(path)
    content = content_of(mesh, NAME)
    if not place.is_dir():
        raise ValueError(f"{path}: no folder of an OpenFOAM case.")
    if content is None:
        raise ValueError("`mesh` was not read from an OpenFOAM case: use jm.export(plan, path).")
    if content.plane is not None and content.plane.kind == "wedge":
        raise ValueError(
            f"{path}: a case between wedges; OpenFOAM moves both planes, and a plan moves one."
        )
    plan.check_mesh(mesh)
    root, region = _find_region(place)
    files = [root / "constant" / region / PLAN]
    with name_errors_by(files[0]):
        export(plan, files[0], layer=_make_layer(content))
    if not (root / "processor0").is_dir():
        return files
    case = Decomposed(path)
    for k in range(len(case)):
        part = case.read(k)
        ids = global_nodes(part)
        rows = ids if content.plane is None else content.plane.file_nodes()[ids]
        _check_part(case.folder(k), np.asarray(part.points), np.asarray(plan.points), rows)
        files.append(case.folder(k) / "constant" / region / PLAN)
        export(plan, files[-1], nodes=rows, layer=_make_layer(content_of(part, NAME)))
    return files


def _make_layer(content: Any) -> Layer | None:
    if content.plane is None:
        return None
    first, second = np.abs(content.plane.axes[0]).argmax(axis=1).tolist()
    return Layer(content.plane.file_nodes(), (first, second))


def _check_part(folder: pathlib.Path, part: ndarray, whole: ndarray, rows: ndarray) -> None:
    away = (
        np.abs(part - whole[rows]).max(axis=1)
        if rows.max(initial=-1) < len(whole)
        else np.full(len(part), np.inf)
    )
    wrong = away > 1e-9 * np.abs(whole).max()  # parts are written as text
    if wrong.any():
        raise ValueError(
            f"{folder}: {wrong.sum()} of {len(part)} points lie elsewhere than in the case, first "
            f"point {wrong.argmax()}: the "
            "parts are of another mesh. Run decomposePar -force."
        )
