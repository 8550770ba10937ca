"""From the gradients of several images of a posture to those of one without highlights.

A highlight is where it is in one image only, and so are its steep flanks; what belongs to the surface is seen in
others, too. Rules differ in how they separate the two. All use the images that show the surface at a place, by the
weights of their pixels, no others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.inspection._image_blocks import in_image_blocks, in_row_blocks

Fusion = Literal["paper", "median", "minimum", "second-largest"]
FUSIONS: Final = ("paper", "median", "minimum", "second-largest")
"""Rules of fusion; :func:`fuse_gradients` has their definitions."""

# differences to the pixel to the right, shape (H, W − 1), and to the one below, shape (H − 1, W)
Gradients = list[Float64]

BLOOMING_PX = 2  # pixels this near to a saturated one do not count: charge, glare and lens spread there
LIT = 3.0  # a pixel that is predicted to be less than this many standard deviations of noise above black is in shadow

# an image with less than this share of the weight of the best one at a place is not used there
LEAST_WEIGHT_SHARE = 0.25

SUPPORT = 0.5  # the paper's rule keeps a gradient where another image has one of at least this share of its size nearby
NOISE_SLACK = 2.0  # gradients count as equal within this many standard deviations of noise
REACH_PX = 1  # how far away the other image's gradient may be


def pixel_weights(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    *,
    threads: int | None = None,
) -> Float32:
    """Weight of each pixel of each image: 1 where it shows the surface, 0 where a highlight or a shadow.

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
        image = saturated[i], predicted[i], specular[i], deviations[i], limit[i]
        _weigh_rows(image, rows.start, weights[i, rows])

    in_image_blocks(weigh, images, height, threads)
    return weights


@kernel
def _weigh_rows(image: tuple[Bool, Float32, Float32, Float32, Float32], top: int, weights: Float32) -> None:
    # rows of an image's weights from `top` on; a third of the time that NumPy takes
    saturated, predicted, specular, deviations, limit = image
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


@dataclass(frozen=True)
class Edges:
    """The differences between neighbouring pixels of several images, and which of them show the surface."""

    axis: int  # 1 for edges to the pixel to the right, 0 for those to the pixel below
    usable: Bool  # which images are used at each edge, shape (images, H, W − 1) or (images, H − 1, W)
    noise: Float32  # standard deviation of each difference, same shape

    @staticmethod
    def of(weights: Float32, deviations: Float32, axis: int) -> Edges:
        """Edges of images of such :func:`pixel_weights` and standard deviations of noise, shape (images, H, W)."""
        first, second = (
            (deviations[:, :, :-1], deviations[:, :, 1:]) if axis else (deviations[:, :-1], deviations[:, 1:])
        )
        return Edges(axis, _usable_edges(weights, axis), np.hypot(first, second))

    @property
    def unknown(self) -> Bool:
        """Edges at which no image is used, shape (H, W − 1) or (H − 1, W)."""
        return np.asarray(~self.usable.any(axis=0), np.bool_)


@kernel
def _usable_edges(weights: Float32, axis: int) -> Bool:
    # where an image has enough of the weight of the best one at an edge; an edge has the lesser one of its two pixels
    images, height, width = weights.shape
    height, width = height - 1 + axis, width - axis
    usable = np.empty((images, height, width), np.bool_)
    edge, best = np.empty((images, width), np.float32), np.empty(width, np.float32)
    for y in range(height):
        best[:] = 0.0
        for i in range(images):
            here, there = weights[i, y], weights[i, y + 1 - axis, axis:]
            for x in range(width):
                edge[i, x] = min(here[x], there[x])
                best[x] = max(best[x], edge[i, x])
        for i in range(images):
            for x in range(width):
                usable[i, y, x] = (edge[i, x] > 0.0) & (edge[i, x] >= np.float32(LEAST_WEIGHT_SHARE) * best[x])
    return usable


