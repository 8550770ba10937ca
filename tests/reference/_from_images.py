"""The evidence of samples' images, pixel by pixel: a plain transcription of what design.from_images documents."""

from __future__ import annotations

import math

import numpy as np
from scipy import special

WINDOW, POOLED, OWN, FALSE_ALARM_SHARE, CLIP = 3, 7, 0.05, 0.5, 8.0


def reference_gains(images, masks, region, subset, *, false_alarms=0.05):
    """Evidence of each defect over its threshold, with the images of `subset` alone.

    images: levels above black, shape (samples, lights, H, W); masks: numbers of defects from 1, of all samples, 0 for
    none, shape (samples, H, W), each defect in one sample; region: of the part, shape (H, W).
    """
    samples, lights, height, width = images.shape
    good = np.ones(masks.shape, bool)
    for i in range(samples):
        for y, x in np.argwhere(masks[i] > 0):
            for v in range(height):
                for u in range(width):
                    if abs(v - y) + abs(u - x) <= 2:
                        good[i, v, u] = False
    count = good.sum(axis=0)
    mean = np.zeros((lights, height, width))
    rest = np.zeros(images.shape)
    for c in range(lights):
        for y in range(height):
            for x in range(width):
                own = [images[i, c, y, x] for i in range(samples) if good[i, y, x]]
                mean[c, y, x] = np.mean(own) if own else 0.0
                for i in range(samples):
                    rest[i, c, y, x] = images[i, c, y, x] - mean[c, y, x] if good[i, y, x] else 0.0
    deviation = np.zeros(mean.shape)
    half = POOLED // 2
    freedom = np.pad(np.maximum(count - 1, 0), half, mode="symmetric")
    for c in range(lights):
        squares = np.pad((rest[:, c] ** 2).sum(axis=0), half, mode="symmetric")
        for y in range(height):
            for x in range(width):
                window = np.s_[y : y + POOLED, x : x + POOLED]
                variance = squares[window].sum() / freedom[window].sum()
                deviation[c, y, x] = math.sqrt(max(variance, 1 / 12))
    # windows of good samples
    null = []
    for i in range(samples):
        for top in range(0, height - WINDOW + 1, WINDOW):
            for left in range(0, width - WINDOW + 1, WINDOW):
                window = np.s_[top : top + WINDOW, left : left + WINDOW]
                everywhere = all(bool((good[k] & region & (count > 1))[window].all()) for k in range(samples))
                if everywhere:
                    scale = deviation[(slice(None), *window)] * np.sqrt(np.maximum(1 - 1 / count[window], 0.5))
                    null.append((rest[(i, slice(None), *window)] / scale).sum(axis=(1, 2)) / WINDOW)
    covariance = np.mean([np.outer(one, one) for one in null], axis=0)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1.0))
    shrinkage = max(OWN, lights / len(null))
    correlation = (1 - shrinkage) * covariance / np.outer(scale, scale)
    np.fill_diagonal(correlation, 1.0)
    # spread of windows that are good in a sample of its own
    spread = np.zeros(lights)
    for c in range(lights):
        sums = []
        for i in range(samples):
            for top in range(0, height - WINDOW + 1, WINDOW):
                for left in range(0, width - WINDOW + 1, WINDOW):
                    window = np.s_[top : top + WINDOW, left : left + WINDOW]
                    if (good[i] & region & (count > 1))[window].all():
                        own = deviation[c][window] * np.sqrt(np.maximum(1 - 1 / count[window], 0.5))
                        sums.append((rest[i, c][window] / own).sum() / WINDOW)
        spread[c] = max(1.0, np.mean(np.square(sums)))
    numbers = list(range(1, masks.max() + 1))
    t = -special.ndtri(0.5 * FALSE_ALARM_SHARE * false_alarms / (region.sum() * len(numbers)))
    found = []
    for d in numbers:
        (i,) = {int(k) for k in np.argwhere(masks == d)[:, 0]}
        cells: dict[tuple[int, int], list[np.ndarray]] = {}
        for y, x in np.argwhere(masks[i] == d):
            if count[y, x]:
                off = (images[i, :, y, x] - mean[:, y, x]) / (deviation[:, y, x] * math.sqrt(1 + 1 / count[y, x]))
                cells.setdefault((y // WINDOW, x // WINDOW), []).append(np.clip(off, -CLIP, CLIP))
        z = np.array([np.sum(own, axis=0) / math.sqrt(len(own)) for own in cells.values()]).T / np.sqrt(spread)[:, None]
        root = np.linalg.cholesky(correlation)
        u, s, vt = np.linalg.svd(np.linalg.inv(root) @ z)
        m, n = z.shape
        kept = np.zeros(z.shape)
        for k, value in enumerate(s):
            if value > math.sqrt(m) + math.sqrt(n):
                kept += math.sqrt((value**2 - m - n) ** 2 - 4 * m * n) / value * np.outer(u[:, k], vt[k])
        contrast = root @ kept
        own = contrast[subset]
        found.append(np.trace(np.linalg.inv(correlation[np.ix_(subset, subset)]) @ own @ own.T) / t**2)
    return np.array(found)
