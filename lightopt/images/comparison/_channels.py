"""The difference between two arrays of values, in numbers, and whether it is too large."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool
from lightopt.core.errors import InputError, refuse

# percentiles of |a − b| that are reported, by their key in reports
PERCENTILES: Mapping[str, float] = MappingProxyType({"p50": 50, "p95": 95, "p99": 99, "p99_9": 99.9})


@dataclass(frozen=True, kw_only=True)
class ComparisonThresholds:
    """When a difference is too large. InputError: A threshold is negative, not finite, or a share above 1.

    A pixel differs where |a − b| > absolute + relative · |a|, a being the golden. Shares are of the pixels that are not
    background in both images, so that a small part in a large frame is judged like a large one.
    """

    absolute: float = 0.05  # [level of the file]
    relative: float = 0.001
    max_share: float = 0.001  # share of pixels that may differ, 0 to 1
    geometry_absolute: float = 0.001  # of values in geometry images and patch tables [mm; 1 for normals]
    min_iou: float | None = None  # least intersection over union of the saturated masks; None: not checked
    saturation: float | None = None  # level from which a pixel is saturated; None: what the file or manifest says

    def __post_init__(self) -> None:
        problems: list[str] = []
        for name, value in asdict(self).items():
            top = 1.0 if name in ("max_share", "min_iou") else math.inf
            if value is not None and not (0 <= value <= top and math.isfinite(value)):
                problems.append(f"threshold {name}: expected a number from 0 to {top:g}, found {value}")
        refuse(problems)


class Verdict:
    """A comparison that passes where there are no reasons why it fails."""

    reasons: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        return {**vars(self), "passed": self.passed}


@dataclass(frozen=True, kw_only=True)
class ChannelDifference(Verdict):
    name: str
    pixels: int
    compared: int  # pixels whose values were compared: not background in both images
    max: float | None  # of |a − b| over the compared pixels where both are finite; None where there are none
    rms: float | None  # the same
    percentiles: Mapping[str, float] | None  # the same, by their key
    differing: int  # pixels beyond the thresholds
    share: float  # of the compared pixels
    not_finite_a: int  # pixels that are NaN or infinite
    not_finite_b: int
    saturated_a: int | None = None  # saturated pixels; None for channels that do not saturate
    saturated_b: int | None = None
    iou: float | None = None  # intersection over union of the two masks, 1 where both are empty
    reasons: tuple[str, ...] = ()


def compare_arrays(
    name: str,
    a: NDArray[Any],
    b: NDArray[Any],
    *,
    absolute: float,
    relative: float,
    max_share: float,
    where: Bool | None = None,
    saturation: tuple[float, float] | None = None,
    min_iou: float | None = None,
) -> ChannelDifference:
    """Compare golden values `a` with new values `b` of one shape, only those in the mask `where`.

    A NaN equals a NaN and an infinity the same infinity; any value that is not finite where the golden's is
    fails. `saturation` has the levels from which `a` and `b` count as saturated. For the limits see
    :class:`ComparisonThresholds`. Raises InputError when the shapes differ.
    """
    if a.shape != b.shape:
        raise InputError(f"{name}: different shapes: {a.shape} against {b.shape}")
    chosen = np.ones(a.shape, np.bool_) if where is None else where
    golden, new = a[chosen].astype(np.float64), b[chosen].astype(np.float64)
    finite_a, finite_b = np.isfinite(golden), np.isfinite(new)
    finite = finite_a & finite_b
    distance = np.abs(golden[finite] - new[finite])
    beyond = int((distance > absolute + relative * np.abs(golden[finite])).sum())
    odd_a, odd_b = golden[~finite], new[~finite]
    differing = beyond + int(((odd_a != odd_b) & ~(np.isnan(odd_a) & np.isnan(odd_b))).sum())
    share = differing / golden.size if golden.size else 0.0

    reasons: list[str] = []
    if share > max_share:
        some, limit = f"{share:.3%} of values ({differing} of {golden.size})", f"{absolute:g} + {relative:.3g}·|golden|"
        reasons.append(f"{name}: {some} differ by more than {limit}; allowed {max_share:.3%}")
    if fresh := int((finite_a & ~finite_b).sum()):
        reasons.append(f"{name}: {fresh} values are NaN or infinite where the golden's are finite")
    masks: dict[str, Any] = {}
    if saturation is not None:
        full_a, full_b = a >= saturation[0], b >= saturation[1]
        union = int((full_a | full_b).sum())
        iou = int((full_a & full_b).sum()) / union if union else 1.0
        masks = {"saturated_a": int(full_a.sum()), "saturated_b": int(full_b.sum()), "iou": iou}
        if min_iou is not None and iou < min_iou:
            reasons.append(f"{name}: saturated areas overlap by {iou:.4f} (IoU); at least {min_iou:g} expected")
    statistics: dict[str, Any] = {"max": None, "rms": None, "percentiles": None}
    if distance.size:
        values = np.percentile(distance, list(PERCENTILES.values()))
        percentiles = dict(zip(PERCENTILES, values.tolist(), strict=True))
        rms = float(np.sqrt(np.mean(distance**2)))
        statistics = {"max": float(distance.max()), "rms": rms, "percentiles": percentiles}
    return ChannelDifference(
        name=name,
        pixels=int(a.size),
        compared=int(golden.size),
        **statistics,
        differing=differing,
        share=share,
        not_finite_a=int((~finite_a).sum()),
        not_finite_b=int((~finite_b).sum()),
        **masks,
        reasons=tuple(reasons),
    )
