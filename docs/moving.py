"""Makes docs/moving.gif: a wing that bends, its mesh cut open, beside an airfoil that turns.

    python docs/moving.py [docs/moving.gif]

It needs `pip install 'jaxmorph[plot,cases]'` and takes a minute.
"""

import pathlib
import sys

import jax
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import jaxmorph as jm
from jaxmorph import cases, plot, shapes

sys.path.append(str(pathlib.Path(__file__).parents[1]))
from benchmarks import agard445

FRAMES, RATE, BENDING, ANGLE = 14, 8, 0.3, 15
"""Pictures in a period and a second, rise of the wing's tip in semi-spans, rotation of the airfoil in degrees."""

SIZE, PIXELS, LETTERS = (8.0, 3.9), 100, 16
"""Width and height in inches, pixels an inch, size of letters in points: a phone shows the film at two fifths."""

CHANGE, SKEWNESS = (0, 12), (0, 0.3)
"""Ends of the colours: change of a cell's volume in %, skewness."""

LARGEST = 900_000
"""Bytes of the picture at most."""


def wing():
    """Makes the function that draws the bent wing and the cells in a plane across its span, as pixels."""
    mesh = agard445.mesh(points=6_500)
    plan = jm.prepare(mesh, "wing", "farfield", symmetry="symmetry")
    moved = np.asarray(jm.deform(plan, agard445.mode(mesh.points[plan.moving], 1, BENDING)))

    left = np.array([1.0, -1.0, 1.0])  # the left wing

    def draw(phase):
        points = mesh.points + phase * (moved - mesh.points)  # `deform` is linear
        change = 100 * np.abs(jm.quality(mesh, points).volume_ratio - 1)
        plane = jm.Plane((0, 1, 0), (0, -0.4, 0))
        plotter = plot.cut(
            mesh, points * left, plane=plane, values=change, limits=CHANGE, bar=False
        )
        plot.surface(mesh, points * left, patch="wing", plotter=plotter)
        plotter.hide_axes()
        plotter.window_size = 1000, 760
        plotter.camera_position = [(-1.45, -3.72, 2.62), (0.69, -0.52, 0.06), (0, 0, 1)]
        plotter.camera.parallel_projection, plotter.camera.view_angle = False, 10.9
        pixels = plotter.screenshot(return_img=True)
        plotter.close()
        return pixels

    return draw


def airfoil():
    """Makes the function that draws the turned airfoil, cells coloured by skewness, on axes."""
    mesh = cases.naca0015(points=6_000)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    wall = mesh.points[plan.moving]

    def draw(phase, ax):
        u = shapes.rotate(wall, -np.deg2rad(ANGLE * phase), about=(0.25, 0)) - wall
        points = jm.deform(plan, u)
        colours = {"values": jm.quality(mesh, points).skewness, "limits": SKEWNESS, "bar": False}
        plot.mesh(mesh, points, **colours, window=((-0.25, 1.25), (-0.57, 0.57)), ax=ax)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")

    return draw


def main(path):
    jax.config.update("jax_enable_x64", True)
    plt.rcParams["font.size"] = LETTERS
    draw_wing, draw_airfoil = wing(), airfoil()

    def draw(phase):
        figure, (left, right) = plt.subplots(1, 2, figsize=SIZE, dpi=PIXELS, layout="constrained")
        left.imshow(draw_wing(phase.item()))
        left.set_axis_off()
        draw_airfoil(phase.item(), right)
        for ax, limits, label in (
            (left, CHANGE, "change of a cell's volume, %"),
            (right, SKEWNESS, "skewness of a cell"),
        ):
            colours = plt.cm.ScalarMappable(plt.Normalize(*limits), plot.COLOURS)
            figure.colorbar(
                colours,
                ax=ax,
                label=label,
                location="bottom",
                aspect=40,
                pad=0.02,
                ticks=np.linspace(*limits, 4),
            )
        return right

    phases = np.sin(2 * np.pi * np.arange(FRAMES) / FRAMES)
    pictures = []
    for phase in phases:
        canvas = draw(phase).figure.canvas
        canvas.draw()
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
        plt.close(canvas.figure)
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=1000 / RATE, loop=0, optimize=True
    )
    size = path.stat().st_size
    print(f"{path}: {size:,} bytes")
    if size > LARGEST:
        raise SystemExit(f"more than {LARGEST:,} bytes: take fewer FRAMES or PIXELS.")


if __name__ == "__main__":
    main(
        pathlib.Path(
            sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).with_name("moving.gif")
        )
    )
