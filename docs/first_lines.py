"""Makes docs/first_lines.png: first grid lines at the nose of a NACA 4412 with 10 % of camber, without and with the layer's slope.

    python docs/first_lines.py [docs/first_lines.png]

It needs `pip install 'jaxmorph[plot]'`. A table of angles is printed, too.
"""

import pathlib
import sys

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph.plot._style import BLUE, DARK, GREY

INTERPOLATED = jm.SurfaceReconstruction(
    jm.RBF(reduction=jm.KDTree(64, extremes=True)), jm.NearWall()
)
SECTIONS = {
    "the paper's airfoil": lambda: cases.naca0015(),
    "NACA 2412": lambda: cases.naca4("2412", points=8000, first_cell=1e-5),
    "NACA 4412": lambda: cases.naca4("4412", points=8000, first_cell=1e-5),
}
WINDOW = ((0.03, 0.19), (0.05, 0.165))


def camber(mesh):
    x = mesh.points[mesh.patch("airfoil")]
    return np.column_stack([0 * x[:, 0], 0.4 * x[:, 0] * (1 - x[:, 0])])


def plain(plan):
    """The plan whose layer carries values alone."""
    strength = plan.surface.factors.correction.turn.strength
    return eqx.tree_at(lambda p: p.surface.factors.correction.turn.strength, plan, 0 * strength)


def plans(mesh):
    fitted = jm.prepare(mesh, "airfoil", "farfield")
    interpolated = jm.prepare(mesh, "airfoil", "farfield", method=INTERPOLATED)
    classic = jm.prepare(mesh, "airfoil", "farfield", method=jm.RBF.classic())
    return [fitted, plain(interpolated), classic]


def draw(path):
    mesh = cases.naca4("4412", points=16000, first_cell=2.5e-3)
    followed = jm.prepare(mesh, "airfoil", "farfield")
    interpolated = plain(jm.prepare(mesh, "airfoil", "farfield", method=INTERPOLATED))
    u = camber(mesh)
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.9), sharex=True, sharey=True)
    quads = mesh.cells["quad"]
    for ax, (title, shown) in zip(
        axes, {"values alone": interpolated, "values and slope": followed}.items(), strict=True
    ):
        points = np.asarray(jm.deform(shown, u))
        edges = np.unique(
            np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2)), axis=0
        )
        ax.plot(*points[edges].T, color=GREY, lw=0.4)
        lines = jm.wall_quality(mesh, "airfoil", points)
        on_wall = np.isin(edges, mesh.patch("airfoil"))
        ax.plot(*points[edges[on_wall.all(axis=1)]].T, color=DARK, lw=1.6)
        ax.plot(*points[edges[on_wall.sum(axis=1) == 1]].T, color=BLUE, lw=1.2)
        ax.set_title(f"{title}: {float(lines.mean_angle):.1f}° off", loc="left", fontsize=10)
        ax.set(xlim=WINDOW[0], ylim=WINDOW[1], aspect="equal", xticks=[], yticks=[])
    figure.tight_layout(pad=0.4)
    figure.savefig(path, dpi=160, bbox_inches="tight")


def main():
    jax.config.update("jax_enable_x64", True)
    draw(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).with_suffix(".png"))
    for name, make in SECTIONS.items():
        mesh = make()
        angles = [
            float(jm.wall_quality(mesh, "airfoil", jm.deform(p, camber(mesh))).mean_angle)
            for p in plans(mesh)
        ]
        print("|", name, "|", " | ".join(f"{angle:.1f}" for angle in angles), "|", flush=True)


if __name__ == "__main__":
    main()
