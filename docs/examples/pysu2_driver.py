"""Moves a mesh in the memory of SU2's driver, pysu2, and takes its sensitivities to the wall.

`mesh_of(driver)` and the lines below it take a driver of pysu2. The `Driver` here stands in for it, in 2-D: it has the calls
of `CDriverBase.hpp` of SU2 8.3 that a mover needs.

- `Coordinates()`: a view of the coordinates of all nodes, with `Shape()`, `Get(row)` and `Set(row, values)`
- `GetMarkerIndices()`, `GetNumberMarkerNodes(k)`, `GetMarkerNode(k, row)`: the nodes of a marker
- `GetNumberElements()`, `GetElementNodes(element)`: the cells
- `Sensitivity(GetSolverIndices()["ADJ.FLOW"])`: dJ/d(coordinates) of the discrete adjoint;
  `ObjectiveCoordinatesSensitivities()` is the partial derivative of `KIND_DISC_ADJ= RESIDUALS` alone, and the total its sum with
  `ResidualsCoordinatesSensitivities()` (SU2's pull request 1750)

Nodes are numbered as in the driver, which is not the order of the mesh file: take nodes and cells from the driver.
"""

import jax
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, shapes

jax.config.update("jax_enable_x64", True)
given = cases.naca0015(points=800)


class View:
    def __init__(self, values):
        self.values = values

    def Shape(self):
        return self.values.shape

    def Get(self, row):
        return self.values[row].tolist()

    def Set(self, row, values):
        self.values[row] = values


class Driver:
    """Stands in for pysu2's driver; its objective is the sum of the squares of all coordinates."""

    points = np.array(given.points)
    markers = tuple(given.patches)

    def Coordinates(self):
        return View(self.points)

    def GetMarkerIndices(self):
        return {name: k for k, name in enumerate(self.markers)}

    def GetNumberMarkerNodes(self, k):
        return len(given.patch(self.markers[k]))

    def GetMarkerNode(self, k, row):
        return int(given.patch(self.markers[k])[row])

    def GetNumberElements(self):
        return len(given.cells["quad"])

    def GetElementNodes(self, element):
        return given.cells["quad"][element].tolist()

    def GetSolverIndices(self):
        return {"ADJ.FLOW": 1}

    def Sensitivity(self, solver):
        return View(2 * self.points)


KINDS = {
    (2, 3): "triangle",
    (2, 4): "quad",
    (3, 4): "tetra",
    (3, 5): "pyramid",
    (3, 6): "wedge",
    (3, 8): "hexahedron",
}


def array(view):
    return np.array([view.Get(row) for row in range(view.Shape()[0])])


def mesh_of(driver):
    points = array(driver.Coordinates())
    cells = {}
    for element in range(driver.GetNumberElements()):
        nodes = driver.GetElementNodes(element)
        cells.setdefault(KINDS[points.shape[1], len(nodes)], []).append(nodes)
    patches = {
        name: np.array(
            [driver.GetMarkerNode(k, row) for row in range(driver.GetNumberMarkerNodes(k))]
        )
        for name, k in driver.GetMarkerIndices().items()
    }
    return jm.Mesh(points, {kind: np.array(nodes) for kind, nodes in cells.items()}, patches)


driver = Driver()
mesh = mesh_of(driver)
plan = jm.prepare(mesh, "airfoil", "farfield")  # once
wall = mesh.points[plan.moving]
u = shapes.rotate(wall, np.deg2rad(-5), about=(0.25, 0)) - wall

coordinates = driver.Coordinates()
for row, place in enumerate(np.asarray(jm.deform(plan, u))):  # each motion
    coordinates.Set(row, place.tolist())
dJ_dpoints = array(driver.Sensitivity(driver.GetSolverIndices()["ADJ.FLOW"]))
dJ_dwall = jm.pullback(plan, u, dJ_dpoints)
print(jm.quality(mesh, array(coordinates)).inverted, dJ_dwall.shape)
