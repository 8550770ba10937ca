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

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.errors import counted, percent
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.defects import MOST_CHANGE, least_z
from lightopt.design.from_images._samples import Samples

WINDOW_PX = 3  # side of the windows whose sums are compared
SLACK_PX = 2  # so near to a mask, a pixel is not one of a good sample
LEAST_OWN = 0.05  # share of a light's variance that no other light can explain, at least: R is shrunk by so much

_POOLED_PX = 7  # variances are means over squares of this side
_ROUNDING = 1.0 / 12.0  # variance of rounding to whole levels
_MOST_WINDOWS = 4096  # of good samples per set and posture for the correlation of lights
_MOST_TILES = 256  # windows of the surface that stand for defects where there are none
_LEAST_BLOCKS = 30  # of good samples, for the variance of their sums
_SATURATED = 0.01  # share of the part's pixels from which on a light is reported as saturated
_TOP = 99.9  # percentile of the part's levels that exposures are fitted to


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the samples say of K lights and J defects."""

    correlation: Float64  # R between lights, shape (K, K)
    factors: Float64  # columns of all defects, shape (K, Q): those of a defect are a factor of its M
    starts: Index  # first column of each defect, and Q, shape (J + 1,)
    thresholds: Float64  # evidence from which each defect counts as found, shape (J,)
    deviations: Float64  # standard deviation of a window of each defect under each light [sensor level], (K, J)
    defects: tuple[tuple[str, str], ...]  # set and name of each
    brightest: Float64  # level above black that 0.1 % of the part's pixels exceed, per light [sensor level], (K,)
    noise: Float64  # standard deviation of a pixel under each light, rms over the part [sensor level], (K,)
    z: float  # T
    shrinkage: float  # of R towards independent lights
    good: int  # greatest number of good samples at a place
    surface_contrast: float | None  # without defective samples: the relative change that stands for defects

    @property
    def lights(self) -> int:
        """K."""
        return len(self.correlation)

    def gains(self, weights: Float64) -> Float64:
        """E of each defect in units of its threshold, shape (J,), in images of lights with weights, shape (N, K)."""
        scaled = weights * self.deviations.T[:, None]
        contrast = scaled @ self.contrasts
        solved = np.linalg.solve(scaled @ self.correlation @ scaled.transpose(0, 2, 1), contrast)
        return np.sum(contrast * solved, axis=(1, 2)) / self.thresholds

    @cached_property
    def contrasts(self) -> Float64:
        """Factors of each defect, padded with zeros, shape (J, K, most columns)."""
        columns = np.diff(self.starts)
        found = np.zeros((len(columns), self.lights, max(1, int(columns.max()))))
        for j, (start, count) in enumerate(zip(self.starts, columns, strict=False)):
            found[j, :, :count] = self.factors[:, start : start + count]
        return found

    def all_lights(self) -> Float64:
        """What no choice and no weights exceed: E of each defect with all lights, in units of its threshold, (J,)."""
        return self.gains(np.eye(self.lights))


@dataclass(frozen=True)
class _Cells:
    """Windows of defects in a posture: pixels of a set, the window that each is in, and its defect."""

    number: int  # of the set
    pixels: Index  # flat
    window: Index
    defect: Index


@dataclass
class _Measured:
    """One light in one posture."""

    sums: Float64  # of defects' windows, over their pixels, shape (C,)
    squares: Float64  # of the standard deviation, summed over the pixels of each defect, shape (J,)
    null: Float32  # windows of good samples, flat
    variances: tuple[float, float, float]  # of sums over squares of WINDOW_PX × 1, 3, 9, over those of white noise
    surface: Float64  # windows of the good surface: level over standard deviation, shape (tiles,)
    brightest: float
    noise: float
    saturated: float  # share of the part's pixels


def measure_evidence(samples: Samples, *, false_alarms: float, run: RunContext) -> Evidence:
    """Measure how much each light shows of each defect.

    false_alarms: Expected in the images of a posture of a good part
    """
    names = [(i, d) for i, defects in enumerate(samples.defects) for d in range(len(defects))]
    index = {name: j for j, name in enumerate(names)}
    windows = np.zeros(0, np.intp)  # defect of each window
    sizes = np.zeros(len(names))  # pixels of each defect
    pixels_of_window = np.zeros(0)
    work: list[list[_Measured]] = []
    most = 0
    report = run.stage("measuring contrasts")
    for p in range(len(samples.postures)):
        good = np.stack([_is_good(labels[p] >= 0) for labels in samples.labels])
        count = good.sum(axis=0)
        most = max(most, int(count.max()))
        cells: list[_Cells] = []
        for i, labels in enumerate(samples.labels):
            pixels = np.flatnonzero((labels[p] >= 0) & (count > 0))
            if len(pixels):
                row, column = np.unravel_index(pixels, count.shape)
                defect = np.array([index[i, d] for d in labels[p].ravel()[pixels]], np.intp)
                keys = np.stack([defect, row // WINDOW_PX, column // WINDOW_PX])
                unique, window = np.unique(keys, axis=1, return_inverse=True)
                window = window.ravel() + len(windows)
                windows = np.append(windows, unique[0].astype(np.intp))
                pixels_of_window = np.append(pixels_of_window, np.bincount(window)[len(pixels_of_window) :])
                cells.append(_Cells(i, pixels, window, defect))
                sizes += np.bincount(defect, minlength=len(names))
        total = len(windows), len(names)

        def measure(c: int, p: int = p, good: Bool = good, cells: list[_Cells] = cells, total: tuple[int, int] = total):
            return _measure(samples, c, p, good, cells, total)

        work.append(in_threads(measure, range(len(samples.channels)), run.threads))
        report((p + 1) / len(samples.postures))
    of_lights = list(zip(*work, strict=True))  # per light its postures
    variances = np.array([[one.variances for one in own] for own in of_lights])  # (K, postures, 3)
    # windows of good samples vary at least like sums of independent noise
    spread = np.maximum(np.nan_to_num(variances[:, :, 0], nan=1.0).mean(axis=1), 1.0)
    null = np.stack([np.concatenate([one.null for one in own]) for own in of_lights]).astype(np.float64)
    correlation, shrinkage = _correlation(null)
    kept = [j for j in range(len(names)) if sizes[j] > 0]
    tests = sum(int(region.sum()) for region in samples.regions) / len(samples.postures)
    z = least_z(tests, max(1, len(kept)), false_alarms)
    root = np.sqrt(spread)[:, None]
    noise = np.array([float(np.sqrt(np.mean([one.noise**2 for one in own]))) for own in of_lights])
    whiten = np.linalg.cholesky(correlation)
    contrast = None
    if kept:
        sums = np.stack([_padded(own, len(windows)) for own in of_lights]) / np.sqrt(pixels_of_window) / root
        factors = [whiten @ _shrunk(np.linalg.solve(whiten, sums[:, windows == j])) for j in kept]
        squares = np.stack([np.sum([one.squares for one in own], axis=0) for own in of_lights])[:, kept]
        deviations = np.sqrt(squares / sizes[kept]) * root
        thresholds = z * z * _inflation(variances, sizes[kept])
        defects = tuple((samples.names[names[j][0]], samples.defects[names[j][0]][names[j][1]]) for j in kept)
    else:
        surface = np.stack([np.concatenate([one.surface for one in own]) for own in of_lights]) / root
        energies = np.sum(surface * np.linalg.solve(correlation, surface), axis=0)
        contrast = float(z / np.sqrt(np.median(energies)))
        factors = list((contrast * surface).T[:, :, None])
        deviations = np.repeat(noise[:, None] * root, len(factors), axis=1)
        thresholds = np.full(len(factors), z * z)
        defects = tuple(("surface", str(j + 1)) for j in range(len(factors)))
    _warn(samples, run, most, [names[j] for j in range(len(names)) if sizes[j] == 0], of_lights, contrast)
    return Evidence(
        correlation=correlation,
        factors=np.concatenate(factors, axis=1),
        starts=np.cumsum([0, *(one.shape[1] for one in factors)]),
        thresholds=thresholds,
        deviations=deviations,
        defects=defects,
        brightest=np.array([max(one.brightest for one in own) for own in of_lights]),
        noise=noise,
        z=z,
        shrinkage=shrinkage,
        good=most,
        surface_contrast=contrast,
    )


def _is_good(mask: Bool) -> Bool:
    near = ndimage.binary_dilation(mask, iterations=SLACK_PX) if mask.any() else mask
    return ~np.asarray(near, np.bool_)


def _padded(own: tuple[_Measured, ...], windows: int) -> Float64:
    # sums of the windows of all postures: later postures have more of them
    total = np.zeros(windows)
    for one in own:
        total[: len(one.sums)] += one.sums
    return total


def _measure(samples: Samples, c: int, p: int, good: Bool, cells: list[_Cells], total: tuple[int, int]) -> _Measured:
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
    deviation = np.sqrt(np.maximum(_pooled((rest**2).sum(axis=0), freedom), _ROUNDING))
    z = rest / (deviation * own)
    sums, squares = np.zeros(total[0]), np.zeros(total[1])
    for one in cells:
        at = one.pixels
        off = (images[one.number].ravel()[at] - mean.ravel()[at]) / (deviation * np.sqrt(1.0 + 1.0 / n)).ravel()[at]
        off = np.clip(off, -MOST_CHANGE, MOST_CHANGE)
        sums += np.bincount(one.window, off, minlength=total[0])
        squares += np.bincount(one.defect, deviation.ravel()[at] ** 2, minlength=total[1])
    valid = good & region & (count > 1 if count.max() > 1 else count > 0)
    null, variances = _windows_of_good(z, valid)
    levels = mean[region & (count > 0)]
    return _Measured(
        sums=sums,
        squares=squares,
        null=null,
        variances=variances,
        surface=_surface(mean / deviation, region & (count > 0)),
        brightest=float(np.percentile(levels, _TOP)) if len(levels) else 0.0,
        noise=float(np.sqrt(np.mean(deviation[region] ** 2))),
        saturated=float(np.mean(levels >= samples.manifest.saturated_from - samples.manifest.black_level - 0.5)),
    )


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
    samples: Samples,
    run: RunContext,
    good: int,
    hidden: list[tuple[int, int]],
    of_lights: list[tuple[_Measured, ...]],
    contrast: float | None,
) -> None:
    if contrast is not None:
        run.warn(
            "no defective sample: signal over noise of the good surface is all that can be optimised, here of a change "
            f"of reflectance by {percent(contrast)} anywhere on the part; it says nothing on scratches or dents"
        )
    if good < 2:
        run.warn(
            "one good sample: how parts differ is unknown, and noise is estimated from neighbouring pixels; expect "
            "more false alarms, and take at least 5 good samples"
        )
    elif good < 5:
        run.warn(
            f"{good} good samples: how parts differ is estimated from few of them, pooled over {_POOLED_PX} × "
            f"{_POOLED_PX} px; take at least 5"
        )
    if hidden:
        names = ", ".join(f"{samples.names[i]} {samples.defects[i][d]}" for i, d in hidden[:5])
        run.warn(
            f"{counted(len(hidden), 'defect')} not used, since no good sample or no pixel shows the place: {names}"
        )
    saturated = [
        f"{channel.light} {percent(share)}"
        for channel, own in zip(samples.channels, of_lights, strict=True)
        if (share := max(one.saturated for one in own)) > _SATURATED
    ]
    if saturated:
        shown = ", ".join(saturated[:5]) + (f" and {len(saturated) - 5} more" if len(saturated) > 5 else "")
        run.warn(
            f"saturated pixels, which show no defect: {shown}; images with shorter exposures would say more of these "
            "lights"
        )
