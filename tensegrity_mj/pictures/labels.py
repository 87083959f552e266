"""The text around a picture: title, names, time, tension scale, what the colours mean, axes. Drawn with Pillow."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tensegrity_mj.basics.units import power_of, unit_with
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.camera import Camera

Font = Any  # ImageFont.FreeTypeFont, or Pillow's own where matplotlib's fonts are missing
Name = tuple[str, palette.Color, str]  # a run's line in the header: its engine, how it is drawn, what went wrong
Symbol = Callable[[ImageDraw.ImageDraw, int, int], None]  # draws itself, so wide and so tall
FINE = 4  # small symbols are drawn this much larger and shrunk, which smooths their edges


class Labels:
    """Places text on a picture of a given size; what does not fit is left out or shortened.

    Attributes:
        readable: whether there is room for letters; else there is to be no text at all.
        header, footer: heights [px] that the picture itself must leave free.
    """

    def __init__(self, width: int, height: int, columns: int, lines: int) -> None:
        self.width, self.height = width, height
        self.unit = min(height / 720.0, width / max(1000.0, 800.0 * columns))
        # Below some 9 px nothing can be read.
        self.readable = 15.0 * self.unit >= 5.9
        self.size = max(9, round(15 * self.unit))
        self.large = max(11, round(23 * self.unit))
        self.pad = max(4, round(18 * self.unit))
        self.line = round(1.45 * self.size)
        self.header = self.pad + round(1.35 * self.large) + lines * self.line + self.pad // 3
        self.footer = round(2.2 * self.size) + self.pad + self.line
        self._clock_left: int | None = None

    def blank(self) -> Image.Image:
        """An empty picture."""
        return Image.new("RGB", (self.width, self.height), palette.to_bytes(palette.BACKGROUND))

    def title(self, picture: Image.Image, text: str, room_for: str) -> None:
        """The title at the top left; at its right stays room for a text such as the longest time."""
        font = _font(self.large, bold=True)
        room = self.width - 3 * self.pad - _width(font, room_for)
        ImageDraw.Draw(picture).text(
            (self.pad, self.pad), _shortened(text, font, room), font=font, fill=palette.to_bytes(palette.TEXT)
        )

    def names(self, picture: Image.Image, names: Sequence[Name], left: int, right: int) -> None:
        """One name a line under the title, between two columns of pixels."""
        draw = ImageDraw.Draw(picture)
        font = _font(self.size)
        for row, (name, color, warning) in enumerate(names):
            y = self.pad + round(1.35 * self.large) + row * self.line
            x = left + self.pad
            if len(names) > 1:
                thick = max(3, round(0.4 * self.size))
                middle = y + round(0.62 * self.size)
                place = (x, middle - thick // 2, x + 2 * self.size, middle + thick // 2)
                draw.rectangle(place, fill=palette.to_bytes(color))
                x += 2 * self.size + self.pad // 2
            note = f"  {warning}" if warning else ""
            room = right - x - self.pad - _width(font, note)
            text = _shortened(name, font, room)
            draw.text((x, y), text, font=font, fill=palette.to_bytes(palette.FAINT_TEXT))
            if note:
                shift = _width(font, text)
                draw.text((x + shift, y), note, font=font, fill=palette.to_bytes(palette.WARNING))

    def clock(self, frame: NDArray[np.uint8], text: str) -> None:
        """The time at the top right, written into the frame (H, W, 3) in place of the last one."""
        # Letter by letter from memory, which is ten times as fast as Pillow; digits are equally wide in this font.
        patch = np.concatenate([_letter(self.large, letter) for letter in text], axis=1)
        tall, wide = patch.shape[:2]
        right, top = self.width - self.pad, self.pad
        left = max(0, right - wide)
        if self._clock_left is not None and self._clock_left < left:
            frame[top : top + tall, self._clock_left : left] = palette.to_bytes(palette.BACKGROUND)
        frame[top : top + tall, left:right] = patch[:, wide - (right - left) :]
        self._clock_left = left

    def legend(
        self, picture: Image.Image, tension: palette.TensionScale | None, words: Sequence[str], camera: Camera
    ) -> None:
        """The footer: axes, tension scale, and the meaning of what else is drawn, each beginning as in `SYMBOLS`."""
        draw = ImageDraw.Draw(picture)
        font = _font(self.size)
        x = self._axes(picture, camera) + self.pad
        top = self.height - self.footer + round(0.2 * self.size)
        if tension is not None:
            x = self._scale(picture, tension, x, top) + round(1.6 * self.pad)
        wide, tall = 2 * self.size, self.size
        for text in words:
            if x + wide + self.pad // 2 + _width(font, text) > self.width - self.pad:
                break
            _paste(picture, SYMBOLS[text.split()[0]], x, top + round(0.35 * self.size), wide, tall)
            x += wide + round(0.4 * self.size)
            draw.text((x, top + round(0.2 * self.size)), text, font=font, fill=palette.to_bytes(palette.FAINT_TEXT))
            x += _width(font, text) + round(1.3 * self.pad)

    def _axes(self, picture: Image.Image, camera: Camera) -> int:
        """The world's axes as seen, at the bottom left; returns where it ends."""
        side = self.footer - self.pad // 2
        left, top = self.pad, self.height - self.footer
        font = _font(max(8, round(0.8 * self.size)))
        axes = camera.axes
        # Room for the letters beyond the arrows' tips.
        reach = 0.5 * side - 0.75 * self.size
        center = np.array([0.5 * side, 0.5 * side])
        tips = [np.array([axes[0, k], -axes[1, k]]) * reach for k in range(3)]

        def symbol(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
            del wide, tall
            for k in sorted(range(3), key=lambda k: -axes[2, k]):  # the farthest first
                start, end = FINE * center, FINE * (center + tips[k])
                draw.line([*start, *end], fill=palette.to_bytes(palette.AXES[k]), width=round(FINE * 0.14 * self.size))

        _paste(picture, symbol, left, top, side, side)
        draw = ImageDraw.Draw(picture)
        for k, letter in enumerate("xyz"):
            length = float(np.linalg.norm(tips[k]))
            if length < 0.25 * reach:  # it points at the viewer
                continue
            x, y = center + tips[k] * (1.0 + 0.5 * self.size / length)
            draw.text((left + x, top + y), letter, font=font, fill=palette.to_bytes(palette.AXES[k]), anchor="mm")
        return left + side

    def _scale(self, picture: Image.Image, scale: palette.TensionScale, x: int, top: int) -> int:
        """The tension scale from x on; returns where it ends."""
        draw = ImageDraw.Draw(picture)
        font = _font(self.size)
        small = _font(max(8, round(0.85 * self.size)))
        power = power_of(scale.end, "N")
        text = f"tension [{unit_with(power, 'N')}]"
        draw.text((x, top + round(0.2 * self.size)), text, font=font, fill=palette.to_bytes(palette.FAINT_TEXT))
        left = x + _width(font, text) + self.pad // 2
        wide, tall = round(13 * self.size), max(4, round(0.8 * self.size))
        bar_top = top + round(0.45 * self.size)
        colors = np.round(255 * palette.tension_colors(np.linspace(0.0, 1.0, wide))).astype(np.uint8)
        picture.paste(Image.fromarray(np.broadcast_to(colors, (tall, wide, 3)).copy()), (left, bar_top))
        for share in (0.0, 0.5, 1.0):
            value = f"{share * scale.end / 10.0**power:.3g}"
            if share == 1.0 and scale.exceeded:
                value = f"≥ {value}"
            place = left + round(share * (wide - 1))
            below = bar_top + tall
            draw.line((place, below, place, below + tall // 3), fill=palette.to_bytes(palette.FAINT_TEXT))
            look: dict[str, Any] = {"font": small, "fill": palette.to_bytes(palette.FAINT_TEXT), "anchor": "ma"}
            draw.text((place, below + tall // 3 + 1), value, **look)
        return left + wide


def _draw_slack(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
    t = np.linspace(0.0, 1.0, 25)
    points = np.column_stack([wide * (0.05 + 0.9 * t), tall * (0.15 + 2.6 * t * (1.0 - t))])
    color, thick = palette.to_bytes(palette.SLACK), max(FINE, tall // 7)
    draw.line([tuple(p) for p in points], fill=color, width=thick, joint="curve")


def _draw_target(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
    color = palette.mixed(palette.TARGET, palette.BACKGROUND, 0.55)
    draw.rounded_rectangle((0, 0.3 * tall, wide - 1, 0.75 * tall), radius=0.22 * tall, fill=palette.to_bytes(color))


def _draw_box(color: palette.Color) -> Symbol:
    def draw_box(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
        side = 0.76 * tall
        draw.rectangle((wide - side - 1, 0.12 * tall, wide - 1, 0.88 * tall), fill=palette.to_bytes(color))

    return draw_box


def _draw_grid(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
    color = palette.to_bytes(palette.mixed(palette.GRID, palette.TEXT, 0.25))
    for x in (0.3 * wide, 0.7 * wide):
        draw.line((x, 0.0, x, tall), fill=color, width=FINE)
    for y in (0.25 * tall, 0.85 * tall):
        draw.line((0.1 * wide, y, 0.9 * wide, y), fill=color, width=FINE)


def _draw_water(draw: ImageDraw.ImageDraw, wide: int, tall: int) -> None:
    t = np.linspace(0.0, 1.0, 33)
    points = [*zip(wide * (0.1 + 0.8 * t), tall * (0.35 - 0.14 * np.cos(2.0 * np.pi * t)), strict=True)]
    body = palette.to_bytes(palette.mixed(palette.WATER, palette.BACKGROUND, 0.5))
    draw.polygon([*points, (0.9 * wide, 0.95 * tall), (0.1 * wide, 0.95 * tall)], fill=body)
    draw.line(points, fill=palette.to_bytes(palette.WATER_LINE), width=FINE, joint="curve")


SYMBOLS: dict[str, Symbol] = {
    "slack": _draw_slack,
    "target": _draw_target,
    "fixed": _draw_box(palette.SUPPORT),
    "guided": _draw_box(palette.GUIDE),
    "water": _draw_water,
    "grid": _draw_grid,
}


def _paste(picture: Image.Image, symbol: Symbol, left: int, top: int, wide: int, tall: int) -> None:
    """Draw a symbol with smooth edges."""
    large = Image.new("RGB", (FINE * wide, FINE * tall), palette.to_bytes(palette.BACKGROUND))
    symbol(ImageDraw.Draw(large), FINE * wide, FINE * tall)
    picture.paste(large.reduce(FINE), (left, top))


@functools.lru_cache(maxsize=64)
def _font(size: int, bold: bool = False) -> Font:
    # matplotlib, which this package needs anyway, brings fonts with Greek letters and signs.
    import matplotlib

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    try:
        return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)
    except OSError:
        return ImageFont.load_default(size)


@functools.lru_cache(maxsize=256)
def _letter(size: int, letter: str) -> NDArray[np.uint8]:
    """One letter of the clock, dark on the background."""
    font = _font(size, bold=True)
    patch = Image.new("RGB", (_width(font, letter), round(1.35 * size)), palette.to_bytes(palette.BACKGROUND))
    ImageDraw.Draw(patch).text((0, 0), letter, font=font, fill=palette.to_bytes(palette.TEXT))
    return np.asarray(patch)


def _width(font: Font, text: str) -> int:
    return int(np.ceil(font.getlength(text)))


def _shortened(text: str, font: Font, room: float) -> str:
    """The text, cut and marked with an ellipsis where it is wider than the room [px]."""
    text = " ".join(text.split())
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text.rstrip() + "…" if text else ""
