"""Prints the means of FLIP that NVIDIA's own implementation finds: `pip install flip-evaluator==1.7 numpy`.

    python nvidia_flip.py >nvidia_flip.csv

`nvidia_flip.rs` makes the same pictures by the same formulas, and compares the means of this crate with that table.
"""

# ruff: noqa: T201

from collections.abc import Callable

import flip_evaluator
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 112, 80

Picture = NDArray[np.float64]


def units(seed: int) -> Picture:
    """Independent uniform values per channel (SplitMix64 of a counter)."""
    counter = np.arange(WIDTH * HEIGHT * 3, dtype=np.uint64) + np.uint64((seed << 32) + 1)
    z = counter * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return ((z >> np.uint64(40)).astype(np.float64) / (1 << 24)).reshape(HEIGHT, WIDTH, 3)


COLUMN, ROW = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
X, Y = (COLUMN + 0.5) / WIDTH, (ROW + 0.5) / HEIGHT
CHECKS = ((COLUMN // 8 + ROW // 8) % 2 == 0)[..., None]


def color(r: object, g: object, b: object) -> Picture:
    """A picture of three channels, numbers or planes."""
    return np.stack([np.broadcast_to(np.asarray(channel, dtype=np.float64), X.shape) for channel in (r, g, b)], axis=-1)


def disc(x: float, y: float, radius: float) -> NDArray[np.bool_]:
    """Which pixels lie in a disc."""
    return np.asarray(np.hypot(X - x, Y - y) < radius)[..., None]


def ramp() -> Picture:
    """A ramp of colours with a disc."""
    return np.where(disc(0.4, 0.5, 0.2), color(0.9, 0.2, 0.1), color(X, Y, 1 - X))


def checks() -> Picture:
    """Squares of two colours."""
    return np.where(CHECKS, color(0.8, 0.7, 0.2), color(0.2, 0.3, 0.6))


def sky() -> Picture:
    """A sun of 1000 with its glow above dark ground."""
    away = (X - 0.7) ** 2 + (Y - 0.25) ** 2
    glow = 4 / (1 + 400 * away)
    above = color(0.3 + 0.5 * Y + glow, 0.5 + 0.4 * Y + glow, 0.9 + glow)
    above = np.where(disc(0.7, 0.25, 0.06), color(1000, 900, 700), above)
    return np.where((Y > 0.7)[..., None], color(0.05 + 0.1 * X, 0.04, 0.02), above)


def room() -> Picture:
    """A dark room with three lamps."""
    floor = np.where(CHECKS, color(0.2, 0.18, 0.15), color(0.02, 0.02, 0.03))
    picture = np.where((Y > 0.6)[..., None], floor, color(0.01 + 0.05 * X, 0.03, 0.04))
    for x, brightness in ((0.2, 30), (0.5, 200), (0.8, 1000)):
        picture = np.where(disc(x, 0.3, 0.05), color(brightness, 0.8 * brightness, 0.5 * brightness), picture)
    return picture


def static() -> Picture:
    """Noise."""
    return units(1)


def speckle() -> Picture:
    """Noise over five decades."""
    return np.asarray(10 ** (5 * units(1) - 2))


def shift(by: int) -> Callable[[Picture], Picture]:
    """Moves right; the left border repeats."""
    return lambda picture: picture[:, np.maximum(np.arange(WIDTH) - by, 0)]


def blur(picture: Picture) -> Picture:
    """The mean of 3 x 3 pixels; borders repeat."""
    wide = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return sum((wide[y : y + HEIGHT, x : x + WIDTH] for y in range(3) for x in range(3)), np.zeros_like(picture)) / 9


def brighter(picture: Picture) -> Picture:
    """By a tenth."""
    return picture * 1.1


def noise(picture: Picture) -> Picture:
    """By up to a fifth, up or down."""
    return picture * (0.8 + 0.4 * units(2))


def fireflies(picture: Picture) -> Picture:
    """One pixel of 500 blown up."""
    return np.where(units(3)[..., :1] < 0.002, color(500, 500, 500), picture)


def clipped(picture: Picture) -> Picture:
    """Without its highlights."""
    return np.minimum(picture, 1)


CHANGES: dict[str, Callable[[Picture], Picture]] = {
    "shift 1": shift(1),
    "shift 5": shift(5),
    "blur": blur,
    "brighter": brighter,
    "noise": noise,
    "fireflies": fireflies,
    "clipped": clipped,
}


def to_8_bits(picture: Picture) -> NDArray[np.float32]:
    """As a PNG holds it, as shares of 255."""
    return (np.floor(np.clip(picture, 0, 1) * 255 + 0.5) / 255).astype(np.float32)


def rows() -> list[str]:
    """The table, a header first."""
    table = ["range,reference,change,mean,start,stop,exposures"]
    for reference in (ramp, checks, static):
        for name in ("shift 1", "shift 5", "blur", "brighter", "noise"):
            a, b = to_8_bits(reference()), to_8_bits(CHANGES[name](reference()))
            _, mean, _ = flip_evaluator.evaluate(a, b, "LDR", applyMagma=False)
            table.append(f"ldr,{reference.__name__},{name},{mean:.6f},,,")
    for reference in (sky, room, speckle):
        for name, change in CHANGES.items():
            a, b = reference().astype(np.float32), change(reference()).astype(np.float32)
            _, mean, found = flip_evaluator.evaluate(a, b, "HDR", applyMagma=False, parameters={})
            start, stop, count = found["startExposure"], found["stopExposure"], found["numExposures"]
            table.append(f"hdr,{reference.__name__},{name},{mean:.6f},{start:.6f},{stop:.6f},{count}")
    return table


if __name__ == "__main__":
    print("\n".join(rows()))
