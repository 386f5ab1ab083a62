"""Models of OpenCASCADE, and meshes of their walls."""

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakePrism, BRepPrimAPI_MakeSphere
from OCP.collections import Array1_gp_Pnt
from OCP.Geom import Geom_BezierCurve
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_EDGE
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS

import jaxmorph as jm


def sphere(x):
    return BRepPrimAPI_MakeSphere(float(x[0])).Shape()


def box(x):
    return BRepPrimAPI_MakeBox(*map(float, x)).Shape()


def filleted(x):
    """A box of length x[0], of which one edge has the radius x[1]; 0 leaves it sharp."""
    body = box([x[0], 1.5, 1.0])
    if x[1] == 0:
        return body
    fillet = BRepFilletAPI_MakeFillet(body)
    fillet.Add(float(x[1]), TopoDS.Edge(TopExp_Explorer(body, TopAbs_EDGE).Current()))
    return fillet.Shape()


def curtain(x):
    """A Bezier curve over the points (0, 0), (1, x[0]), (2, x[1]), (3, 0), extruded by 1."""
    poles = Array1_gp_Pnt(1, 4)
    for k, height in enumerate([0.0, float(x[0]), float(x[1]), 0.0]):
        poles.SetValue(k + 1, gp_Pnt(float(k), height, 0.0))
    edge = BRepBuilderAPI_MakeEdge(Geom_BezierCurve(poles)).Edge()
    return BRepPrimAPI_MakePrism(edge, gp_Vec(0.0, 0.0, 1.0)).Shape()


def walled(points, faces):
    """A mesh of faces, triangles or quads, that are the patch `wall`."""
    kind = {3: "triangle", 4: "quad"}[np.shape(faces)[1]]
    return jm.Mesh(points, {kind: np.asarray(faces)}, {"wall": np.arange(len(points))})


def refined(points, triangles):
    """Cuts each triangle into four, at the middles of its edges."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ends, number = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    ab, bc, ca = len(points) + number.ravel().reshape(3, -1)
    a, b, c = triangles.T
    rows = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([points, points[ends].mean(axis=1)]), np.concatenate(
        [np.stack(row, axis=1) for row in rows]
    )


def meshed(model, times):
    """The facets of a model, cut `times` over, with nodes on its surfaces and edges."""
    facets = model.facets
    points, number = np.unique(facets.points.round(12), axis=0, return_inverse=True)
    triangles = number.ravel()[facets.triangles]
    triangles = triangles[np.diff(np.sort(triangles, axis=1), axis=1).all(axis=1)]
    for _ in range(times):
        points, triangles = refined(points, triangles)
    rim = np.array([model.onto_edges(*model.nearest_edges(points)[:2], points)[1]])[0]
    size = np.linalg.norm(np.ptp(points, axis=0))
    near = np.linalg.norm(rim - points, axis=1) < 1e-3 * size
    points = np.where(near[:, None], rim, model.closest(points).places)
    return walled(points, triangles)
