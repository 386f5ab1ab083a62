"""Windows, cameras, bars, legends, axes and scales of pictures in 3-D."""

import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ._cells import MaxNLocator, TextPath, findfont
from ._style import DARK

VIEWER = -1.0, -2.5, 1.8
"""The direction towards the viewer: x right, y away, z up; mirrored for an open surface."""

AIMED: weakref.WeakKeyDictionary[Any, tuple[Any, Any]] = weakref.WeakKeyDictionary()
"""The view that `aim` gave each plotter, and its direction."""

WINDOW = 1200, 900
"""Width of a picture in pixels, and its largest height."""

TEXT = 30
"""Height of letters in pixels."""

ALONG = 0.97
"""Cosine between an axis and the view from which the axis is a point, and has no name."""

EDGE, BELOW, LEGEND, BAR = 0.025, 0.13, 0.06, 0.25
"""Margins relative to width: sides; below for axes, scale; above a legend; right a colour bar."""


def add_bar(plotter: Any, label: str, limits: tuple[float | int, float | int], beyond: dict[str, str]) -> None:
    """Draws a colour bar with round numbers at the right.

    `_add_axes` places it above the bar of a length.
    """
    title = label.replace("|", "\u2223")  # VTK begins a column at an ASCII bar
    bar = plotter.add_scalar_bar(f"{title}\n", vertical=True, fmt="%.6g", color=DARK, width=0.05, **beyond)
    bar.SetUnconstrainedFontSize(True)
    ticks = np.asarray(MaxNLocator(6, steps=(1, 2, 2.5, 5, 10)).tick_values(*limits))
    bar.SetUseCustomLabels(True)
    bar.SetCustomLabels(pyvista().convert_array(ticks[(limits[0] <= ticks) & (ticks <= limits[1])]))
    bar.SetTextPad(8)
    for text in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty(), bar.GetAnnotationTextProperty()):
        text.SetFontSize(TEXT)
        _in_font(text)


def _in_font(text: Any) -> None:
    """Sets text in the font of the pictures in 2-D."""
    text.SetFontFamily(4)  # VTK's number for a font from a file
    text.SetFontFile(findfont("DejaVu Sans"))
    text.SetBold(False)
    text.SetItalic(False)
    text.SetShadow(False)


def new_plotter() -> Any:
    with pyvista().vtk_verbosity("off"):  # VTK complains where there is no display, and draws anyway
        plotter = pyvista().Plotter(off_screen=True, window_size=WINDOW)
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")  # with samples for each pixel, VTK draws nothing of what it peels
    _add_axes(plotter)
    return plotter


def _add_axes(plotter: Any) -> None:
    """Draws the directions of x, y and z, and a bar of a round length: both follow the camera.

    In perspective no bar.
    """
    axes = plotter.add_axes(xlabel="x", ylabel="y", zlabel="z", color=DARK, line_width=3)
    captions = [getattr(axes, f"Get{name}AxisCaptionActor2D")() for name in "XYZ"]
    for caption in captions:
        caption.GetTextActor().SetTextScaleModeToNone()
        caption.GetCaptionTextProperty().SetJustificationToCentered()
        caption.GetCaptionTextProperty().SetVerticalJustificationToCentered()
    axes.SetNormalizedLabelPosition(1.4, 1.4, 1.4)  # off the arrows
    scale = _scale()
    texts = [scale.GetTitleTextProperty(), *(caption.GetCaptionTextProperty() for caption in captions)]
    for text in texts:
        _in_font(text)
    plotter.renderer.AddViewProp(scale)

    def fit(*_: Any) -> None:
        width, height = plotter.window_size
        seen = 2 * plotter.camera.parallel_scale * width / height
        length = _round_length(0.2 * seen)
        ends = (scale.GetPositionCoordinate(), 0.97 - length / seen), (scale.GetPosition2Coordinate(), 0.97)
        for coordinate, x in ends:
            coordinate.SetCoordinateSystemToNormalizedViewport()
            coordinate.SetValue(x, 0.075 * width / height)
        low = (BELOW + EDGE) * width / height
        for bar in plotter.scalar_bars.values():
            bar.SetPosition(1 - 0.6 * BAR, low)
            bar.SetHeight(min(0.93 - low, 0.6 * WINDOW[1] / height))
        scale.SetTitle(f"{length:g}")
        scale.SetVisibility(bool(plotter.camera.parallel_projection))
        plotter.renderer.axes_widget.SetViewport(-0.075, -0.105 * width / height, 0.163, 0.133 * width / height)
        for text in texts:
            text.SetFontSize(round(TEXT * width / WINDOW[0]))
        for name, along in zip("xyz", plotter.camera.direction, strict=True):
            getattr(axes, f"Set{name.upper()}AxisLabelText")(name if abs(along) < ALONG else "")

    plotter.renderer.AddObserver("StartEvent", fit)


def _scale() -> Any:
    """Makes the bar of a round length, without numbers."""
    from vtkmodules.vtkRenderingAnnotation import vtkAxisActor2D

    scale = vtkAxisActor2D()
    scale.SetNumberOfLabels(2)
    scale.AdjustLabelsOff()
    scale.LabelVisibilityOff()
    scale.GetProperty().SetColor(pyvista().Color(DARK).float_rgb)
    scale.GetProperty().SetLineWidth(3)
    scale.UseFontSizeFromPropertyOn()
    scale.GetTitleTextProperty().SetColor(pyvista().Color(DARK).float_rgb)
    return scale


