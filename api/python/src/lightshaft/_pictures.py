"""Pictures as numpy arrays. Its packages come with the extra `pictures`."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import MissingExtraError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    #: float32 of colours and lengths, uint32 of ids, uint8 of a PNG.
    Array = NDArray[np.float32] | NDArray[np.uint32] | NDArray[np.uint8]


def _needed(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError("pictures", module) from error


def read(path: Path, layer: str | None) -> Array:
    """An EXR's layer as height x width x channels, without the last axis where there is one channel; a PNG alike."""
    if path.suffix.lower() == ".exr":
        layers = read_layers(path)
        name = layer or "color"
        if name not in layers:
            raise KeyError(f"{path.name} has no layer {name!r}; it has {', '.join(sorted(layers))}")
        return layers[name]
    if layer is not None:
        raise ValueError(f"only an EXR has layers: {path.name}")
    numpy, pillow = _needed("numpy"), _needed("PIL.Image")
    with pillow.open(path) as picture:
        array: Array = numpy.asarray(picture.convert("RGBA" if "A" in picture.mode else "RGB"))
    return array


def read_layers(path: Path) -> dict[str, Array]:
    """Every layer of an EXR by its name; the one without a name is `color`."""
    numpy, exr = _needed("numpy"), _needed("OpenEXR")
    groups: dict[str, dict[str, Any]] = {}
    with exr.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                layer, _, last = name.rpartition(".")
                groups.setdefault(layer or "color", {})[last] = channel.pixels
    return {layer: _stacked(numpy, channels) for layer, channels in groups.items()}


def _stacked(numpy: Any, channels: dict[str, Any]) -> Array:
    planes = [channels[name] for name in sorted(channels, key=_place)]
    array: Array = planes[0] if len(planes) == 1 else numpy.stack(planes, axis=-1)
    return array


def _place(channel: str) -> tuple[int, str]:
    order = "RGBAXYZ"
    return (order.index(channel) if channel in order else len(order), channel)
