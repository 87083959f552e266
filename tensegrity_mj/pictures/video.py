"""Videos and pictures of runs, off-screen: any engine's trajectory, drawn from its node positions alone.

For example:

    tmj.render(run, "prism.mp4")                                          # one run
    tmj.render(run, "both.mp4", other=reference)                          # the other as a ghost over it
    tmj.render(run, "both.mp4", other=reference, layout=tmj.pictures.Layout.SIDE_BY_SIDE)
    tmj.pictures.picture(scene, "prism.png")                              # a scene as it stands at its start
    tmj.pictures.still(run, "prism.png", 1.5, dpi=300)                    # transparent, for a paper
"""

from __future__ import annotations

import base64
import contextlib
import io
import math
import mimetypes
import os
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import MissingLibraryError, OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures import figure, motion, opengl
from tensegrity_mj.pictures.stage import Stage
from tensegrity_mj.pictures.view import MIN_SIZE, Layout, Quality, View, ViewOptions
from tensegrity_mj.runs.trajectory import Trajectory

Image = NDArray[np.uint8]

MAX_FRAMES = 500_000
MAX_GIF_RATE = 50.0  # frames a second: a frame lasts whole hundredths of one, and viewers slow down those of one
# Codec and arguments of ffmpeg by the file's ending.
ENCODERS = {
    # faststart: a browser shows the video while it still loads. veryfast: encoding takes less time than drawing.
    ".mp4": ("h264", "-preset veryfast -movflags +faststart"),
    ".webm": ("vp9", "-deadline realtime -cpu-used 6 -row-mt 1"),
    ".gif": ("gif", ""),
}
FILMS = tuple(ENCODERS)


def render(
    run: Trajectory,
    path: str | os.PathLike[str],
    *,
    other: Trajectory | None = None,
    layout: Layout = Layout.OVERLAY,
    fps: float = 30.0,
    speed: float = 1.0,
    progress: bool = False,
    **view: Unpack[ViewOptions],
) -> Path:
    """Write a film of a run, or of two runs in one picture; returns its path, which notebooks show.

    Rods are capsules; taut strings have the colour of their tension; slack ones hang as arcs of their own length; dark
    cubes are fixed; the target is a translucent ghost; lines show where nodes have been. Frames stand at exact
    multiples of speed / fps in simulated time, interpolated with the recorded velocities. The camera frames all of the
    run, comes nearer where a structure settles, and follows one that travels far. On a floor members have shadows. The
    file appears whole or not at all.

    A scene with water shows it around the structure: the surface at its elevation at the frame's time, with a grid on
    it, and what is under it tinted; a bottom that is near. It is seen from the side, waves passing to the right.

    Args:
        path: ends in .mp4 (H.264), .webm (VP9) or .gif (of at most 50 frames a second; some ten times as large).
        other: a second run: translucent over the first, or beside it, as `layout` says.
        fps: frames a second of the video.
        speed: simulated seconds a second of the video.
        progress: show a bar on stderr, if that is a terminal, or below the cell of a notebook.
        view: size (even, H.264 needs it), traces, target, azimuth, elevation, distance, quality (`Quality.FAST` halves
            the drawing time), text and thickness, see `View`.

    Raises:
        OptionError: an option that cannot be met, an empty trajectory, a file that cannot be written.
        MissingLibraryError: no OpenGL or no ffmpeg on this machine; the message says what to install.
    """
    destination = checked(path, FILMS, "video")
    shown = View(**view)
    if destination.suffix.lower() == ".gif" and fps > MAX_GIF_RATE:
        raise OptionError(f"fps={fps:g}: a .gif has at most {MAX_GIF_RATE:g} frames a second; use fewer, or .webm")
    if shown.size[0] % 2 or shown.size[1] % 2:
        raise OptionError(
            f"size={shown.size}: width and height of a video must be even (H.264 stores colours by 2 x 2 pixels)"
        )
    films = [motion.Motion.of(run)] + ([] if other is None else [motion.Motion.of(other)])
    times = frame_times(min(m.start for m in films), max(m.end for m in films), fps, speed)
    with Stage(films[0], films[-1] if films[1:] else None, layout, shown) as stage, replacing(destination) as part:
        _encode(stage, times, part, fps, progress)
    return ShownFile(destination)