def fuse_gradients(levels: Float32, edges: Edges, *, fusion: Fusion, threads: int | None = None) -> Float64:
    """Differences between neighbouring pixels of the fused image; 0 where no image is used.

    levels: the images of a posture, shape (images, H, W).
    fusion: ``paper``: a gradient is kept where another image has one at the same place, of whatever sign, and those
        kept are averaged; ``median`` (Weiss 2001, doi:10.1109/ICCV.2001.937606); ``minimum``: the one of least
        magnitude; ``second-largest``: the one of second largest magnitude.
    """
    fused = np.empty(edges.usable.shape[1:])
    levels = np.ascontiguousarray(levels)  # the kernels are compiled for one layout
    usable = edges.usable

    def fuse_rows(rows: slice) -> None:
        first, last = max(0, rows.start - REACH_PX), min(rows.stop + REACH_PX, len(fused))
        gradients = _usable_gradients(levels, usable, edges.axis, first, last)
        if fusion == "paper":
            _average_supported(gradients, edges.noise, usable, first, rows.start, fused[rows])
        else:
            _choose(gradients, usable, FUSIONS.index(fusion), first, rows.start, fused[rows])

    in_row_blocks(fuse_rows, len(fused), threads)
    return fused


@kernel
def _usable_gradients(levels: Float32, usable: Bool, axis: int, first: int, last: int) -> Float32:
    # the differences at some rows of edges, 0 where an image is not used
    images, _, width = usable.shape
    gradients = np.empty((images, last - first, width), np.float32)
    for i in range(images):
        for y in range(first, last):
            here, there = levels[i, y], levels[i, y + 1 - axis, axis:]
            for x in range(width):
                step = there[x] - here[x]
                gradients[i, y - first, x] = step if usable[i, y, x] else np.float32(0.0)
    return gradients


@kernel
def _largest_nearby(gradients: Float32) -> Float32:
    # the greatest magnitude within REACH_PX of each edge, image by image
    images, height, width = gradients.shape
    across = np.abs(gradients)
    for i in range(images):
        for y in range(height):
            own, most = np.abs(gradients[i, y]), across[i, y]
            for u in range(1, min(REACH_PX, width - 1) + 1):
                # slices, so that the compiler sees that no index is negative
                left, right, before, after = most[: width - u], most[u:], own[: width - u], own[u:]
                for x in range(width - u):
                    left[x] = max(left[x], after[x])
                for x in range(width - u):
                    right[x] = max(right[x], before[x])
    nearby = across.copy()
    for i in range(images):
        for y in range(height):
            for v in range(max(y - REACH_PX, 0), min(y + REACH_PX + 1, height)):
                for x in range(width):
                    nearby[i, y, x] = max(nearby[i, y, x], across[i, v, x])
    return nearby


@kernel
def _average_supported(gradients: Float32, noise: Float32, usable: Bool, first: int, top: int, fused: Float64) -> None:
    # fused rows of edges from `top` on, given the gradients from `first` on. Of each image a whole row at a time, in
    # loops without branches, since the processor works on neighbours at once
    images, _, width = gradients.shape
    nearby = _largest_nearby(gradients)
    largest, runner_up = np.empty(width, np.float32), np.empty(width, np.float32)
    who, count, supported = np.empty(width, np.int32), np.empty(width, np.int32), np.empty(width, np.int32)
    total = np.empty(width)
    for row in range(len(fused)):
        y, here = top + row, top - first + row
        largest[:], runner_up[:], who[:], count[:], supported[:], total[:] = -1.0, -1.0, -1, 0, 0, 0.0
        for i in range(images):
            used, sizes = usable[i, y], nearby[i, here]
            for x in range(width):
                size = sizes[x] if used[x] else np.float32(-1.0)
                most = size > largest[x]
                runner_up[x] = largest[x] if most else max(runner_up[x], size)
                who[x] = i if most else who[x]
                largest[x] = size if most else largest[x]
                count[x] += used[x]
        for i in range(images):
            used, own, own_noise = usable[i, y], gradients[i, here], noise[i, y]
            for x in range(width):
                others = runner_up[x] if who[x] == i else largest[x]
                enough = others >= SUPPORT * abs(own[x]) - NOISE_SLACK * own_noise[x]
                # a single image needs no support
                kept = used[x] & (enough | (count[x] == 1))
                total[x] += own[x] if kept else np.float32(0.0)
                supported[x] += kept
        for x in range(width):
            fused[row, x] = total[x] / max(supported[x], 1)


