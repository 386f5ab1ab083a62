"""The cases of walls.py: meshes, and motions of their walls that are hard on boundary layers."""

import dataclasses
import pathlib
from collections.abc import Callable, Iterator

import agard445
import faults
import numpy as np

import jaxmorph as jm
from jaxmorph import cases, io

SHARED = pathlib.Path(__file__).parents[2] / "shared" / "cases"
CODES = ("6409", "9412", "8306")
DRAWS = 6


@dataclasses.dataclass(frozen=True)
class Case:
    """A mesh, its moving nodes and its fixed ones, and motions by name: paths (steps, m, d) of the moving nodes."""

    part: str
    name: str
    mesh: jm.Mesh
    moving: np.ndarray
    fixed: np.ndarray
    motions: dict[str, np.ndarray]
    symmetry: tuple[jm.Plane, ...] = ()


def up(base: np.ndarray, height: np.ndarray) -> np.ndarray:
    """One step along the last coordinate."""
    return np.concatenate(
        [np.zeros((len(base), base.shape[1] - 1)), np.reshape(height, (-1, 1))], axis=1
    )[None]


def camber(base: np.ndarray, height: float = 0.1) -> np.ndarray:
    return up(base, 4 * height * base[:, 0] * (1 - base[:, 0]))


def turned(base: np.ndarray, centre: float, degrees: np.ndarray | float) -> np.ndarray:
    """One step: nose up, by an angle for each node, about a point of the chord."""
    z = (base[:, 0] - centre + 1j * base[:, 1]) * (np.exp(-1j * np.deg2rad(degrees)) - 1)
    return np.stack([z.real, z.imag], axis=1)[None]


def pitch(base: np.ndarray, degrees: float) -> np.ndarray:
    return turned(base, 0.25, degrees)


def flap(base: np.ndarray, degrees: float, blend: float = 0.1) -> np.ndarray:
    """Down behind 70 % of the chord, gradually over `blend` chords; 0 makes a sharp hinge."""
    share = np.clip((base[:, 0] - 0.7) / (blend or 1e-9) + 0.5, 0, 1)
    return turned(base, 0.7, degrees * share**2 * (3 - 2 * share))


def bump(base: np.ndarray, height: float = 0.1) -> np.ndarray:
    """On the upper side alone."""
    return up(base, height * np.exp(-(((base[:, 0] - 0.5) / 0.1) ** 2)) * (base[:, -1] > 0))


def wavy(base: np.ndarray, rng: np.random.Generator, kink: bool) -> np.ndarray:
    """A sum of sines along the chord; with a kink the lower side gets another share of it than the upper one."""
    x = np.clip(base[:, 0], 0, 1)
    amplitudes, share = rng.normal(size=8) * 0.02 / np.arange(1, 9), rng.uniform(-1, 1)
    height = np.sin(np.pi * x[:, None] * np.arange(1, 9)) @ amplitudes
    return up(base, np.where((base[:, 1] < 0) & kink, share, 1.0) * height)


def airfoil(
    part: str, name: str, mesh: jm.Mesh, motions: Callable[[np.ndarray], dict[str, np.ndarray]]
) -> Case:
    moving = mesh.patch("airfoil")
    return Case(part, name, mesh, moving, mesh.patch("farfield"), motions(mesh.points[moving]))


def kinks(points: int) -> Iterator[Case]:
    """18 random displacements that jump at the edges, and 18 that do not."""
    for code in CODES:
        rng = np.random.default_rng(int(code))

        def motions(base, rng=rng):
            draws = [(kink, i) for kink in (True, False) for i in range(DRAWS)]
            return {
                f"{'kink' if kink else 'smooth'} {i}": wavy(base, rng, kink) for kink, i in draws
            }

        yield airfoil("kinks", code, cases.naca4(code, points=points, first_cell=1e-6), motions)


def shapes(points: int) -> Iterator[Case]:
    """Changes of an airfoil's shape: camber, flaps, pitch, a bump, a raised patch with steps at its edges."""

    def motions(base):
        return {
            "camber 10 %": camber(base),
            "flap 30, sharp": flap(base, 30, 0),
            "flap 45": flap(base, 45),
            "pitch 15": pitch(base, 15),
            "pitch 45": pitch(base, 45),
            "bump 0.1": bump(base),
        }

    yield airfoil("shapes", "naca0015", cases.naca0015(points=points), motions)

    def few(base):
        raised = 0.01 * ((np.abs(base[:, 0] - 0.225) < 0.025) & (base[:, 1] > 0))
        return {
            "camber 10 %": camber(base),
            "bump 0.03": bump(base, 0.03),
            "step 0.01": up(base, raised),
            "flap 45": flap(base, 45),
        }

    def real(base):
        rng = np.random.default_rng(12)
        kinks = {f"kink {i}": wavy(base, rng, True) for i in range(3)}
        return {
            "bump 0.1": bump(base),
            "pitch 15": pitch(base, 15),
            "flap 15": flap(base, 15),
        } | kinks

    yield airfoil("shapes", "naca4412", cases.naca4("4412", points=points, first_cell=1e-6), few)
    for name, file in (
        ("euler", "naca0012-euler/naca0012_inv.su2"),
        ("viscous", "naca0012-cgrid/n0012_225-65.su2"),
    ):
        if (SHARED / file).exists():
            yield airfoil(
                "shapes", name, io.read(SHARED / file), lambda base: few(base) | real(base)
            )