def frames(
    run: Trajectory,
    *,
    other: Trajectory | None = None,
    layout: Layout = Layout.OVERLAY,
    fps: float = 30.0,
    speed: float = 1.0,
    **view: Unpack[ViewOptions],
) -> Iterator[Image]:
    """The frames (H, W, 3) of `render`'s video one by one, for other uses; each is a new array.

    Raises:
        OptionError, MissingLibraryError: as `render`.
    """
    with _stage(run, other, layout, view) as stage:
        for time in frame_times(stage.start, stage.end, fps, speed):
            yield stage.frame(time).copy()


def render_frame(
    source: Trajectory | Scene,
    time: float | None = None,
    *,
    other: Trajectory | None = None,
    layout: Layout = Layout.OVERLAY,
    **view: Unpack[ViewOptions],
) -> Image:
    """One picture (H, W, 3) of a run at `time` [s] (its end by default), or of a scene at its start.

    Arguments are those of `render`.

    Raises:
        OptionError: a time outside the run, or what `render` refuses.
        MissingLibraryError: no OpenGL.
    """
    with _stage(source, other, layout, view) as stage:
        return stage.frame(stage.moment(time)).copy()


def picture(
    source: Trajectory | Scene,
    path: str | os.PathLike[str],
    time: float | None = None,
    *,
    other: Trajectory | None = None,
    layout: Layout = Layout.OVERLAY,
    **view: Unpack[ViewOptions],
) -> Path:
    """Write one picture of `render_frame` as PNG, of the best quality where no other is given; returns its path.

    Raises:
        OptionError, MissingLibraryError: as `render_frame`; also for a path that cannot be written.
    """
    destination = checked(path, (".png",), "picture")
    view.setdefault("quality", Quality.BEST)
    return _saved(render_frame(source, time, other=other, layout=layout, **view), destination)


def png_of(scene: Scene) -> bytes | None:
    """A scene at its start as PNG, for notebooks; None where none can be drawn, for want of OpenGL for instance."""
    from PIL import Image as PillowImage

    try:
        pixels = render_frame(scene, size=(640, 400))
    except (OptionError, MissingLibraryError):
        return None
    stream = io.BytesIO()
    PillowImage.fromarray(pixels).save(stream, "png")
    return stream.getvalue()


