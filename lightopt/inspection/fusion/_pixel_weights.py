"""How much each pixel of an image shows the surface: nothing in highlights, on their flanks and in shadows."""

import numpy as np

from lightopt.core.arrays import Bool, Float32
from lightopt.core.kernels import kernel
from lightopt.inspection._image_blocks import in_image_blocks

BLOOMING_PX = 2  # pixels this near to a saturated one do not count: charge, glare and lens spread there
LIT = 3.0  # a pixel that is predicted to be less than this many standard deviations of noise above black is in shadow


def pixel_weights(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    *,
    threads: int | None = None,
) -> Float32:
    """How much each pixel of each image shows the surface and not a highlight or a shadow, 0 to 1.

    0 where it is saturated or predicted to be, and next to that; 0 in shadow; the less the steeper the flank of the
    highlight that is predicted there.

    saturated: As measured, shape (images, H, W).
    predicted, specular: Levels of the good part, and the highlights' share of them [grey level], same shape.
    deviations: Standard deviation of the noise [grey level], same shape.
    limit: Level from which a pixel is saturated [grey level], same shape.
    """
    weights = np.empty(predicted.shape, np.float32)
    images, height, _ = predicted.shape

    def weigh(i: int, rows: slice) -> None:
        own = weights[i, rows]
        _weigh_rows(saturated[i], predicted[i], specular[i], deviations[i], limit[i], rows.start, own)

    in_image_blocks(weigh, images, height, threads)
    return weights


@kernel
def _weigh_rows(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    top: int,
    weights: Float32,
) -> None:
    # rows of an image's weights from `top` on; a third of the time that NumPy takes
    height, width = predicted.shape
    rows = len(weights)
    hidden = np.zeros((rows, width), np.bool_)
    for y in range(max(0, top - BLOOMING_PX), min(height, top + rows + BLOOMING_PX)):
        first, last = max(0, y - BLOOMING_PX - top), min(rows, y + BLOOMING_PX + 1 - top)
        for x in range(width):
            if saturated[y, x] or predicted[y, x] >= limit[y, x]:
                hidden[first:last, max(0, x - BLOOMING_PX) : x + BLOOMING_PX + 1] = True
    for row in range(rows):
        y = top + row
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            weights[row, x] = 0.0
            noise = deviations[y, x]
            if hidden[row, x] or predicted[y, x] < LIT * noise:
                continue
            before, after = max(x - 1, 0), min(x + 1, width - 1)
            down = (specular[below, x] - specular[above, x]) / max(below - above, 1)
            right = (specular[y, after] - specular[y, before]) / max(after - before, 1)
            weights[row, x] = 1.0 / (1.0 + (down * down + right * right) / (noise * noise))
