"""Meshes of SU2 and CGNS files by ranges: their cells, and all else but the surface, are never in memory together."""

import os
import pathlib
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph import Mesh
from jaxmorph._host.cells.pairs import is_among
from jaxmorph._host.cells.topology import CORNERS, boundary_faces, repeated_cells, solid
from jaxmorph._host.package.arguments import checked, whole
from jaxmorph._host.package.files import complete, input_path
from jaxmorph._host.surface.walls import seen_from_outside

from ._format import Source
from ._registry import checked_target
from ._su2 import Layout


class Ranges:
    """Reads and writes an SU2 or CGNS file by ranges of nodes and of cells: memory is that of the surface and of one range.

    Coordinates, before and after, stand in two temporary files without names: they are gone when the object is.

    ```python
    mesh = io.Ranges("wing.su2", 1_000_000)
    surface = mesh.surface()
    half = jm.prepare_surface(surface, "wall", "far", nodes=io.global_nodes(surface), faces=surface.cells)
    for k in range(len(mesh)):
        ids = np.where(np.isin(mesh.nodes(k), half.surface_nodes), mesh.nodes(k), -1)
        mesh.put(k, np.asarray(jm.deform(half.attach(mesh.read(k), ids), u)))
    mesh.write("moved.su2")
    ```

    **Arguments:**

    - `path`: the file, .su2, or .cgns without polyhedra.
    - `rows`: nodes, and cells, of a range. Default: 1,000,000.
    - `folder`: an existing folder for the temporary files, with room for twice the coordinates. Default: the system's.

    **Raises:** `ValueError` for what `read` refuses in points and markers, and for other files.
    """

    @checked
    def __init__(
        self, path: str | os.PathLike[str], rows: int = 1_000_000, folder: str | os.PathLike[str] | None = None
    ):
        self.path, self.rows = input_path(path), whole("rows", rows)
        if folder is not None and not pathlib.Path(folder).is_dir():
            raise ValueError(f"{folder}: there is no such folder for temporary files.")
        self._layout = _layout(self.path)
        with tempfile.TemporaryFile(dir=folder) as before, tempfile.TemporaryFile(dir=folder) as after:
            for block in self._layout.points():
                before.write(block.tobytes())
                after.write(block.tobytes())
            self.before, self.after = (_mapped(file, self._layout.d) for file in (before, after))
        self.patches = {name: np.unique(each) for name, each in self._layout.markers(len(self.before)).items()}
        self._faces: dict[str, np.ndarray] | None = None

    def __len__(self) -> int:
        return -(-len(self.before) // self.rows)

    def __repr__(self) -> str:
        return f"Ranges({str(self.path)!r}, {len(self)} ranges of {self.rows} nodes)"

    def nodes(self, k: int) -> np.ndarray:
        """Returns the ids (m,) of the nodes of range `k`. Raises `ValueError` for a range that is not there."""
        if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 0 <= k < len(self):
            raise ValueError(f"{self.path}: `k` is {k!r}; ranges have the numbers 0 to {len(self) - 1}.")
        return np.arange(k * self.rows, min((k + 1) * self.rows, len(self.before)))

    def read(self, k: int) -> np.ndarray:
        """Returns the undeformed points (m, d) of range `k`."""
        nodes = self.nodes(k)
        return np.array(self.before[nodes[0] : nodes[-1] + 1])

    @checked
    def put(self, k: int, points: Float[np.ndarray, "m d"]) -> None:
        """Keeps the moved points (m, d) of range `k`. Raises `ValueError` for another shape, and for points that are not finite."""
        nodes = self.nodes(k)
        if points.shape != (len(nodes), self.before.shape[1]) or not np.isfinite(points).all():
            raise ValueError(
                f"{self.path}: `points` of range {k} must be finite, of shape {(len(nodes), self.before.shape[1])}, "
                f"found shape {points.shape}."
            )
        self.after[nodes[0] : nodes[-1] + 1] = points

    @checked
    def surface(self) -> Mesh:
        """Reads the boundary: its faces as cells, its patches, and the outermost points of the mesh.

        **Returns:** a `Mesh` for `prepare_surface(..., nodes=io.global_nodes(surface), faces=surface.cells)`.
        """
        faces = self._boundary()
        outermost = [self.before.argmin(axis=0), self.before.argmax(axis=0)]
        nodes = np.unique(
            np.concatenate([*self.patches.values(), *(each.ravel() for each in faces.values()), *outermost])
        )
        cells = {kind: np.searchsorted(nodes, each) for kind, each in faces.items()}
        patches = {name: np.searchsorted(nodes, each) for name, each in self.patches.items()}
        known = {name: getattr(self._layout, name) for name in ("periodic", "symmetry", "kinds")}
        source = Source(self.path, self._layout.name, None, node_ids=nodes, **known)
        return Mesh(self.before[nodes], cells, patches, source=source)

    def cells(self) -> Iterator[tuple[Mesh, np.ndarray]]:
        """Yields ranges of cells: the undeformed mesh of each, with faces to others in `between`, and its moved points (m, d).

        Its points are filled up with copies of the last one, so that ranges have few sizes, and share compiled code.
        """
        for cells in self._tables(self.rows):
            corners = np.concatenate([each.ravel() for each in cells.values()])
            nodes = np.unique(corners)
            step = max(self.rows // 8, 1)
            rows = np.append(nodes, np.full(-len(nodes) % step, nodes[-1]))
            local = {kind: np.searchsorted(nodes, each) for kind, each in cells.items()}
            source = Source(self.path, self._layout.name, None, between=self._between(local, nodes), node_ids=rows)
            for each in local.values():
                if len(twice := repeated_cells(each)):
                    raise ValueError(
                        f"{self.path}: {len(twice)} cells have the nodes of another one, first cell between nodes "
                        f"{nodes[each[twice[0]]].tolist()}: remove the copies."
                    )
            yield Mesh(self.before[rows], local, source=source), np.array(self.after[rows])

    @checked
    def check_output(self, path: str | os.PathLike[str]) -> None:
        """Raises `ValueError` for a file that `write` cannot write, before any work."""
        checked_target(path, Source(self.path, self._layout.name, None))
        if pathlib.Path(path).suffix.lower() != self.path.suffix.lower():
            raise ValueError(
                f"{path}: by ranges a file is written in its own format: end the name in {self.path.suffix}."
            )

    @checked
    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the file with the moved points, all else byte for byte; it appears when it is complete."""
        self.check_output(path)
        with complete(pathlib.Path(path)) as partial:
            self._layout.write(partial, self.before, self.after)

    def _tables(self, rows: int) -> Iterator[dict[str, np.ndarray]]:
        """Yields `rows` cells at a time, the last ones fewer: corners by type in alphabetical order."""
        kept: dict[str, np.ndarray] = {}
        for block in self._layout.cells(len(self.before)):
            for kind, corners in solid(block, self.before.shape[1]).items():
                kept[kind] = np.concatenate([kept.get(kind, np.zeros((0, CORNERS[kind]), corners.dtype)), corners])
            while sum(map(len, kept.values())) >= rows:
                yield _taken(kept, rows)
        if any(map(len, kept.values())):
            yield _taken(kept, rows)

    def _boundary(self) -> dict[str, np.ndarray]:
        """Finds the boundary faces, seen from outside."""
        if self._faces is None:
            faces = self._layout.outer(len(self.before), self.patches)
            nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.ravel() for each in faces.values())]))
            local = {kind: np.searchsorted(nodes, each) for kind, each in faces.items()}
            self._faces = {kind: nodes[each] for kind, each in seen_from_outside(self.before[nodes], local).items()}
        return self._faces

    def _between(self, cells: dict[str, np.ndarray], nodes: np.ndarray) -> np.ndarray:
        """Finds the faces (k, corners) of some cells that are not the mesh's boundary, -1 behind the last corner."""
        outer = boundary_faces(cells, len(nodes))
        outside = {len(each[0]): each for each in self._boundary().values()}
        width, parts = max(each.shape[1] for each in outer.values()), []
        for each in outer.values():
            inner = each[~is_among(nodes[each], outside[each.shape[1]])] if each.shape[1] in outside else each
            parts.append(np.pad(inner, ((0, 0), (0, width - each.shape[1])), constant_values=-1))
        return np.concatenate(parts)


def _layout(path: pathlib.Path) -> Any:
    """Opens a file to be read some rows at a time."""
    suffix = path.suffix.lower()
    if suffix == ".su2":
        return Layout.by_ranges(path)
    if suffix == ".cgns":
        from .cgns.layout import Layout as CGNSLayout  # h5py may not be there

        return CGNSLayout(path)
    raise ValueError(f"{path}: SU2 and CGNS files (.su2, .cgns) are read by ranges; take --chunk for other formats.")


def _taken(kept: dict[str, np.ndarray], rows: int) -> dict[str, np.ndarray]:
    """Takes up to `rows` cells out of `kept`, one type after the other."""
    taken = {}
    for kind in sorted(kept):
        taken[kind], kept[kind] = kept[kind][:rows], kept[kind][rows:]
        rows -= len(taken[kind])
    return {kind: each for kind, each in taken.items() if len(each)}


def _mapped(file, d: int) -> np.ndarray:
    file.flush()
    return np.memmap(file, np.float64, "r+").reshape(-1, d)