def still(
    source: Trajectory | Scene,
    path: str | os.PathLike[str],
    time: float | None = None,
    *,
    dpi: float = 300.0,
    other: Trajectory | None = None,
    **view: Unpack[ViewOptions],
) -> Path:
    """Write one picture for a paper as PNG: transparent, without text and traces, cut to what shows; returns its path.

    Args:
        time: [s]; the run's end by default.
        dpi: dots an inch, which the file states; without a size the whole picture is 181 mm wide, 16 to 9.
        other: a second run, translucent over the first.
        view: as `render`.

    Raises:
        OptionError: a time outside the run, dots for more pixels than can be drawn, a path that cannot be written.
        MissingLibraryError: no OpenGL.
    """
    destination = checked(path, (".png",), "still")
    if not (math.isfinite(dpi) and dpi > 0.0):
        raise OptionError(f"dpi={dpi!r}: it must be a finite number > 0")
    wide = round(figure.WIDTHS[2] * dpi / 16.0) * 16
    options: ViewOptions = {"size": (wide, wide * 9 // 16), "quality": Quality.BEST, "traces": False}
    options |= {**view, "text": False}
    if "size" not in view and not MIN_SIZE <= options["size"][1] <= options["size"][0] <= opengl.MAX_SIZE:
        raise OptionError(f"dpi={dpi:g}: a width of 181 mm has {wide} pixels; at most {opengl.MAX_SIZE} can be drawn")
    with _stage(source, other, Layout.OVERLAY, options) as stage:
        pixels = stage.cut_out(stage.moment(time))
    seen = np.argwhere(pixels[..., 3] > 0)
    if len(seen):
        (top, left), (bottom, right) = seen.min(axis=0), seen.max(axis=0) + 1
        pixels = pixels[top:bottom, left:right]
    return _saved(pixels, destination, dpi=(dpi, dpi))


def _stage(source: Trajectory | Scene, other: Trajectory | None, layout: Layout, view: ViewOptions) -> Stage:
    return Stage(motion.Motion.of(source), None if other is None else motion.Motion.of(other), layout, View(**view))


def _saved(pixels: Image, destination: Path, **more: Any) -> Path:
    from PIL import Image as PillowImage

    with replacing(destination) as part:
        PillowImage.fromarray(pixels).save(part, optimize=True, **more)
    return ShownFile(destination)


MOST_EMBEDDED = 30_000_000  # bytes of a file that a notebook gets into itself

if TYPE_CHECKING:
    _Path = Path
else:
    _Path = type(Path())  # before Python 3.12 only the system's own kind can be inherited from


class ShownFile(_Path):
    """The path of a video or a picture, which a notebook shows."""

    def _repr_html_(self) -> str:
        kind = mimetypes.guess_type(self.name)[0] or ""
        with contextlib.suppress(OSError):  # it is gone
            if kind.startswith(("video/", "image/")) and self.stat().st_size <= MOST_EMBEDDED:
                source = f'src="data:{kind};base64,{base64.b64encode(self.read_bytes()).decode()}"'
                return f"<video controls loop {source}></video>" if kind.startswith("video/") else f"<img {source}>"
        return f"<code>{escape(str(self))}</code>"


def frame_times(start: float, end: float, fps: float, speed: float) -> NDArray[np.float64]:
    """Simulated times [s] of a video's frames: every speed / fps from the start, up to the end.

    Raises:
        OptionError: a rate that is not finite and > 0, or more than half a million frames.
    """
    for name, value in (("fps", fps), ("speed", speed)):
        if not (isinstance(value, (int, float, np.number)) and math.isfinite(value) and value > 0.0):
            raise OptionError(f"{name}={value!r}: it must be a finite number > 0")
    count = (end - start) * fps / speed
    if count > MAX_FRAMES:
        raise OptionError(
            f"fps={fps} at speed={speed} makes {count:.3g} frames of {end - start:g} s; at most {MAX_FRAMES} are "
            "drawn: choose a higher speed or fewer frames a second"
        )
    # The end itself counts where it falls on a frame but for round-off.
    frame = np.arange(math.floor(count + 1e-6) + 1, dtype=np.float64)
    return start + frame * (speed / fps)


def ffmpeg_program() -> str:
    """Path of the ffmpeg to use: IMAGEIO_FFMPEG_EXE where it is set, else the one that imageio-ffmpeg brings.

    Raises:
        MissingLibraryError: if there is none.
    """
    import imageio_ffmpeg

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise MissingLibraryError(
            f"video needs ffmpeg, which was not found ({error}): reinstall it with python -m pip install "
            "--force-reinstall imageio-ffmpeg, or set IMAGEIO_FFMPEG_EXE to an ffmpeg of yours"
        ) from error


def _encode(stage: Stage, times: NDArray[np.float64], path: Path, fps: float, progress: bool) -> None:
    """Draw every frame and have ffmpeg encode it."""
    import mediapy

    program = ffmpeg_program()
    mediapy.set_ffmpeg(program)
    width, height = stage.view.size
    codec, arguments = ENCODERS[path.suffixes[-1].lower() if path.suffixes else ".mp4"]
    crf = {"h264": 20, "vp9": 32, "gif": None}[codec]
    writer = mediapy.VideoWriter(path, (height, width), codec=codec, fps=fps, crf=crf, ffmpeg_args=arguments)
    try:
        writer.__enter__()
        try:
            with bar(progress, "video", total=len(times), unit="frame") as shown:
                for time in times:
                    writer.add_image(stage.frame(time))
                    shown.update()
        except BaseException:
            # ffmpeg may have been interrupted too: what it says about it must not hide the reason.
            with contextlib.suppress(Exception):
                writer.close()
            raise
        writer.close()
    except (OSError, RuntimeError) as error:
        if isinstance(error, (OptionError, MissingLibraryError)):
            raise
        raise OptionError(
            f"video of {width} x {height} at {fps:g} frames a second: {program} could not write it ({error}); check "
            "that the disk has room and that this ffmpeg encodes H.264"
        ) from error
