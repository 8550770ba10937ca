"""Image sets of drawn samples: good ones that differ by noise and brightness, and ones with spots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from lightopt.images import write_png

ANGLES = {"light_elevation_deg": 60, "light_azimuth_deg": 45}
POSTURE, TILTED = {"elevation_deg": 0, "rotation_deg": 0}, {"elevation_deg": 10, "rotation_deg": 0}


def write_set(folder: Path, images, mask=None, *, lights=None, exposure=1.0, tilted=None, **manifest) -> Path:
    """Write levels (lights, H, W) as an image set, with its mask; `tilted` are images of a second posture."""
    folder.mkdir(parents=True)
    names = lights or [f"led-{c + 1}" for c in range(len(images))]
    entries = []
    for posture, shown in ((POSTURE, images), (TILTED, [] if tilted is None else tilted)):
        for name, levels in zip(names, shown, strict=False):
            file = f"{name}-{posture['elevation_deg']}.png"
            write_png(folder / file, np.clip(np.rint(levels), 0, 255).astype(np.uint8), metadata={})
            entries.append({"light": name, **ANGLES, "posture": posture, "exposure": exposure, "png": file})
    head = {"format": "lightopt-images/1", "kind": "captured", "bit_depth": 8, **manifest}
    (folder / "manifest.json").write_text(json.dumps({**head, "images": entries}), encoding="utf-8")
    if mask is not None:
        write_png(folder / "mask.png", mask.astype(np.uint8), metadata={})
    return folder


def drawn_samples(lights=4, good=5, bad=2, *, size=(36, 48), noise=1.5, seed=7, contrast=25.0):
    """Levels (samples, lights, H, W) and masks (samples, H, W), 0 or 255: the last `bad` samples have two spots each.

    The first spot of a sample shows under the first light and a little under the second, the other one under the last.
    """
    random = np.random.default_rng(seed)
    height, width = size
    base = 60.0 + 40.0 * np.sin(np.arange(width) / 9.0 + np.arange(lights)[:, None, None]) * np.ones((height, 1))
    levels = base * (1.0 + 0.01 * random.normal(size=(good + bad, 1, 1, 1)))
    masks = np.zeros((good + bad, height, width), np.uint8)
    for i in range(good, good + bad):
        for shown, weak, top, left in ((0, 1, 6, 6 + 5 * (i - good)), (lights - 1, lights - 1, 22, 8 + 9 * (i - good))):
            levels[i, shown, top : top + 4, left : left + 5] += contrast
            levels[i, weak, top : top + 4, left : left + 5] -= 0.3 * contrast * (weak != shown)
            masks[i, top : top + 4, left : left + 5] = 255
    return np.rint(levels + noise * random.normal(size=levels.shape)), masks


def write_samples(folder: Path, levels, masks) -> list[Path]:
    """Write drawn samples; those without a spot have no mask."""
    return [
        write_set(folder / f"s{i}", own, mask if mask.any() else None)
        for i, (own, mask) in enumerate(zip(levels, masks, strict=True))
    ]


def camera_levels(light, random, *, read=0.8, electrons=60.0, highest=255):
    """What a camera delivers of levels of light: with shot noise and read noise, rounded and clipped."""
    taken = random.poisson(np.maximum(light, 0.0) * electrons) / electrons + random.normal(0.0, read, light.shape)
    return np.clip(np.rint(taken), 0, highest)
