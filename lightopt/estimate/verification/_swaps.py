"""Lights that are exchanged: which image looks like which light."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import optimize

from lightopt.core.transforms import Posture
from lightopt.estimate.registration import sensor_scale
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction
from lightopt.scene import Scene

# lights are exchanged if the correlation of the images that change rises by this on average
LEAST_GAIN = 0.1


def exchanged_lights(
    scene: Scene, images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction]
) -> dict[str, str]:
    """For each light whose image shows another one the name of that other one; empty if all are as named.

    By correlation over all postures of the images with the predictions of all lights; each light is shown once.
    """
    names = list(dict.fromkeys(image.source.light for image in images))
    if len(names) < 2:
        return {}
    total = np.zeros((len(names), len(names)))
    for posture, prediction in predictions.items():
        clean = prediction.clean
        # of several exposures of a light the longest
        mine = sorted((i for i in images if i.source.posture == posture), key=lambda i: i.source.exposure)
        longest = {image.source.light: image for image in mine}
        if len(longest) < len(names) or not clean.any():
            continue
        for a, name in enumerate(names):
            image = longest[name]
            top, scale = image.top[clean], sensor_scale(scene, image.source)
            seen = np.minimum(image.levels[clean], top)
            for b, other in enumerate(names):
                model = np.minimum(prediction.levels[other][clean] * scale + scene.sensor.black_level, top)
                if np.ptp(seen) > 0.0 and np.ptp(model) > 0.0:
                    total[a, b] += np.corrcoef(seen, model)[0, 1]
    shown, real = optimize.linear_sum_assignment(-total)
    changed = [(a, b) for a, b in zip(shown, real, strict=True) if a != b]
    gain = sum(total[a, b] - total[a, a] for a, b in changed)
    enough = gain > LEAST_GAIN * len(changed) * len(predictions)
    return {names[a]: names[b] for a, b in changed} if enough else {}


def renamed(images: Sequence[CoarseImage], exchanged: Mapping[str, str]) -> tuple[CoarseImage, ...]:
    """The images with the names of the lights that they show."""
    return tuple(
        replace(image, source=replace(image.source, light=exchanged.get(image.source.light, image.source.light)))
        for image in images
    )
