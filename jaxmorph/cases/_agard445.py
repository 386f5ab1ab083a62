"""The paper's second case: the AGARD 445.6 wing, its mesh and its mode shapes."""

import hashlib
import os
import zipfile
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

import jaxmorph as jm
from jaxmorph._host.package.arguments import between, checked
from jaxmorph._host.package.errors import warn
from jaxmorph._host.package.files import complete
from jaxmorph._kernels.values import is_known

from . import _agard445_wing as wing
from ._agard445_mesh import CENTRE, CONTOUR_INTERVALS, DISTANCE_SAMPLES, OPTIONS, RADIUS, Sizes, generate
from ._agard445_modes import DEFLECTIONS, mode_shape

RESOLUTIONS = {
    # Edges at the sharp corner of tip and trailing edge: others leave slivers there, that bending
    # makes worse.
    64_943: Sizes(wall=0.935, growth=0.155, far=0.755, trailing_edge=3.6e-3, tip=3.6e-3),
    16_000: Sizes(wall=2.3, growth=0.194, far=1.4),
    6_500: Sizes(wall=4.0, growth=0.257, far=2.0),
}
PATCHES = ("wing", "symmetry", "farfield")
# Raised by whoever changes how the mesh is made in a way that the numbers below do not show.
REVISION = 1


@checked
def agard445(*, points: int = 64_943, cache_directory: str | os.PathLike | None = None) -> jm.Mesh:
    """Makes the half wing of the paper's section 3.2 in tetrahedra, in metres.

    It needs gmsh (`pip install 'jaxmorph[cases]'`).

    x is streamwise, the span runs along +y from the plane y = 0, z is up. Sections are NACA 65A004
    (ordinates of NASA TM-100492, sharp trailing edge). The root chord is 0.558 m, the tip chord
    0.368 m, the semi-span 0.762 m; the tip is flat. The far field is a hemisphere of 8 m round the
    middle of the root chord. Patches are `wing`, `symmetry` and `farfield`; a node where two of
    them meet is in both.

    The paper's mesh has 64,943 points, 334,861 cells, 16,285 nodes on the wing and 923 on the far
    field. Its aspect ratio is 1.546 in the mean and 7.223 at most: longest edge over 2 sqrt(6)
    inscribed radii, 1 for a regular cell. With gmsh 4.15:

    | `points` | points | cells | wing | far field | aspect ratio: mean, largest |
    |---|---|---|---|---|---|
    | 64_943 | 64,764 | 342,728 | 16,230 | 917 | 1.527, 7.15 |
    | 16_000 | 16,230 | 83,452 | 4,187 | 288 | 1.554, 6.70 |
    | 6_500 | 6,592 | 32,247 | 1,966 | 163 | 1.585, 6.59 |

    Equal options give equal meshes, bit for bit, with one version of gmsh. The finest takes 15
    to 25 s, once: the mesh is then kept in `cache_directory`, by default the user's cache
    directory, under its parameters and gmsh's version. A file there that cannot be read is made
    anew. A gmsh session of the caller's is left as it was.

    **Arguments:**

    - `points`: one of the three resolutions, 64_943, 16_000 or 6_500. Default 64_943.
    - `cache_directory`: the folder in which meshes are kept. Default: the user's cache directory.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for other `points`, and `ImportError` when gmsh, platformdirs or one of
    their libraries is missing.
    """
    if points not in RESOLUTIONS:
        known = ", ".join(f"{n:,}".replace(",", "_") for n in RESOLUTIONS)
        raise ValueError(f"`points` is {points!r}; this case comes with about {known} points: give one of these.")
    gmsh = _import_gmsh()
    directory = _user_cache() if cache_directory is None else Path(cache_directory)
    file = directory / _file_name(points, gmsh.__version__)
    arrays = _load(file)
    if arrays is None:
        arrays = generate(gmsh, RESOLUTIONS[points])
        _store(file, arrays)
    return jm.Mesh(arrays["points"], {"tetra": arrays["tetra"]}, {name: arrays[name] for name in PATCHES})


