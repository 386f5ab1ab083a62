"""Makes docs/openfoam.png: OpenFOAM's airFoil2D turned by 45 degrees by two of its own movers and by jaxmorph's.

    JAXMORPH_OPENFOAM_SOURCE=FOLDER python docs/openfoam.py [docs/openfoam.png]

It needs `pip install 'jaxmorph[plot,test]'`, OpenFOAM, and FOLDER as native/openfoam/debian_headers.sh fills it.
"""

import pathlib
import re
import sys
import tempfile

import jax
import matplotlib.pyplot as plt
from PIL import Image

import jaxmorph as jm
from jaxmorph import io, plot

sys.path.append(str(pathlib.Path(__file__).parents[1] / "tests"))
import foam
import foam_motion

MOVERS = {
    "displacementLaplacian": "Laplacian",
    "displacementSBRStress": "SBRStress",
    "jaxmorph": "jaxmorph",
}
ANGLE, STEPS = 45, 10
WINDOW = ((1, 19), (-27, -9))
"""Around the trailing edge after the turn; the chord is 35."""

SIZE, COLOURS, LARGEST = (7.2, 3.05), 48, 150_000
"""Inches at 100 pixels each, colours of the palette, bytes of the picture at most."""


def turned(folder, mover, library):
    """Turns the airfoil; returns the mesh, its points, and how many faces checkMesh calls wrong."""
    case = foam_motion.airfoil(
        folder / mover, mover, library, ANGLE, delta=1 / STEPS, interval=STEPS
    )
    foam_motion.moved(case, foam_motion.AIRFOIL if mover == "jaxmorph" else None)
    wrong = re.search(r"face pyramids: (\d+) faces", foam.run(case, "checkMesh", "-time", "1"))
    mesh = io.read(case)
    front = mesh.source.content.plane.front
    return mesh, foam_motion.points_of(case, "1")[front, :2], int(wrong[1]) if wrong else 0


def main(path):
    jax.config.update("jax_enable_x64", True)
    figure, axes = plt.subplots(1, 3, figsize=SIZE, dpi=100)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        library, _ = foam_motion.build(folder)
        for ax, (mover, title) in zip(axes, MOVERS.items(), strict=True):
            mesh, points, wrong = turned(folder, mover, library)
            values = jm.quality(mesh, points).skewness
            plot.mesh(mesh, points, values=values, limits=(0, 1), bar=False, window=WINDOW, ax=ax)
            ax.set_title(f"{title}\n{wrong} wrong faces", fontsize=17)
            ax.set_axis_off()
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=0.78, wspace=0.03)
    figure.savefig(path)
    Image.open(path).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    size = path.stat().st_size
    print(f"{path}: {size:,} bytes")
    if size > LARGEST:
        raise SystemExit(f"more than {LARGEST:,} bytes: take fewer COLOURS.")


if __name__ == "__main__":
    main(
        pathlib.Path(
            sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).with_suffix(".png")
        )
    )