def _round_length(largest: float) -> float:
    """Returns the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10 ** np.floor(np.log10(largest))
    return float(power * max(factor for factor in (1, 2, 5) if factor * power <= largest * (1 + 1e-9)))


def aim(plotter: Any, viewer: Sequence[float] | np.ndarray = VIEWER, shown: np.ndarray | None = None) -> None:
    """Turns the camera to points, by default all drawn, and gives the window their shape."""
    shown = content(plotter) if shown is None else shown
    plotter.window_size = fitted_window(plotter, shown, viewer)
    set_view(plotter, whole_view(shown, plotter.window_size, viewer, margins(plotter)))
    AIMED[plotter] = view_of(plotter), viewer


def aim_again(plotter: Any) -> None:
    """Makes room for what was added to a plotter, unless its camera is not where `aim` left it."""
    view, viewer = AIMED.get(plotter, (None, VIEWER))
    if view is not None and np.array_equal(view, view_of(plotter)):
        aim(plotter, viewer)


def fitted_window(
    plotter: Any, points: Float[np.ndarray, "k 3"], viewer: Sequence[float] | np.ndarray
) -> tuple[int, int]:
    """Chooses width and height in pixels of a picture of points, so that little is white."""
    (width, height), (left, right, below, above) = (
        np.ptp(points @ np.stack(view_axes(viewer)[1:]).T, axis=0),
        margins(plotter),
    )
    tall = (1 - left - right) * height / max(width, 1e-9 * height) + below + above
    return WINDOW[0], round(float(np.clip(tall * WINDOW[0], WINDOW[1] / 2, WINDOW[1])))


def content(plotter: Any) -> Float[np.ndarray, "k 3"]:
    """Returns the points of all that was drawn."""
    return np.concatenate([np.asarray(mesh.points, dtype=float) for mesh in plotter.meshes])


def margins(plotter: Any) -> tuple[float, float, float, float]:
    """Returns what is left free at the left and right, below and above, relative to the width."""
    has_legend = any(name.startswith("legend") for name in plotter.actors)
    return EDGE, BAR if len(plotter.scalar_bars) else EDGE, BELOW, LEGEND if has_legend else EDGE


def whole_view(
    points: Float[np.ndarray, "k 3"],
    window: Sequence[int],
    viewer: Sequence[float] | np.ndarray = VIEWER,
    free: tuple[float, float, float, float] = (EDGE, EDGE, BELOW, EDGE),
) -> Float[np.ndarray, " 10"]:
    """Places a camera: its position, what it looks at, upwards, half the height that it sees.

    It has no perspective. All points are in a window of this width and height, within the margins
    that are left free.
    """
    axes, tall = np.stack(view_axes(viewer)), window[1] / window[0]
    seen, (left, right, below, above) = points @ axes.T, free
    low, high = seen.min(axis=0), seen.max(axis=0)
    depth, width, height = high - low
    scale = max(width / (1 - left - right), height / (tall - below - above))  # length across the window
    beside = np.array([0, (right - left) / 2, (above - below) / 2]) * scale
    middle = ((low + high) / 2 + beside) @ axes
    distance = 2 * (depth + width + height)
    return np.array([*(middle + distance * axes[0]), *middle, *axes[2], scale * tall / 2])


def view_of(plotter: Any) -> Float[np.ndarray, " 10"]:
    """Returns the view (10,) of the plotter's camera as it is now."""
    return np.array([*np.ravel(list(plotter.camera_position)), plotter.camera.parallel_scale])


def set_view(plotter: Any, view: Float[np.ndarray, " 10"], is_parallel: bool = True) -> None:
    plotter.camera_position = [tuple(vector) for vector in view[:9].reshape(3, 3).tolist()]
    plotter.camera.parallel_projection, plotter.camera.parallel_scale = is_parallel, float(view[9])
    plotter.renderer.reset_camera_clipping_range()


def view_axes(viewer: Sequence[float] | np.ndarray = VIEWER) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns unit vectors to the viewer, right, and up in the picture: z, or y seen along z."""
    towards = np.array(viewer) / np.linalg.norm(viewer)
    across = np.cross((0, 0, 1) if abs(towards[2]) < 0.99 else (0, 1, 0), towards)
    across /= np.linalg.norm(across)
    return towards, across, np.cross(towards, across)


def add_legend(plotter: Any, entries: Sequence[tuple[str, str]]) -> None:
    """Writes names, each in its colour, in a row above the picture."""
    place = EDGE
    for k, (name, colour) in enumerate(entries):
        text = plotter.add_text(name, color=colour, viewport=True, name=f"legend {k}", position=(place, 0.0))
        text.prop.SetFontSize(TEXT)
        text.prop.SetVerticalJustificationToTop()
        text.SetPosition(place, 0.985)
        _in_font(text.prop)
        place += (TextPath((0, 0), name, size=TEXT).get_extents().width + TEXT) / WINDOW[0]


def pyvista() -> Any:
    """Imports the package; the `ImportError` names what to install."""
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in 3-D need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista
