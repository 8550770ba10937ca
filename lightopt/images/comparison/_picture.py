"""A picture of where two images differ."""

from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.images import write_png
from lightopt.images.comparison._files import LEVELS, load_file

_LOWER = (33, 102, 172)
_EQUAL = (247, 247, 247)
_HIGHER = (178, 24, 43)
_ONLY_GOLDEN = (0, 150, 60)
_ONLY_NEW = (255, 0, 255)
_NOT_FINITE = (0, 0, 0)
_SCALE_PERCENTILE = 99.9
_LEAST_SCALE = 0.05


def difference_picture(
    a: str | Path, b: str | Path, path: str | Path, *, saturation: float | None = None, overwrite: bool = True
) -> float:
    """Write a PNG of the signed difference new − golden: blue lower, white equal, red higher; returns the scale.

    Pixels saturated only in the golden image `a` are green, only in the new one `b` magenta, values that are not
    finite in either black. Channel, scale and numbers of such pixels are in the file's metadata. The channel is ``Y``,
    a PNG's levels, or the first one; the scale, the difference of the full colours [level of the files], is the 99.9th
    percentile of the differences.

    saturation: Level from which a pixel counts as saturated; by default what the files say.
    Raises InputError: An image cannot be read, they differ in format or size or share no channel, the picture cannot be
        written, or one of other content is there and `overwrite` is False.
    """
    golden, new = load_file(Path(a)), load_file(Path(b))
    if golden.kind != new.kind or golden.shape != new.shape:
        raise InputError(
            f"{a} and {b}: no difference to show between {golden.kind} of {golden.shape} and {new.kind} of {new.shape}"
        )
    common = sorted(golden.channels.keys() & new.channels.keys())
    if not common:
        raise InputError(f"{a} and {b}: no channel is in both images")
    name = next((name for name in ("Y", LEVELS) if name in common), common[0])
    old, now = golden.channels[name].astype(np.float64), new.channels[name].astype(np.float64)
    finite = np.isfinite(old) & np.isfinite(now)
    signed = np.zeros(old.shape)
    np.subtract(now, old, out=signed, where=finite)
    scale = _LEAST_SCALE
    if signed.any():
        scale = max(float(np.percentile(np.abs(signed[signed != 0]), _SCALE_PERCENTILE)), _LEAST_SCALE)
    pixels = _diverging(signed / scale)
    only_golden = only_new = np.zeros(old.shape, np.bool_)
    if name in ("Y", LEVELS):
        full_a = old >= (golden.saturation if saturation is None else saturation)
        full_b = now >= (new.saturation if saturation is None else saturation)
        only_golden, only_new = full_a & ~full_b, full_b & ~full_a
    pixels[only_golden], pixels[only_new], pixels[~finite] = _ONLY_GOLDEN, _ONLY_NEW, _NOT_FINITE
    metadata: dict[str, Any] = {
        "picture": "difference",
        "channel": name,
        "scale": scale,
        "beyond_scale": int((np.abs(signed) > scale).sum()),
        "only_golden": int(only_golden.sum()),
        "only_new": int(only_new.sum()),
        "colours": {
            f"{-scale:g} (new − golden) and below": _LOWER,
            "0": _EQUAL,
            f"{scale:g} and above": _HIGHER,
            "saturated only in golden": _ONLY_GOLDEN,
            "saturated only in new": _ONLY_NEW,
            "not finite": _NOT_FINITE,
        },
    }
    write_png(path, pixels, metadata=metadata, overwrite=overwrite)
    return scale


def _diverging(relative: Float64) -> UInt8:
    """Colours (H, W, 3) of differences relative to the scale, −1 to 1; beyond looks like the end."""
    channels = [
        np.interp(relative, [-1.0, 0.0, 1.0], [low, middle, high])
        for low, middle, high in zip(_LOWER, _EQUAL, _HIGHER, strict=True)
    ]
    return np.floor(np.stack(channels, axis=-1) + 0.5).astype(np.uint8)
