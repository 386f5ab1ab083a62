"""What single precision is worth: points and gradients of `deform` on the paper's two meshes, against double precision.

python benchmarks/precision.py [--sums]

Errors are the largest of all components, relative to the largest component: of the points' displacements, and of the gradient
with respect to u for random cotangents (smooth ones hide errors). The solve is in double precision where JAX's x64 mode is on.

With `--sums`, the solve and the distances are in double precision, and the thin plate splines are evaluated and summed in single
precision. That is the sum that a GPU without fast double precision would take.
"""

import subprocess
import sys
import tempfile

import agard445
import jax
import numpy as np
from _measure import about, table

import jaxmorph as jm
from jaxmorph import cases

METHODS = {
    "`prepare`'s default": None,
    "paper's, all nodes sources": jm.RBF.classic(),
    "graph mapping": jm.DelaunayGraph(),
}


def problems():
    airfoil, wing = cases.naca0015(), agard445.mesh(points=16_000)
    wall = airfoil.points[airfoil.patch("airfoil")]
    with jax.enable_x64(True):
        pitched = np.asarray(jm.shapes.rotate(wall, np.deg2rad(-15), [0.25, 0.0])) - wall
    yield "airfoil, 15 degrees", airfoil, "airfoil", pitched
    yield (
        "wing, mode 1 by 0.25",
        wing,
        "wing",
        agard445.mode(wing.points[wing.patch("wing")], 1, 0.25),
    )


def results(dtype) -> dict[str, np.ndarray]:
    found = {}
    for case, mesh, moving, u in problems():
        cotangent = np.random.default_rng(0).normal(size=mesh.points.shape).astype(dtype)
        for name, method in METHODS.items():
            if (
                len(mesh.points) > 15_000
                and mesh.points.shape[1] == 3
                and isinstance(method, jm.RBF)
            ):
                continue  # 4,475 sources: the airfoil shows it
            points = mesh.points.astype(dtype)
            try:
                plan = jm.prepare(points, mesh.patch(moving), mesh.patch("farfield"), method=method)
            except ValueError as error:
                print(f"{case}, {name}, refused: {error}", file=sys.stderr)
                continue
            moved = np.asarray(jm.deform(plan, u.astype(dtype)), float) - points
            found[f"{case}, {name}, displacements"] = moved
            found[f"{case}, {name}, inverted"] = np.array(
                int(jm.quality(mesh, points + moved).inverted)
            )
            found[f"{case}, {name}, gradient"] = np.asarray(
                jm.pullback(plan, u.astype(dtype), cotangent), float
            )
    return found


def without_x64() -> dict[str, np.ndarray]:
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        subprocess.run([sys.executable, __file__, file.name], check=True)
        return dict(np.load(file.name))


def summed(distance: np.ndarray, weights: np.ndarray, dtype) -> np.ndarray:
    """Sums thin plate splines of distances (n, s) with weights (s, d) in one precision."""
    distance, weights = distance.astype(dtype), weights.astype(dtype)
    return (distance**2 * np.log(np.where(distance > 0, distance, 1))) @ weights


def sums() -> None:
    """Compares sums in single and in double precision, over the default's sources."""
    rows = []
    for case, mesh, moving, u in problems():
        points = np.asarray(mesh.points, float)
        plan = jm.prepare(points, mesh.patch(moving), mesh.patch("farfield"))
        at = np.asarray(plan.sources)
        values = np.zeros_like(points)
        values[mesh.patch(moving)] = u
        terms = np.column_stack([np.ones(len(at)), points[at]])
        kernel = summed(
            np.linalg.norm(points[at][:, None] - points[at], axis=2), np.eye(len(at)), float
        )
        zeros = np.zeros((terms.shape[1], terms.shape[1]))
        system = np.block([[kernel, terms], [terms.T, zeros]])
        weights = np.linalg.solve(
            system, np.concatenate([values[at], zeros[:, : points.shape[1]]])
        )[: len(at)]
        wall = points[mesh.patch(moving)]
        near = ((points >= wall.min(axis=0)) & (points <= wall.max(axis=0))).all(axis=1)
        wrong = []
        for part in np.array_split(points, 1 + len(points) // 4096):
            apart = np.linalg.norm(part[:, None] - points[at], axis=2)
            wrong.append(
                np.abs(summed(apart, weights, np.float32) - summed(apart, weights, float)).max(
                    axis=1
                )
            )
        error = np.concatenate(wrong) / np.abs(u).max()
        rows.append((case, str(len(at)), f"{error.max():.0e}", f"{error[near].max():.0e}"))
    table(
        rows,
        ("what", "sources", "largest error over largest displacement", "within the wall's box"),
    )


if __name__ == "__main__":
    if "--sums" in sys.argv:
        jax.config.update("jax_enable_x64", True)
        about(dtype="sums in float32, all else in float64")
        sums()
        sys.exit()
    if len(sys.argv) > 1:
        np.savez(sys.argv[1], **results(np.float32))  # pyright: ignore[reportArgumentType]
        sys.exit()
    jax.config.update("jax_enable_x64", True)
    about(dtype="float32 against float64")
    exact, mixed, single = results(np.float64), results(np.float32), without_x64()
    rows = []
    for name, value in exact.items():
        cells = []
        for found in (mixed, single):
            if name not in found:
                cells.append("refused")
            elif name.endswith("inverted"):
                cells.append(str(int(found[name])))
            else:
                cells.append(f"{np.abs(found[name] - value).max() / np.abs(value).max():.0e}")
        rows.append((name, *cells))
    table(rows, ("what", "x64 mode on", "off"))
