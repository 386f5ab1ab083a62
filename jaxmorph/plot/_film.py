"""Films of a moving mesh, as GIF or MP4."""

import os
import pathlib
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from jaxmorph._host.package.arguments import checked, finite_array, whole
from jaxmorph._host.package.files import complete, output_path

from ._cells import Axes, plt
from ._view import content, fitted_window, margins, set_view, view_of, whole_view

Picture = UInt8[np.ndarray, "h w 3"]


@checked
def swing(points: Float[Any, "n d"], extreme: Float[Any, "n d"], *, frames: int = 24) -> Float[np.ndarray, "f n d"]:
    """Computes a period of a mode: nodes go to `extreme` and back through it, as a sine of time.

    `deform` is linear in the displacement, so these are the meshes of the mode at each amplitude.

    **Arguments:**

    - `points`: undeformed points (n, d).
    - `extreme`: points (n, d) at the largest displacement, as `deform` returns them.
    - `frames`: meshes in a period, 2 or more. Default 24.

    **Returns:** points (frames, n, d), for `animate`.

    **Raises:** `ValueError` where the shapes differ, and for fewer than 2 frames.
    """
    points = finite_array("points", points, (None, 2), (None, 3))
    extreme = finite_array("extreme", extreme, points.shape)
    whole("frames", frames, 2)
    phases = np.sin(2 * np.pi * np.arange(frames) / frames)
    return points + phases[:, None, None] * (extreme - points)


@checked
def animate(
    path: str | os.PathLike,
    draw: Callable[[Float[np.ndarray, "n d"]], Any],
    frames: Float[Any, "f n d"] | Sequence[Float[Any, "n d"]],
    *,
    rate: float | int = 12,
) -> pathlib.Path:
    """Makes a film of a mesh that moves, one picture for each frame.

    An example is `animate("mode.gif", lambda points: plot.surface(mesh, points, patch="wing"),
    plot.swing(mesh.points, extreme))`. All frames are seen as the first frame is, with room for the
    other frames unless `draw` is given a window or places the camera. The size is that of the first
    figure or of the first plotter's window. A `.gif` repeats for ever and needs nothing more; a
    `.mp4` needs ffmpeg, the system's or imageio-ffmpeg's.

    **Arguments:**

    - `path`: the file to write, ending in .gif or .mp4.
    - `draw`: makes the picture of points (n, d), and returns its axes or its plotter, as all
      pictures here do.
    - `frames`: points (n, d) at successive times, as `swing` or `march` give them; 2 or more.
    - `rate`: frames a second. Default 12.

    **Returns:** the path of the file, which is there whole or not at all.

    **Raises:** `ValueError` for another ending, a folder that is not there, and a rate that is not
    positive. Also for fewer than 2 frames, or frames of different shapes. `ImportError` for what is
    missing.
    """
    path = output_path(path, ".gif", ".mp4")
    frames = [np.asarray(points) for points in frames]
    shapes = sorted({points.shape for points in frames})
    if len(frames) < 2 or len(shapes) > 1 or len(shapes[0]) != 2:
        raise ValueError(f"`frames` should be 2 or more of one shape (n, d); found {len(frames)} of shapes {shapes}.")
    if not 0 < rate < np.inf:
        raise ValueError(f"`rate` is in frames a second, not {rate}.")
    write = _gif if path.suffix.lower() == ".gif" else _mp4()
    drawn = draw(frames[0])
    view = _view(drawn, draw, frames)
    pictures = [_picture(drawn, view), *(_picture(draw(points), view) for points in frames[1:])]
    with complete(path) as partial:
        write(partial, pictures, rate)
    return path


