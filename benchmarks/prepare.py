"""What `prepare` costs on a million nodes, and where: hexahedra of an O-grid, extruded, thin or even at the wall.

python benchmarks/prepare.py [--stations 100]
"""

import argparse
import cProfile
import functools
import pstats
import time
import warnings

import faults
import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm

PARTS = {
    "walls": ("walls.py", "walls"),
    "near_walls": ("neighbours.py", "near_walls"),
    "graph": ("graph.py", "graph_of"),
    "locate": ("graph.py", "locate"),
}


def extruded(stations: int, first_cell: float) -> jm.Mesh:
    """A swept and tapered wing between two planes: 296 cells around it, 33 from it to the far field."""
    section = faults.sharp_o_grid(around=296, layers=33, first_cell=first_cell)
    eta, n = np.linspace(0, 1, stations)[:, None], len(section.points)
    x, z = ((1 - 0.3 * eta) * section.points[:, k] for k in (0, 1))
    points = np.stack([x + 0.5 * eta, np.broadcast_to(4 * eta, x.shape), z], axis=-1).reshape(-1, 3)
    rows = n * np.arange(stations)[:, None]
    cells = section.cells["quad"] + rows[:-1, :, None]
    corners = np.concatenate([cells + n, cells], axis=-1).reshape(-1, 8)
    patches = {name: (rows + nodes).ravel() for name, nodes in section.patches.items()}
    return jm.Mesh(points, {"hexahedron": corners}, patches)


def timed(call) -> tuple[float, dict[str, float]]:
    """CPU seconds of a call and of its parts. The profiler counts wall time of one thread."""
    profile = cProfile.Profile(time.process_time)
    began = time.process_time()
    profile.runcall(call)
    whole = time.process_time() - began
    stats: dict = pstats.Stats(profile).stats  # pyright: ignore[reportAttributeAccessIssue]
    spent = dict.fromkeys(PARTS, 0.0)
    for (file, _, function), (*_, cumulative, _) in stats.items():
        for name, (end, wanted) in PARTS.items():
            if function == wanted and file.endswith(end):
                spent[name] = max(spent[name], cumulative)
    return whole, spent


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")  # the planes at both ends are free on purpose
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stations", type=int, default=100)
    stations = parser.parse_args().stations
    rows = []
    for first_cell in (1e-5, 0.02):
        mesh = extruded(stations, first_cell)
        moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
        about(points=len(mesh.points), surface=len(moving) + len(fixed), first_cell=first_cell)
        calls = {
            "a mesh": functools.partial(jm.prepare, mesh, "airfoil", "farfield"),
            "points and ids": functools.partial(jm.prepare, mesh.points, moving, fixed),
        }
        for how, call in calls.items():
            whole, spent = timed(call)
            rows.append(
                [
                    f"{first_cell:g}",
                    how,
                    f"{whole:.1f}",
                    *(f"{value:.1f}" for value in spent.values()),
                ]
            )
    table(rows, ("first cell", "called with", "prepare, CPU s", *PARTS))
