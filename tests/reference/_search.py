"""The search as the paper's section 5.2 words it: one combination after the other, plainly.

Arrays are (candidates, patches) per light; a combination is one candidate of each light.
"""

from __future__ import annotations

import itertools

import numpy as np

__all__ = ["all_combinations", "coverage_value", "detectability_value", "paper_value", "usable_value"]


def paper_value(columns, shade, saturation, black=0):
    """Steps 3 to 5: sort each row downwards, drop its first and last, zero what is shaded or specular, sum.

    What is summed is the light: levels above black.
    """
    matrix = np.sort(np.array(columns, dtype=np.int64), axis=0)[::-1]
    evaluation = matrix[1:-1].copy()
    used = (evaluation >= shade) & (evaluation < saturation)
    return int((evaluation - black)[used].sum())


def coverage_value(columns, shade, saturation, areas):
    """Area that is usable in two images or more and saturated in at most one."""
    matrix = np.array(columns, dtype=np.int64)
    usable = np.count_nonzero((matrix >= shade) & (matrix < saturation), axis=0)
    saturated = np.count_nonzero(matrix >= saturation, axis=0)
    return int(sum(int(a) for a, u, s in zip(areas, usable, saturated, strict=True) if u >= 2 and s <= 1))


def detectability_value(images, areas, weights, needed):
    """Area times weight of the defects with `needed` units of evidence or more; images of (patches, defects)."""
    counts = np.sum([np.asarray(image, dtype=np.int64) for image in images], axis=0)
    total = 0
    for p, area in enumerate(areas):
        for t, weight in enumerate(weights):
            if counts[p, t] >= needed:
                total += int(area) * int(weight)
    return total


def usable_value(columns, shade, saturation, weights, black=0):
    """Sum of usable levels above black, each times its patch's weight: what decides between equal scores."""
    matrix = np.array(columns, dtype=np.int64)
    return int((np.where((matrix >= shade) & (matrix < saturation), matrix - black, 0) * weights).sum())


def all_combinations(levels, value, shade, saturation, weights, allowed=None, black=0):
    """Step 6: every combination with its value, best first: larger value, larger usable sum, lower candidates."""
    found = []
    for combination in itertools.product(*(range(len(layer)) for layer in levels)):
        if allowed is not None and not allowed(combination):
            continue
        columns = [layer[i] for layer, i in zip(levels, combination, strict=True)]
        found.append((-value(columns), -usable_value(columns, shade, saturation, weights, black), combination))
    return sorted(found)
