"""How much each light shows of each defect, in images of samples: contrasts over noise and variation, by windows.

Pixels are compared with the mean of the good samples at the same place. What good samples differ by, sensor noise and
variation from part to part, gives the standard deviation of each pixel under each light, pooled over a neighbourhood,
and the correlation between lights, pooled over the part. Sums over small windows of a defect's pixels, in such standard
deviations, are its contrast: a matrix Z of lights × windows. With the images of some lights S the inspection has the
evidence

    E(S) = tr(R_SS⁻¹ M_SS),   M = Z Zᵀ,

the squared Mahalanobis distance summed over windows, which is ΣE of lightopt.defects for independent lights. A defect
counts as found from E = T² on.

Of a single sample Z has noise of variance 1, which would count as evidence of every light. Singular values of the
whitened Z are shrunk by the rule that is best for the sum of squares (Gavish and Donoho, Optimal shrinkage of singular
values, IEEE Trans. Inf. Theory 63, 2017, equation 7): those that noise alone reaches become 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.errors import InputError, counted, percent
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.defects import MOST_CHANGE, least_z
from lightopt.design.from_images._samples import Samples
from lightopt.design.from_images._sensor_noise import ROUNDING, noise_points, sensor_noise

WINDOW_PX = 3  # side of the windows whose sums are compared
SLACK_PX = 2  # so near to a mask, a pixel is not one of a good sample
TOP = 99.9  # percentile of the part's levels that exposures are fitted to
LEAST_OWN = 0.05  # share of a light's variance that no other light can explain, at least: R is shrunk by so much

_POOLED_PX = 7  # variances are means over squares of this side
_MOST_WINDOWS = 4096  # of good samples per set and posture for the correlation of lights
_MOST_TILES = 256  # windows of the surface that stand for defects where there are none
_LEAST_BLOCKS = 30  # of good samples, for the variance of their sums
_SATURATED = 0.001  # share of the part's pixels from which on exposures are unknown that saturate none
USED_RANGE = 0.95  # of the range up to saturation that 99.9 % of the part's pixels of an image may reach
_HEADROOM = 3.0  # standard deviations of the sensor's noise below saturation, where that is less
_MOST_PIXELS = 10_000  # of the part, whose levels tell where mixed lights saturate
_UNLIKE = 4.0  # times as far from the other samples as those are from each other: another part, or another place


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the samples say of K lights and J defects."""

    correlation: Float64  # R between lights, shape (K, K)
    factors: Float64  # columns of all defects, shape (K, Q): those of a defect are a factor of its M
    starts: Index  # first column of each defect, and Q, shape (J + 1,)
    thresholds: Float64  # evidence from which each defect counts as found, shape (J,)
    deviations: Float64  # standard deviation of a window of each defect under each light [sensor level], (K, J)
    defects: tuple[tuple[str, str], ...]  # set and name of each
    levels: Float64  # mean level above black of each defect's place on good parts, per light [sensor level], (K, J)
    sensor: tuple[float, float]  # noise of the sensor: variance at level 0, and its increase per level
    surface: tuple[Float32, ...]  # levels above black of pixels of the good part, per posture, shape (pixels, K)
    room: float  # highest level above black that 99.9 % of the part's pixels of an image may reach
    brightest: Float64  # level above black that 0.1 % of the part's pixels exceed, per light [sensor level], (K,)
    noise: Float64  # standard deviation of a pixel under each light, rms over the part [sensor level], (K,)
    z: float  # T
    shrinkage: float  # of R towards independent lights
    good: int  # greatest number of good samples at a place
    surface_contrast: float | None  # without defective samples: the relative change that stands for defects

    @property
    def lights(self) -> int:
        return len(self.correlation)

    def gains(self, lights: Sequence[int]) -> Float64:
        """E of each defect in units of its threshold, shape (J,), in images of one light each."""
        chosen = np.array(lights, np.intp)
        own = self.contrasts[:, chosen]
        solved = np.linalg.solve(self.correlation[np.ix_(chosen, chosen)], own)
        return np.sum(own * solved, axis=(1, 2)) / self.thresholds

    @cached_property
    def contrasts(self) -> Float64:
        """Factors of each defect, padded with zeros, shape (J, K, most columns)."""
        columns = np.diff(self.starts)
        found = np.zeros((len(columns), self.lights, max(1, int(columns.max()))))
        for j, (start, count) in enumerate(zip(self.starts, columns, strict=False)):
            found[j, :, :count] = self.factors[:, start : start + count]
        return found

    def all_lights(self) -> Float64:
        """What no choice exceeds: E of each defect with all lights, in units of its threshold, (J,)."""
        energies = np.sum(self.factors * np.linalg.solve(self.correlation, self.factors), axis=0)
        return np.diff(np.cumsum([0.0, *energies])[self.starts]) / self.thresholds