@kernel
def _choose(gradients: Float32, usable: Bool, rule: int, first: int, top: int, fused: Float64) -> None:
    # by the rule of that number among FUSIONS: ordered by value for the median, else by magnitude
    images, _, width = gradients.shape
    ordered = np.empty(images, np.float32)
    for row in range(len(fused)):
        y, here = top + row, top - first + row
        for x in range(width):
            count = 0
            for i in range(images):
                if not usable[i, y, x]:
                    continue
                own = gradients[i, here, x]
                k = count
                while k > 0 and (ordered[k - 1] > own if rule == 1 else abs(ordered[k - 1]) > abs(own)):
                    ordered[k] = ordered[k - 1]
                    k -= 1
                ordered[k] = own
                count += 1
            if count == 0:
                fused[row, x] = 0.0
            elif rule == 1:
                fused[row, x] = 0.5 * (float(ordered[(count - 1) // 2]) + float(ordered[count // 2]))
            elif rule == 2:
                fused[row, x] = ordered[0]
            else:
                fused[row, x] = ordered[max(count - 2, 0)]


@dataclass(frozen=True)
class FusionRule:
    """A rule of fusion for the images of a posture."""

    fusion: Fusion
    edges: tuple[Edges, Edges]  # to the right, and to the pixel below
    deviations: Float32  # standard deviation of the images' noise, shape (images, H, W)

    @staticmethod
    def of(weights: Float32, deviations: Float32, fusion: Fusion) -> FusionRule:
        """The rule for images of such weights and such noise, as :class:`Edges` has them."""
        edges = Edges.of(weights, deviations, 1), Edges.of(weights, deviations, 0)
        return FusionRule(fusion, edges, deviations)

    def fuse(self, images: Float32) -> Gradients:
        """Gradients of the fused image, of images of shape (images, H, W)."""
        return [fuse_gradients(images, edges, fusion=self.fusion, threads=1) for edges in self.edges]

    def fuse_with_noise(self, images: Float32, rng: np.random.Generator) -> Gradients:
        """The same of images to which noise is added."""
        noisy = np.empty(images.shape, np.float32)

        def draw(i: int, rows: slice) -> None:
            own = rng.standard_normal(dtype=np.float32, out=noisy[i, rows])
            own *= self.deviations[i, rows]
            own += images[i, rows]

        in_image_blocks(draw, len(images), images.shape[1], 1)  # one after the other, as random numbers come
        return self.fuse(noisy)


def fuse_with_prediction(
    rule: FusionRule, levels: Float32, diffuse: Float32, *, draws: int, seed: int, threads: int | None = None
) -> tuple[Gradients, Gradients, Gradients]:
    """Fuse the gradients of images, and estimate the error of the rule from those of the predicted good part.

    Returns The fused gradients, the shading of the good part that they lack where an image is not used, and what noise
    makes of them beside scatter.

    levels, diffuse: of the images and of the good part, predicted highlights taken off [grey level], shape (images, H,
        W).
    draws: how many times noise is added to the good part's to find the bias; 0 for a bias of 0.
    """
    lit = (diffuse >= LIT * rule.deviations).astype(np.float32)
    tasks = [
        partial(rule.fuse, levels),
        partial(rule.fuse, diffuse),
        lambda: FusionRule.of(lit, rule.deviations, rule.fusion).fuse(diffuse),
        # each draw has random numbers of its own, so that their order does not matter
        *(partial(rule.fuse_with_noise, diffuse, np.random.default_rng((seed, 0, i))) for i in range(draws)),
    ]
    fused, here, everywhere, *noisy = in_threads(lambda task: task(), tasks, threads)
    missing = [a - b for a, b in zip(everywhere, here, strict=True)]
    if not draws:
        return fused, missing, [np.zeros(h.shape) for h in here]
    return fused, missing, [sum(many) / draws - h for *many, h in zip(*noisy, here, strict=True)]