def edges(points: int) -> Iterator[Case]:
    """Sharp trailing edges with a very thin first cell; a moving flap that joins a wall at rest."""
    for name, mesh in (
        ("O-grid, sharp", faults.sharp_o_grid()),
        ("C-grid, sharp", cases.naca4("0012", points=points, first_cell=1e-6, sharp=True)),
    ):
        yield airfoil(
            "edges",
            name,
            mesh,
            lambda base: {"camber 10 %": camber(base), "pitch 30": pitch(base, 30)},
        )
    mesh = cases.naca0015(points=points)
    wall = mesh.patch("airfoil")
    x = mesh.points[wall, 0]
    moving, fixed = wall[x > 0.7], np.union1d(wall[x <= 0.7], mesh.patch("farfield"))
    s = (mesh.points[moving] - [0.7, 0]) / [0.3, 1]
    bent = {
        "camber of the flap": up(s, 0.03 * 4 * s[:, 0] * (1 - s[:, 0])),
        "flap bends": up(s, 0.06 * s[:, 0] ** 2),
    }
    yield Case("edges", "joint", mesh, moving, fixed, bent)


def passages(points: int) -> Iterator[Case]:
    """A blade that turns in its passage, in 5 steps; a bump of half the gap in a channel whose walls touch."""
    mesh = faults.cascade()
    moving, sides = mesh.patch("blade"), mesh.patch("inlet", "outlet", "lower", "upper")
    base = mesh.points[moving] - [0, 0.08]
    steps = {
        f"turn {degrees}": np.concatenate(
            [turned(base, 0.5, degrees * (j + 1) / 5) for j in range(5)]
        )
        for degrees in (38, 42, 44)
    }
    yield Case("passages", "cascade", mesh, moving, sides, steps)
    mesh = faults.channel()
    moving = mesh.patch("inner")
    base = mesh.points[moving]
    half = (
        0.1
        * np.exp(-(((base[:, 0] - 0.5) / 0.1) ** 2))
        * (16 * (base[:, 0] * (1 - base[:, 0])) ** 2)
    )
    yield Case(
        "passages",
        "channel",
        mesh,
        moving,
        mesh.patch("outer", "inlet", "outlet"),
        {"bump": up(base, half)},
    )


def bricks(points: int) -> Iterator[Case]:
    """A floor that heaves, bends and twists under a held lid, in cells of every type."""
    meshes = {
        kind: cases.bricks(kind, cells=8, first_cell=0.02)
        for kind in ("hexahedron", "tetra", "mixed")
    }
    sides = dict.fromkeys(meshes, ("floor", "lid"))
    if (file := SHARED / "brick-tets" / "brick_tets.su2").exists():
        meshes["shared"], sides["shared"] = io.read(file), ("z_m", "z_p")
    for name, mesh in meshes.items():
        moving, fixed = (mesh.patch(side) for side in sides[name])
        base = mesh.points[moving]
        x, y = ((base - base.min(axis=0)) / np.ptp(base[:, :2], axis=0).max())[:, :2].T
        motions = {
            "bend": 0.2 * x**2,
            "bump": 0.2 * np.exp(-20 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)),
            "twist": 0.6 * x * y,
        }
        yield Case(
            "bricks",
            name,
            mesh,
            moving,
            fixed,
            {what: up(base, height) for what, height in motions.items()},
        )


def wing(points: int) -> Iterator[Case]:
    """The AGARD 445.6 wing in its modes, and with a bump on its upper side."""
    mesh = agard445.mesh(points=16_000)
    moving = mesh.patch("wing")
    base = mesh.points[moving]
    motions = {}
    for mode, sizes in ((1, (0.1, 0.25, 0.5)), (2, (0.2, 0.3))):
        motions |= {
            f"mode {mode} at {size}": agard445.mode(base, mode, size)[None] for size in sizes
        }
    middle, extent = base.mean(axis=0), np.ptp(base, axis=0)
    round_about = np.exp(-np.sum(((base - middle)[:, :2] / extent[:2] / 0.15) ** 2, axis=1))
    motions["upper bump"] = up(base, 0.03 * round_about * (base[:, 2] > 0))
    plane = jm.Plane.through(mesh.points, mesh.patch("symmetry"))
    yield Case("wing", "agard445", mesh, moving, mesh.patch("farfield"), motions, (plane,))


PARTS: dict[str, Callable[[int], Iterator[Case]]] = {
    "kinks": kinks,
    "shapes": shapes,
    "edges": edges,
    "passages": passages,
    "bricks": bricks,
    "wing": wing,
}