@dataclass(frozen=True)
class _Cells:
    """Windows of defects in a posture: pixels of a set, the window that each is in, and its defect."""

    number: int  # of the set
    pixels: Index  # flat
    window: Index
    defect: Index


@dataclass
class _Measured:
    sums: Float64  # of defects' windows, over their pixels, shape (C,)
    squares: Float64  # of the standard deviation, summed over the pixels of each defect, shape (J,)
    null: Float32  # windows of good samples, flat
    variances: tuple[float, float, float]  # of sums over squares of WINDOW_PX × 1, 3, 9, over those of white noise
    levels: Float64  # above black of good parts, summed over the pixels of each defect, shape (J,)
    surface: Float64  # windows of the good surface: level over standard deviation, shape (tiles,)
    surface_levels: Float64  # their levels, shape (tiles,)
    pixels: Float32  # levels of some of the part's pixels
    points: Float64  # noise against level
    brightest: float
    noise: float
    saturated: float  # share of the part's pixels
    distances: Float64  # of each set from the median of all, median over good pixels [sensor level], shape (sets,)


class _Windows:
    """Windows of the defects of all sets and postures, numbered as they are found."""

    def __init__(self, samples: Samples) -> None:
        self.samples = samples
        self.names = [(i, d) for i, defects in enumerate(samples.defects) for d in range(len(defects))]
        self.sizes = np.zeros(len(self.names))  # pixels of each defect
        self.inside = np.zeros(len(self.names), np.bool_)  # of each defect: whether a pixel of it is of the part
        self.defect = np.zeros(0, np.intp)  # of each window
        self.pixels = np.zeros(0)  # of each window

    def add(self, p: int, known: Bool) -> list[_Cells]:
        """Find those of a posture, at pixels of the part that a good sample shows, shape (H, W)."""
        region = self.samples.regions[p]
        known = known & region
        index = {name: j for j, name in enumerate(self.names)}
        cells: list[_Cells] = []
        for i, labels in enumerate(self.samples.labels):
            inside = np.unique(labels[p][(labels[p] >= 0) & region])
            self.inside[[index[i, d] for d in inside.tolist()]] = True
            pixels = np.flatnonzero((labels[p] >= 0) & known)
            if not len(pixels):
                continue
            row, column = np.unravel_index(pixels, known.shape)
            defect = np.array([index[i, d] for d in labels[p].ravel()[pixels]], np.intp)
            keys = np.stack([defect, row // WINDOW_PX, column // WINDOW_PX])
            unique, window = np.unique(keys, axis=1, return_inverse=True)
            cells.append(_Cells(i, pixels, window.ravel() + len(self.defect), defect))
            self.defect = np.append(self.defect, unique[0].astype(np.intp))
            self.pixels = np.append(self.pixels, np.bincount(window.ravel()))
            self.sizes += np.bincount(defect, minlength=len(self.names))
        return cells

    def label(self, j: int) -> tuple[str, str]:
        i, d = self.names[j]
        return self.samples.names[i], self.samples.defects[i][d]


@dataclass(frozen=True)
class _Lights:
    measured: list[tuple[_Measured, ...]]  # per light its postures
    variances: Float64  # (K, postures, 3)
    correlation: Float64
    shrinkage: float
    root: Float64  # standard deviation of windows over that of independent pixels, (K, 1)
    noise: Float64
    sensor: tuple[float, float]


def measure_evidence(samples: Samples, *, false_alarms: float, run: RunContext) -> Evidence:
    """Measure how much each light shows of each defect.

    Raises InputError: Without defects, no window of the part is seen by good samples.
    """
    windows = _Windows(samples)
    work: list[list[_Measured]] = []
    most = 0
    report = run.stage("measuring contrasts")
    for p in range(len(samples.postures)):
        good = np.stack([_is_good(labels[p] >= 0) for labels in samples.labels])
        count = good.sum(axis=0)
        most = max(most, int(count.max()))
        cells = windows.add(p, count > 0)
        total = len(windows.defect), len(windows.names)
        measure = partial(_measure, samples, p, good, cells, total)
        work.append(in_threads(measure, range(len(samples.channels)), run.threads))
        report((p + 1) / len(samples.postures))
    if all(one.saturated == 1.0 for measured in work for one in measured):
        everywhere = "each pixel of the part is saturated under each light in some good sample"
        raise InputError(f"{samples.sets[0].folder}: {everywhere}; take shorter exposures")
    lights = _all_lights(list(zip(*work, strict=True)))
    kept = np.flatnonzero(windows.sizes)
    tests = sum(int(region.sum()) for region in samples.regions) / len(samples.postures)
    z = least_z(tests, max(1, len(kept)), false_alarms)
    contrast = None
    if len(kept):
        factors = _contrasts(windows, kept, lights)
        squares = np.stack([np.sum([one.squares for one in own], axis=0) for own in lights.measured])[:, kept]
        deviations = np.sqrt(squares / windows.sizes[kept]) * lights.root
        levels = np.stack([np.sum([one.levels for one in own], axis=0) for own in lights.measured])[:, kept]
        levels = levels / windows.sizes[kept]
        thresholds = z * z * _inflation(lights.variances, windows.sizes[kept])
        defects = tuple(map(windows.label, kept.tolist()))
    else:
        factors, contrast = _surface_contrasts(samples, lights, z)
        levels = np.stack([np.concatenate([one.surface_levels for one in own]) for own in lights.measured])
        ratios = np.stack([np.concatenate([one.surface for one in own]) for own in lights.measured]) / WINDOW_PX
        deviations = np.where(ratios > 0.0, levels / np.maximum(ratios, 1e-9), lights.noise[:, None]) * lights.root
        thresholds = np.full(len(factors), z * z)
        defects = tuple(("surface", str(j + 1)) for j in range(len(factors)))
    _warn(samples, run, most, windows, lights, contrast)
    return Evidence(
        correlation=lights.correlation,
        factors=np.concatenate(factors, axis=1),
        starts=np.cumsum([0, *(one.shape[1] for one in factors)]),
        thresholds=thresholds,
        deviations=deviations,
        defects=defects,
        levels=levels,
        sensor=lights.sensor,
        surface=tuple(np.stack(own, axis=1) for own in _pixels(lights.measured) if len(own[0])),
        room=_room(samples, lights.sensor),
        brightest=np.array([max(one.brightest for one in own) for own in lights.measured]),
        noise=lights.noise,
        z=z,
        shrinkage=lights.shrinkage,
        good=most,
        surface_contrast=contrast,
    )


def _room(samples: Samples, sensor: tuple[float, float]) -> float:
    top = samples.manifest.saturated_from - samples.manifest.black_level
    return max(0.5 * top, min(USED_RANGE * top, top - _HEADROOM * math.sqrt(sensor[0] + sensor[1] * top)))


def _pixels(measured: list[tuple[_Measured, ...]]) -> list[list[Float32]]:
    # of each posture, of all lights
    return [[one.pixels for one in own] for own in zip(*measured, strict=True)]


def _all_lights(measured: list[tuple[_Measured, ...]]) -> _Lights:
    variances = np.array([[one.variances for one in own] for own in measured])
    # windows of good samples vary at least like sums of independent noise
    spread = np.maximum(np.nan_to_num(variances[:, :, 0], nan=1.0).mean(axis=1), 1.0)
    null = np.stack([np.concatenate([one.null for one in own]) for own in measured]).astype(np.float64)
    correlation, shrinkage = _correlation(null)
    noise = np.array([float(np.sqrt(np.mean([one.noise**2 for one in own]))) for own in measured])
    sensor = sensor_noise([one.points for own in measured for one in own])
    return _Lights(measured, variances, correlation, shrinkage, np.sqrt(spread)[:, None], noise, sensor)


def _contrasts(windows: _Windows, kept: Index, lights: _Lights) -> list[Float64]:
    # a factor of M for each defect
    total = np.zeros((len(lights.measured), len(windows.defect)))
    for c, own in enumerate(lights.measured):
        for one in own:  # windows of later postures have higher numbers
            total[c, : len(one.sums)] += one.sums
    z = total / np.sqrt(windows.pixels) / lights.root
    root = np.linalg.cholesky(lights.correlation)
    white = np.asarray(np.linalg.solve(root, z), np.float64)
    return [root @ _shrunk(white[:, windows.defect == j]) for j in kept]


def _surface_contrasts(samples: Samples, lights: _Lights, z: float) -> tuple[list[Float64], float]:
    # of windows of the good surface, whose reflectance changes so that half of them are found with all lights
    surface = np.stack([np.concatenate([one.surface for one in own]) for own in lights.measured]) / lights.root
    energies = np.sum(surface * np.linalg.solve(lights.correlation, surface), axis=0)
    if not len(energies):
        raise InputError(f"{samples.sets[0].folder}: no window of {WINDOW_PX} × {WINDOW_PX} px lies within the part")
    if not np.median(energies) > 0.0:
        useless = "most of the part is black or saturated under each light"
        raise InputError(f"{samples.sets[0].folder}: {useless}; take images with other exposures as well")
    contrast = float(z / np.sqrt(np.median(energies)))
    return list((contrast * surface).T[:, :, None]), contrast


def _is_good(mask: Bool) -> Bool:
    near = ndimage.binary_dilation(mask, iterations=SLACK_PX) if mask.any() else mask
    return ~np.asarray(near, np.bool_)


def _measure(samples: Samples, p: int, good: Bool, cells: list[_Cells], total: tuple[int, int], c: int) -> _Measured:
    region, channel = samples.regions[p], samples.channels[c]
    images = np.stack([samples.load(i, channel, samples.postures[p]) for i in range(len(good))])
    count = good.sum(axis=0)
    n = np.maximum(count, 1).astype(np.float32)
    mean = np.where(good, images, 0.0).sum(axis=0) / n
    if count.max() > 1:
        rest, freedom = np.where(good, images - mean, 0.0), np.maximum(count - 1, 0)
        own = np.sqrt(np.maximum(1.0 - 1.0 / n, 0.5))
    else:  # one good sample: mixed differences of neighbours, which a smooth surface does not have
        rest, freedom, own = np.where(good, _mixed_differences(images), 0.0), count, np.ones_like(n)
    deviation = np.sqrt(np.maximum(_pooled((rest**2).sum(axis=0), freedom), ROUNDING))
    z = rest / (deviation * own)
    saturated = np.any(good & (images >= samples.unsaturated), axis=0)
    sums, squares, below = np.zeros(total[0]), np.zeros(total[1]), np.zeros(total[1])
    for one in cells:
        at = one.pixels
        off = (images[one.number].ravel()[at] - mean.ravel()[at]) / (deviation * np.sqrt(1.0 + 1.0 / n)).ravel()[at]
        off = np.where(saturated.ravel()[at], 0.0, np.clip(off, -MOST_CHANGE, MOST_CHANGE))
        sums += np.bincount(one.window, off, minlength=total[0])
        squares += np.bincount(one.defect, deviation.ravel()[at] ** 2, minlength=total[1])
        below += np.bincount(one.defect, mean.ravel()[at], minlength=total[1])
    valid = good & region & (count > 1 if count.max() > 1 else count > 0)
    null, variances = _windows_of_good(z, valid)
    known = region & (count > 0)
    levels = mean[known]
    places = np.flatnonzero(known)
    places = places[:: -(-len(places) * len(samples.postures) // _MOST_PIXELS) or 1]
    return _Measured(
        sums=sums,
        squares=squares,
        null=null,
        variances=variances,
        levels=below,
        surface=_surface(np.where(saturated, 0.0, mean / deviation), known),
        surface_levels=_surface(mean, known) / WINDOW_PX,
        pixels=np.asarray(mean.ravel()[places], np.float32),
        points=noise_points(
            rest / own, valid & ~saturated, mean, places, bits=samples.manifest.bit_depth, differ=bool(count.max() > 1)
        ),
        brightest=float(np.percentile(levels, TOP)) if len(levels) else 0.0,
        noise=float(np.sqrt(np.mean(deviation[region] ** 2))),
        saturated=float(np.mean(saturated[known])),
        distances=_distances(images.reshape(len(images), -1)[:, places], good.reshape(len(good), -1)[:, places]),
    )


def _distances(levels: Float32, good: Bool) -> Float64:
    off = np.abs(levels - np.median(levels, axis=0))
    return np.array([float(np.median(row[used])) if used.any() else 0.0 for row, used in zip(off, good, strict=True)])


def _mixed_differences(images: Float32) -> Float32:
    found = np.zeros_like(images)
    rows = images[:, 1:] - images[:, :-1]
    found[:, :-1, :-1] = 0.5 * (rows[:, :, 1:] - rows[:, :, :-1])
    return found


def _pooled(squares: Float32, freedom: Index) -> Float32:
    # variance of each pixel: squares over degrees of freedom, both summed over a neighbourhood
    weight = ndimage.uniform_filter(freedom.astype(np.float32), _POOLED_PX)
    whole = float(squares.sum()) / max(1.0, float(freedom.sum()))
    own = ndimage.uniform_filter(squares.astype(np.float32), _POOLED_PX)
    return np.where(weight > 1e-3, own / np.maximum(weight, 1e-3), np.float32(whole))


def _blocks(values: Float32, side: int) -> Float32:
    # sums over squares that do not overlap, over their side; shape (..., H // side, W // side)
    rows, columns = (size // side for size in values.shape[-2:])
    cut = values[..., : rows * side, : columns * side]
    return cut.reshape(*values.shape[:-2], rows, side, columns, side).sum(axis=(-3, -1)) / np.float32(side)


def _windows_of_good(z: Float32, valid: Bool) -> tuple[Float32, tuple[float, float, float]]:
    # windows of good samples, as many as _MOST_WINDOWS per set; variances of sums over squares, NaN for too few
    sums, whole = _blocks(np.where(valid, z, 0.0), WINDOW_PX), _blocks(valid.astype(np.float32), WINDOW_PX)
    inside = whole > WINDOW_PX - 0.1
    places = np.flatnonzero(inside.all(axis=0)) if len(inside) else np.zeros(0, np.intp)
    chosen = places[:: max(1, len(places) // _MOST_WINDOWS)]
    null = sums.reshape(len(sums), -1)[:, chosen].ravel()
    variances = [float(np.mean(sums[inside] ** 2)) if inside.any() else np.nan]
    for _ in range(2):
        sums, inside = _blocks(np.where(inside, sums, 0.0), 3), _blocks(inside.astype(np.float32), 3) > 3 - 0.1
        variances.append(float(np.mean(sums[inside] ** 2)) if inside.sum() >= _LEAST_BLOCKS else np.nan)
    return null, (variances[0], variances[1], variances[2])


def _surface(ratio: Float32, region: Bool) -> Float64:
    sums, whole = _blocks(np.where(region, ratio, 0.0), WINDOW_PX), _blocks(region.astype(np.float32), WINDOW_PX)
    places = np.flatnonzero(whole > WINDOW_PX - 0.1)
    return sums.ravel()[places[:: max(1, len(places) // _MOST_TILES)]].astype(np.float64)


def _correlation(null: Float64) -> tuple[Float64, float]:
    # of the lights' windows in good samples, shrunk towards independent lights; and by how much
    lights, number = null.shape
    shrinkage = min(1.0, max(LEAST_OWN, lights / max(1, number)))
    if not number:
        return np.eye(lights), 1.0
    covariance = null @ null.T / number
    scale = np.sqrt(np.maximum(np.diag(covariance), 1.0))
    found = (1.0 - shrinkage) * covariance / np.outer(scale, scale)
    np.fill_diagonal(found, 1.0)
    return found, shrinkage


def _inflation(variances: Float64, sizes: Float64) -> Float64:
    # factor on the threshold of defects of so many pixels: by how much neighbouring windows vary alike
    with np.errstate(invalid="ignore"):
        ratio = variances[:, :, 1:] / np.maximum(variances[:, :, :1], 1.0)
    steps = [1.0]
    for k in range(2):
        known = ratio[:, :, k][np.isfinite(ratio[:, :, k])]
        steps.append(max(1.0, float(np.median(known))) if len(known) else steps[-1])
    at = np.log(WINDOW_PX**2 * np.array([1.0, 9.0, 81.0]))
    return np.interp(np.log(sizes), at, steps)


def _shrunk(z: Float64) -> Float64:
    # U·η(s) of a whitened contrast Z = U s Vᵀ (K, windows) with noise of variance 1, without columns that are 0
    u, s, _ = np.linalg.svd(z, full_matrices=False)
    rows, columns = z.shape
    square = (s**2 - rows - columns) ** 2 - 4.0 * rows * columns
    kept = (s > np.sqrt(rows) + np.sqrt(columns)) & (square > 0.0)
    return u[:, kept] * (np.sqrt(square[kept]) / s[kept])


def _warn(
    samples: Samples, run: RunContext, good: int, windows: _Windows, lights: _Lights, contrast: float | None
) -> None:
    if contrast is not None:
        none = "no defect can be used" if windows.names else "no defective sample"
        run.warn(
            f"{none}: signal over noise of the good surface is all that can be optimised, here of a change "
            f"of reflectance by {percent(contrast)} anywhere on the part; it says nothing on scratches or dents"
        )
    if good < 5:
        number = "one good sample" if good < 2 else f"{good} good samples"
        if good > sum(not defects for defects in samples.defects):
            number = f"at most {number} at each place, as defective ones count beside their masks"
        spread = "unknown, and noise is that of neighbouring pixels" if good < 2 else "estimated from few of them"
        run.warn(f"{number}: how parts differ is {spread}; take at least 5")
    if unlike := _unlike_others(np.mean([one.distances for own in lights.measured for one in own], axis=0)):
        which = ", ".join(f"{samples.names[i]} ({times:.0f} times as far)" for i, times in unlike)
        run.warn(f"unlike the other samples: {which}; is it another part, or at another place or brightness?")
    if lights.shrinkage > LEAST_OWN:
        towards = f"is shrunk by {percent(lights.shrinkage)} towards independent lights"
        run.warn(f"few windows of good samples: the correlation of lights {towards}")
    for reason, which in (
        ("the part or its region does not have the place", ~windows.inside),
        ("no good sample shows the place", windows.inside & (windows.sizes == 0)),
    ):
        if unused := [" ".join(windows.label(j)) for j in np.flatnonzero(which).tolist()]:
            run.warn(f"{counted(len(unused), 'defect')} not used, since {reason}: {_first_five(unused)}")
    saturated = [
        f"{channel.light} {percent(share)}"
        for channel, own in zip(samples.channels, lights.measured, strict=True)
        if (share := max(one.saturated for one in own)) > _SATURATED
    ]
    if saturated:
        unknown = "take shorter exposures as well, for those chosen here saturate these pixels, too"
        run.warn(f"saturated pixels, which show no defect: {_first_five(saturated)}; {unknown}")


def _unlike_others(distances: Float64) -> list[tuple[int, float]]:
    # sets, and how many times as far from the median as the others are; of two, none can be told
    if len(distances) < 3:
        return []
    others = [max(float(np.median(np.delete(distances, i))), ROUNDING**0.5) for i in range(len(distances))]
    return [
        (i, own / rest) for i, (own, rest) in enumerate(zip(distances, others, strict=True)) if own > _UNLIKE * rest
    ]


def _first_five(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
