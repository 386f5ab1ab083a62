"""Makes docs/least_drag.png: a sphere that becomes the body of least drag, by the code of its notebook.

    python docs/least_drag.py [docs/least_drag.png]

It needs `pip install 'jaxmorph[plot,cases,test]'`, and a minute.
"""

import pathlib
import sys

import matplotlib.pyplot as plt
import nbformat
import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

from jaxmorph import plot

NOTEBOOK = pathlib.Path(__file__).parents[1] / "notebooks" / "01_least_drag.ipynb"
SIZE, COLOURS, LARGEST = (7.2, 3.1), 48, 80_000
"""Inches at 100 pixels each, colours of the palette, bytes of the picture at most."""

SHOWN = 2.9, 2.1
"""Half of a panel's width and height, in radii of the sphere."""


def optimum():
    """Runs the notebook up to its first picture; returns the names that it has then."""
    names = {}
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        if cell.cell_type != "code":
            continue
        if "plt.subplots" in cell.source:
            return names
        exec(cell.source.replace("%config", "# "), names)
    raise ValueError(f"{NOTEBOOK} has no picture.")


def draw(ax, names, points, title, below):
    """Draws the mesh around a body, mirrored at the axis."""
    shape = names["layers"] + 1, names["around"] + 1
    for side in (1, -1):
        lines = np.reshape(points, (*shape, 2)) * [1, side]
        grid = [*lines, *lines.transpose(1, 0, 2)]
        ax.add_collection(LineCollection(grid, colors="0.6", linewidths=0.5))
    wall = np.reshape(points, (*shape, 2))[0]
    both = np.concatenate([wall, wall[::-1] * [1, -1]])
    ax.fill(*both.T, color=plot.BLUE, linewidth=0, zorder=3)
    limits = [(-half, half) for half in SHOWN]
    ax.set(xlim=limits[0], ylim=limits[1], aspect="equal")
    ax.set_title(title, fontsize=17)
    ax.text(0.5, -0.03, below, ha="center", va="top", transform=ax.transAxes, fontsize=14)
    ax.set_axis_off()


def main(path):
    names = optimum()
    figure, axes = plt.subplots(1, 2, figsize=SIZE, dpi=100)
    moved = np.asarray(names["deform"](names["displacement"](names["found"].x)))
    draw(axes[0], names, names["points"], "sphere", "drag 1")
    draw(axes[1], names, moved, "least drag", f"drag {names['found'].fun:.3f}")
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.1, top=0.88, wspace=0.04)
    figure.savefig(path)
    picture = Image.open(path).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)
    size = pathlib.Path(path).stat().st_size
    if size > LARGEST:
        raise ValueError(f"{path} has {size} bytes, more than {LARGEST}.")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).with_name("least_drag.png"))