@checked
def agard445_mode(
    points: Float[Any, "m 3"] | list[list[float]], mode: int, amplitude: Float[ArrayLike, ""] = 1.0
) -> Float[Any, "m 3"]:
    """Displaces points of the wing by its first (bending) or second (torsion) mode, in metres.

    The displacement is along z alone. The tip's trailing edge moves up; the published sign of mode
    2, up at the tip's leading edge, is the opposite.

    The shape is sum a_ij eta^i xi^j, i = 2..6, j = 0..3, with eta along the span and xi along the
    chord from 0 to 1. Value and slope vanish at the root. The a_ij are least squares to the 121
    deflections of NASA TM-100492 (Yates, 1987), 1 at the tip's trailing edge. In that unit the root
    mean square of what is left, off the root, is 0.0007 in mode 1 and 0.0042 in mode 2. Most of it
    is next to the aft end of the root, which is free in the table: 0.0028 and 0.033 at a tenth of
    the span, 0.0037 and 0.043 at the root itself. It is a polynomial off the wing too.

    **Arguments:**

    - `points`: positions (m, 3) in metres, as `agard445` has them, from NumPy or JAX.
    - `mode`: 1 (bending) or 2 (torsion).
    - `amplitude`: displacement of the tip's trailing edge, in semi-spans of 0.762 m. Default 1.

    **Returns:** displacements (m, 3) in metres, of NumPy or JAX as the points are.

    **Raises:** `ValueError` for another mode, and for points that are not (m, 3).
    """
    if mode not in DEFLECTIONS:
        raise ValueError(f"`mode` is {mode!r}; there are modes {', '.join(map(str, DEFLECTIONS))}.")
    places: Any = points if hasattr(points, "dtype") else np.asarray(points, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3:
        raise ValueError(f"`points` has shape {tuple(places.shape)}; expected (m, 3).")
    if is_known(amplitude):
        between("amplitude", amplitude)
    upwards = np.array([0, 0, 1], dtype=places.dtype)
    return (amplitude * wing.SEMI_SPAN * mode_shape(places, mode))[:, None] * upwards[None]


# What gmsh's shared library links to, and the Debian or Ubuntu package that has it.
SYSTEM_PACKAGES = {
    "libGLU.so.1": "libglu1-mesa",
    "libGL.so.1": "libgl1",
    "libXrender.so.1": "libxrender1",
    "libXcursor.so.1": "libxcursor1",
    "libXfixes.so.3": "libxfixes3",
    "libXext.so.6": "libxext6",
    "libXft.so.2": "libxft2",
    "libXinerama.so.1": "libxinerama1",
    "libX11.so.6": "libx11-6",
    "libfontconfig.so.1": "libfontconfig1",
    "libgomp.so.1": "libgomp1",
}


def _import_gmsh() -> ModuleType:
    try:
        import gmsh
    except ImportError as error:
        raise ImportError("`cases.agard445` needs gmsh: pip install 'jaxmorph[cases]'.") from error
    except OSError as error:
        missing = [package for library, package in SYSTEM_PACKAGES.items() if library in str(error)]
        packages = " ".join(missing or SYSTEM_PACKAGES.values())
        raise ImportError(
            f"gmsh is installed, but a library that it needs is not ({error}). On Debian or Ubuntu: "
            f"apt-get install {packages}."
        ) from error
    return gmsh


def _user_cache() -> Path:
    try:
        import platformdirs
    except ImportError as error:
        raise ImportError(
            "`cases.agard445` needs platformdirs to find the user's cache directory: pip install 'jaxmorph[cases]'; "
            "or give `cache_directory`."
        ) from error
    return platformdirs.user_cache_path("jaxmorph")


def _file_name(points: int, gmsh_version: str) -> str:
    shape = (wing.STATIONS, wing.HALF_THICKNESS, wing.LEADING_EDGE_RADIUS, wing.ROOT_CHORD, wing.TIP_CHORD)
    shape += (wing.SEMI_SPAN, wing.TIP_LEADING_EDGE, RADIUS, CENTRE, CONTOUR_INTERVALS, DISTANCE_SAMPLES)
    parameters = repr((REVISION, RESOLUTIONS[points], shape, sorted(OPTIONS.items())))
    return f"agard445-{points}-gmsh{gmsh_version}-{hashlib.sha256(parameters.encode()).hexdigest()[:12]}.npz"


def _load(file: Path) -> dict[str, np.ndarray] | None:
    """Reads the arrays of a file of `_store`; None for no file or a damaged file."""
    if not zipfile.is_zipfile(file):
        return None
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in ("points", "tetra", *PATCHES)}
        jm.Mesh(arrays["points"], {"tetra": arrays["tetra"]}, {name: arrays[name] for name in PATCHES})
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error):
        return None
    return arrays


def _store(file: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes the whole file or nothing; warns if the directory refuses it."""
    content: dict[str, Any] = dict(arrays)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with complete(file) as partial, partial.open("wb") as stream:
            np.savez_compressed(stream, **content)
    except OSError as error:
        warn(f"the mesh could not be kept in {file.parent} and will be made again: {error}.")