def _view(first: Any, draw: Callable, frames: list[np.ndarray]) -> Any:
    """Chooses the view of all frames: the first one's, with room for the farthest nodes."""
    if isinstance(first, Axes):
        ends = [_ends(first), *(_ends(axes) for axes in _farthest(draw, frames))]
        way = np.sign(ends[0][:, 1] - ends[0][:, 0])[:, None]  # an axis may be turned round
        low, high = (way * choose([way * each for each in ends], axis=0) for choose in (np.min, np.max))
        figure: Any = first.get_figure(root=True)
        return np.column_stack([low[:, 0], high[:, 1]]), figure.get_size_inches(), figure.dpi
    if not hasattr(first, "screenshot"):
        raise ValueError(f"`draw` should return the axes or the plotter that it drew on, not {type(first).__name__}.")
    view, window = view_of(first), first.window_size
    viewer, fitted = view[:3] - view[3:6], fitted_window(first, content(first), view[:3] - view[3:6])
    if not any(
        np.allclose(view, whole_view(content(first), size, viewer, margins(first))) for size in (fitted, window)
    ):
        return view, first.camera.parallel_projection, window  # `draw` placed the camera
    every = np.concatenate([content(first), *(content(other) for other in _farthest(draw, frames))])
    window = fitted_window(first, every, viewer) if tuple(window) == fitted else window
    return whole_view(every, window, viewer, margins(first)), True, window


def _ends(axes: Axes) -> np.ndarray:
    """Returns where the axes of x and y begin and end (2, 2)."""
    return np.array([axes.get_xlim(), axes.get_ylim()])


def _farthest(draw: Callable, frames: list[np.ndarray]) -> Iterator[Any]:
    """Draws the frames whose nodes are the farthest from those of the first, and closes each."""
    away = np.stack([points - frames[0] for points in frames])
    for k in sorted({*away.max(axis=1).argmax(axis=0).tolist(), *away.min(axis=1).argmin(axis=0).tolist()} - {0}):
        drawn = draw(frames[k])
        yield drawn
        _close(drawn)


def _close(drawn: Any) -> None:
    if isinstance(drawn, Axes):
        plt.close(drawn.get_figure(root=True))
    else:
        drawn.close()


def _picture(drawn: Any, view: Any) -> Picture:
    """Returns the pixels of what was drawn, and closes it."""
    if isinstance(drawn, Axes):
        (xlim, ylim), size, dpi = view
        drawn.set(xlim=xlim, ylim=ylim)
        figure: Any = drawn.get_figure(root=True)
        figure.set(dpi=dpi, size_inches=size)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())
    else:
        *camera, drawn.window_size = view
        set_view(drawn, *camera)
        pixels = np.asarray(drawn.screenshot(return_img=True))
    pixels = pixels[..., :3].copy()
    _close(drawn)
    return pixels


def _gif(path: pathlib.Path, pictures: list[Picture], rate: float | int) -> None:
    """Writes a GIF with one palette for all frames, so that what does not move does not flicker."""
    from PIL import Image  # comes with matplotlib

    some = np.concatenate(pictures[:: max(1, len(pictures) // 6)])
    palette = Image.fromarray(some).quantize(256, Image.Quantize.FASTOCTREE)
    images = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = round(100 / rate) * 10  # in a GIF time goes by hundredths of a second
    images[0].save(path, save_all=True, append_images=images[1:], duration=max(20, duration), loop=0, optimize=True)


def _mp4() -> Callable[[pathlib.Path, list[Picture], float], None]:
    """Finds the system's ffmpeg, or imageio-ffmpeg's, and returns the writer of an MP4."""
    program = shutil.which("ffmpeg")
    if program is None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe
        except ImportError as error:
            raise ImportError("MP4 needs ffmpeg: pip install imageio-ffmpeg; a .gif needs nothing more") from error
        program = get_ffmpeg_exe()

    def write(path: pathlib.Path, pictures: list[Picture], rate: float | int) -> None:
        height, width = (size // 2 * 2 for size in pictures[0].shape[:2])  # the codec takes even sizes alone
        source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {rate} -i -".split()
        codec = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"]
        pixels = b"".join(np.ascontiguousarray(picture[:height, :width]).data for picture in pictures)
        command = [program, "-y", "-loglevel", "error", *source, *codec, str(path)]
        done = subprocess.run(command, input=pixels, capture_output=True, check=False)
        if done.returncode:
            raise OSError(f"ffmpeg failed: {done.stderr.decode(errors='replace').strip()}")

    return write
