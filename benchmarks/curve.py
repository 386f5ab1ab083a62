"""Curving straight meshes of order 3: `jm.curve` against gmsh's optimisers, on the same meshes with the same wall nodes.

python benchmarks/curve.py [airfoil] [wing] [sphere] [--coarse]

Each row: invalid cells by gmsh's own Bernstein bounds (minDetJac), its smallest scaled Jacobian (minSICN), and CPU seconds.
Rows of jaxmorph also say how many cells `jm.proof` proves valid. `--coarse` takes smaller meshes, on which gmsh ends.
"""

import sys
import tempfile
import time
from pathlib import Path

import gmsh
import jax
import numpy as np
from _measure import about
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import io

ORDER = 3
FIRST = 1e-4
"""Height of the first cell at the wall, in chords."""

COARSE = "--coarse" in sys.argv
ALONG, AROUND, RATIO, LAYERS = (6, 4, 4.0, 1) if COARSE else (21, 9, 1.5, 2)
"""Nodes along a side of the airfoil and of the circle, growth of the airfoil's layers, layers of the wing."""


def naca(count: int = 60) -> np.ndarray:
    """Points round NACA 0012 from the trailing edge over the upper side, closed and sharp."""
    x = 0.5 * (1 + np.cos(np.linspace(0, np.pi, count)))
    y = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    return np.concatenate([np.column_stack([x, y]), np.column_stack([x, -y])[-2:0:-1]])


def airfoil() -> int:
    """NACA 0012 in a circle of 10 chords, quads at the wall from a height of 1e-4 chords on."""
    geo = gmsh.model.geo
    places = naca()
    points = [geo.addPoint(x, y, 0) for x, y in places]
    nose = len(places) // 2
    lines = [geo.addSpline(points[: nose + 1]), geo.addSpline([*points[nose:], points[0]])]
    centre = geo.addPoint(0.5, 0, 0)
    ends = [geo.addPoint(0.5 + sign * 10, 0, 0) for sign in (1, -1)]
    circle = [
        geo.addCircleArc(ends[0], centre, ends[1]),
        geo.addCircleArc(ends[1], centre, ends[0]),
    ]
    face = geo.addPlaneSurface([geo.addCurveLoop(circle), geo.addCurveLoop(lines)])
    geo.synchronize()
    for line in lines:
        gmsh.model.mesh.setTransfiniteCurve(line, ALONG, "Bump", 0.2)
    for arc in circle:
        gmsh.model.mesh.setTransfiniteCurve(arc, AROUND)
    field = gmsh.model.mesh.field.add("BoundaryLayer")
    gmsh.model.mesh.field.setNumbers(field, "CurvesList", lines)
    gmsh.model.mesh.field.setNumbers(field, "FanPointsList", [points[0]])
    for name, value in {"Size": FIRST, "Ratio": RATIO, "Thickness": 0.04, "Quads": 1}.items():
        gmsh.model.mesh.field.setNumber(field, name, value)
    gmsh.model.mesh.field.setAsBoundaryLayer(field)
    gmsh.model.addPhysicalGroup(1, lines, name="wall")
    gmsh.model.addPhysicalGroup(1, circle, name="far")
    gmsh.model.addPhysicalGroup(2, [face], name="fluid")
    return 2


def sphere() -> int:
    """A sphere in a box, tetrahedra; a corner of both with `--coarse`. With eight round it a cell has two faces on the sphere."""
    occ = gmsh.model.occ
    box = (0, 0, 0, 2, 2, 2) if COARSE else (-3, -3, -3, 6, 6, 6)
    volume, _ = occ.cut([(3, occ.addBox(*box))], [(3, occ.addSphere(0, 0, 0, 1))])
    occ.synchronize()
    sides = [tag for _, tag in gmsh.model.getBoundary(volume, oriented=False)]
    wall = [tag for tag in sides if gmsh.model.getType(2, tag) == "Sphere"]
    ends = [
        tag
        for tag in sides
        if COARSE and min(map(abs, gmsh.model.occ.getCenterOfMass(2, tag))) < 1e-9
    ]
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6 if COARSE else 2)
    if not COARSE:
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
    gmsh.model.addPhysicalGroup(3, [volume[0][1]], name="fluid")
    gmsh.model.addPhysicalGroup(2, wall, name="wall")
    if ends:
        gmsh.model.addPhysicalGroup(2, ends, name="ends")
    gmsh.model.addPhysicalGroup(2, [tag for tag in sides if tag not in (*wall, *ends)], name="far")
    return 3


def judged(dimension: int) -> tuple[int, float]:
    """Counts the invalid cells of gmsh's mesh by its bounds, and finds its smallest scaled Jacobian."""
    tags = np.concatenate(gmsh.model.mesh.getElements(dimension)[1])
    bounds = gmsh.model.mesh.getElementQualities(tags, "minDetJac")
    return int((bounds <= 0).sum()), float(
        gmsh.model.mesh.getElementQualities(tags, "minSICN").min()
    )


def row(name: str, dimension: int, seconds: float, proven: str = "") -> None:
    invalid, worst = judged(dimension)
    print(f"| {name} | {invalid} | {worst:.3f} | {seconds:.1f} | {proven} |", flush=True)


def meshes(case, folder: Path) -> tuple[jm.Mesh, jm.Mesh]:
    """Lets gmsh make a mesh of order 3 twice: straight, and with the nodes of its boundary on the geometry."""
    dimension = case()
    gmsh.model.mesh.generate(dimension)
    made = []
    for name, straight in (("straight", 1), ("curved", 0)):
        gmsh.option.setNumber("Mesh.SecondOrderLinear", straight)
        gmsh.model.mesh.setOrder(1)
        gmsh.model.mesh.setOrder(ORDER)
        gmsh.write(str(folder / f"{name}.msh"))
        made.append(io.read(folder / f"{name}.msh"))
    return made[0], made[1]


def wing(folder: Path) -> tuple[jm.Mesh, np.ndarray]:
    """The airfoil's mesh extruded over half a chord: hexahedra and wedges; and places of the wall's nodes."""
    straight, curved = meshes(airfoil, folder)
    n, layers = len(straight.points), LAYERS + 1
    solid, sections = {}, np.arange(layers - 1)[:, None, None] * n
    for kind, ids in straight.cells.items():
        corners = ids[:, : {"triangle10": 3, "quad16": 4}[kind]]
        both = np.concatenate([corners, corners + n], axis=1)
        solid["wedge" if kind == "triangle10" else "hexahedron"] = (both + sections).reshape(
            -1, both.shape[1]
        )
    points = np.concatenate(
        [np.column_stack([straight.points, np.full(n, 0.5 * k / LAYERS)]) for k in range(layers)]
    )
    names = {
        name: np.concatenate([nodes + k * n for k in range(layers)])
        for name, nodes in straight.patches.items()
    }
    used = np.unique(np.concatenate([ids.ravel() for ids in solid.values()]))
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    patches = {name: place[nodes][place[nodes] >= 0] for name, nodes in names.items()}
    mesh = jm.elevate(
        jm.Mesh(points[used], {kind: place[ids] for kind, ids in solid.items()}, patches), ORDER
    )
    ends = np.flatnonzero(np.isin(mesh.points[:, 2], (0, 0.5)))
    mesh = jm.Mesh(mesh.points, mesh.cells, dict(mesh.patches) | {"ends": ends})
    wall, section = mesh.points[mesh.patch("wall")], straight.patch("wall")
    nearest = KDTree(straight.points[section]).query(wall[:, :2])[1]
    return mesh, np.column_stack([curved.points[section][nearest], wall[:, 2]])


def compare(case) -> None:
    gmsh.clear()
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if case is wing:
            start, places = wing(folder)
        else:
            start, curved = meshes(case, folder)
            places = curved.points[start.patch("wall")]
        nodes, dimension = start.patch("wall"), start.points.shape[1]
        cells = sum(map(len, start.cells.values()))
        print(
            f"\n{case.__name__}: {cells} cells, {len(start.points)} nodes\n\n| | invalid | smallest | s | proven |\n|-|-|-|-|-|",
            flush=True,
        )
        moved = np.array(start.points)
        moved[nodes] = places
        written = {
            name: start.patches[name] for name in ("wall", "far")
        }  # sliding ends have no faces of their own
        io.write(folder / "wall.msh", jm.Mesh(moved, start.cells, written))
        gmsh.open(str(folder / "wall.msh"))
        row("the wall's nodes alone", dimension, 0)
        symmetry = ("ends",) if "ends" in start.patches else ()
        for name, method in {
            "jm.curve": None,
            "jm.curve, LinearElasticity()": jm.LinearElasticity(),
        }.items():
            begin = time.process_time()
            result = jm.curve(start, places, nodes, "far", method=method, symmetry=symmetry)
            seconds = time.process_time() - begin
            io.write(folder / "moved.msh", jm.Mesh(result.points, start.cells, written))
            gmsh.open(str(folder / "moved.msh"))
            report = jm.proof(result)
            row(name, dimension, seconds, f"{report.valid} of {report.count}")
        for name in ("HighOrderElastic", "HighOrder"):
            gmsh.open(str(folder / "wall.msh"))
            begin = time.process_time()
            try:
                gmsh.model.mesh.optimize(name)
                row(f"gmsh {name}", dimension, time.process_time() - begin)
            except Exception as error:  # gmsh has no other kind
                print(f"| gmsh {name}: {str(error)[:60]} | | | | |")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    about()
    gmsh.initialize(interruptible=False)
    for case in (airfoil, wing, sphere):
        if not set(sys.argv[1:]) - {"--coarse"} or case.__name__ in sys.argv[1:]:
            compare(case)
