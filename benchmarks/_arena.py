"""The meshes, motions and methods of championship.py. Each motion takes the moving nodes and an amount, 1 as it is meant."""

import dataclasses
from collections.abc import Callable

import _snapped
import faults
import numpy as np
from _walls import bump, camber, flap, pitch, up

import jaxmorph as jm
from jaxmorph import cases

Motion = Callable[[np.ndarray, float], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Case:
    """A mesh, its patches, the planes in which nodes slide, and motions by name."""

    name: str
    mesh: jm.Mesh
    moving: str
    fixed: tuple[str, ...]
    symmetry: tuple[str, ...]
    motions: dict[str, Motion]

    def plan(self, method: jm.AbstractMethod | None) -> jm.Plan:
        return jm.prepare(self.mesh, self.moving, self.fixed, symmetry=self.symmetry, method=method)

    @property
    def wall(self) -> np.ndarray:
        return np.asarray(self.mesh.points)[self.mesh.patch(self.moving)]

    @property
    def extent(self) -> float:
        return float(np.ptp(self.wall, axis=0).max())


def thicker(base: np.ndarray, amount: float) -> np.ndarray:
    return up(base, 0.3 * amount * base[:, -1])[0]


def waves(base: np.ndarray, amount: float) -> np.ndarray:
    return up(base, 0.02 * amount * np.sin(4 * np.pi * base[:, 0]))[0]


def far_away(base: np.ndarray, amount: float) -> np.ndarray:
    return up(base, np.full(len(base), 0.5 * amount))[0]


SECTION: dict[str, Motion] = {
    "pitch 15": lambda base, amount: pitch(base, 15 * amount)[0],
    "pitch 45": lambda base, amount: pitch(base, 45 * amount)[0],
    "flap 20": lambda base, amount: flap(base, 20 * amount)[0],
    "camber 5 %": lambda base, amount: camber(base, 0.05 * amount)[0],
    "bump 3 %": lambda base, amount: bump(base, 0.03 * amount)[0],
    "thickness 30 %": thicker,
    "waves 2 %": waves,
    "heave 0.5": far_away,
}


def bend(base: np.ndarray, amount: float) -> np.ndarray:
    return up(base, 0.3 * amount * base[:, 1] ** 2 / np.abs(base[:, 1]).max())[0]


def twist(base: np.ndarray, amount: float) -> np.ndarray:
    angle = np.deg2rad(20 * amount) * base[:, 1] / np.abs(base[:, 1]).max()
    x, z = base[:, 0] - 0.5 * np.median(base[:, 0]), base[:, 2]
    return np.stack(
        [
            x * np.cos(angle) + z * np.sin(angle) - x,
            0 * x,
            z * np.cos(angle) - x * np.sin(angle) - z,
        ],
        axis=1,
    )


def turn(base: np.ndarray, amount: float) -> np.ndarray:
    return (
        np.asarray(jm.shapes.rotate(base, np.deg2rad(45 * amount), [0.0, 0, 0], [0.0, 1, 0])) - base
    )


WING: dict[str, Motion] = {
    **{
        name: SECTION[name]
        for name in ("bump 3 %", "waves 2 %", "camber 5 %", "thickness 30 %", "heave 0.5")
    },
    "bend": bend,
    "twist 20": twist,
    "turn 15": lambda base, amount: turn(base, amount / 3),
}


def dent(base: np.ndarray, amount: float) -> np.ndarray:
    """Pushes the floor of the cube up in its middle."""
    return up(
        base, 0.3 * amount * np.exp(-8 * ((base[:, 0] - 0.5) ** 2 + (base[:, 1] - 0.5) ** 2))
    )[0]


def about_middle(
    base: np.ndarray, amount: float, degrees: float = 0.0, growth: float = 0.0
) -> np.ndarray:
    """Turns and scales the floor of the cube in its plane."""
    z = base[:, 0] - 0.5 + 1j * (base[:, 1] - 0.5)
    z = z * ((1 + growth * amount) * np.exp(1j * np.deg2rad(degrees * amount)) - 1)
    return np.stack([z.real, z.imag, 0 * z.real], axis=1)


FLOOR: dict[str, Motion] = {
    "dent": dent,
    "pull": lambda base, amount: -dent(base, amount),
    "raise 0.1": lambda base, amount: up(base, np.full(len(base), 0.1 * amount))[0],
    "tilt 10": lambda base, amount: up(base, np.tan(np.deg2rad(10 * amount)) * (base[:, 0] - 0.5))[
        0
    ],
    "waves 5 %": lambda base, amount: up(base, 0.05 * amount * np.sin(2 * np.pi * base[:, 0]))[0],
    "slide 0.1": lambda base, amount: np.tile([0.1 * amount, 0, 0], (len(base), 1)),
    "turn 15": lambda base, amount: about_middle(base, amount, degrees=15),
    "growth 20 %": lambda base, amount: about_middle(base, amount, growth=0.2),
}
"""Motions of a cube's floor, in its plane and across it."""


def brick(kind: str, motions: dict[str, Motion]) -> Case:
    """A cube whose floor moves, and whose other sides are fixed."""
    mesh = cases.bricks(kind, cells=5)
    points = mesh.points
    floor = np.flatnonzero(points[:, 2] < 1e-9)
    sides = np.flatnonzero(
        ((points < 1e-9) | (points > 1 - 1e-9)).any(axis=1) & (points[:, 2] > 1e-9)
    )
    patches = {"floor": floor, "sides": sides}
    return Case(
        f"bricks, {kind}", jm.Mesh(points, mesh.cells, patches), "floor", ("sides",), (), motions
    )


def longer(base: np.ndarray, amount: float) -> np.ndarray:
    return 0.3 * amount * base * [1.0, 0, 0]


def snapped() -> list[Case]:
    """The mesh that snappyHexMesh makes, where it is installed."""
    motions = {"heave 0.5": far_away, "turn 45": turn, "stretch 30 %": longer}
    return (
        [Case("snapped sphere", _snapped.sphere(), "body", ("box",), (), motions)]
        if _snapped.is_there()
        else []
    )


def all_cases(points: int) -> list[Case]:
    """Generated meshes of about so many points in 2-D, and a few times as many in 3-D."""
    around = max(60, int((points / 0.5) ** 0.5))
    c_grid, viscous = cases.naca0015(points=points), cases.naca4("4412", points=points)
    o_grid = faults.sharp_o_grid(around=around, layers=points // around, first_cell=1e-5)
    blade = faults.cascade(around=around, layers=points // around)
    wing = cases.wing(points=max(300, points // 5), stations=7)
    far = ("farfield",)
    return [
        Case("C-grid", c_grid, "airfoil", far, (), SECTION),
        Case("cambered, viscous", viscous, "airfoil", far, (), SECTION),
        Case("O-grid", o_grid, "airfoil", far, (), SECTION),
        Case("cascade", blade, _moving(blade), _others(blade), (), SECTION),
        Case("wing", wing, "wing", far, ("root", "tip"), WING),
        brick("hexahedron", FLOOR),
        *(brick(kind, {"dent": dent}) for kind in ("tetra", "pyramid", "wedge")),
        *snapped(),
    ]


def _moving(mesh: jm.Mesh) -> str:
    return next(name for name in mesh.patches if name in ("blade", "airfoil", "wall"))


def _others(mesh: jm.Mesh) -> tuple[str, ...]:
    return tuple(name for name in mesh.patches if name != _moving(mesh))


METHODS: dict[str, Callable[[float], jm.AbstractMethod]] = {
    **{entry.title or name: entry.make for name, entry in jm.METHODS.items()},
    "compact RBF": jm.CompactRBF,
    "elasticity 1/d": lambda size: jm.LinearElasticity(jm.ByDistance(1.0)),
    "local correction": lambda size: jm.SurfaceReconstruction(jm.RBF(), jm.LocalCorrection()),
}
"""The list of methods by title, for the size of a wall; then methods with parameters that the list does not have."""
