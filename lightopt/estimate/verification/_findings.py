"""What was found: each fault with its size, its limit, what else it might be, and what would tell."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._comparison import Spot
from lightopt.estimate.verification._parameters import Group

# of each kind the name, and how a size is written: factor, digits, unit
_KINDS = {
    "gain": ("gain of {}", 100.0, 2, " %"),
    "exposure": ("exposure", 100.0, 2, " %"),
    "black": ("black level", 1.0, 2, " levels"),
    "part_shift": ("part moved", 1.0, 3, " mm"),
    "part_turn": ("part turned", 1.0, 3, "°"),
    "camera_shift": ("camera moved", 1.0, 3, " mm"),
    "camera_turn": ("camera turned", 1.0, 3, "°"),
    "panel_shift": ("panel of {} moved", 1.0, 3, " mm"),
    "panel_turn": ("panel of {} turned", 1.0, 3, "°"),
    "swap": ("lights exchanged", 1.0, 0, ""),
    "focus": ("focus", 1.0, 2, " px"),
    "dust_part": ("dust or a defect on the part", 1.0, 0, ""),
    "dust_lens": ("dust on lens or sensor", 1.0, 0, ""),
}
_AXES = {"part": ("x", "y", "z"), "camera": ("right", "up", "ahead"), "panel": ("across", "along", "outward")}
# by what the two causes are of, in alphabetical order
_TELLING = {
    ("gain", "panel"): "a mirror ball on the stage shows where the panel stands; a light meter its brightness",
    ("panel", "panel"): "a mirror ball on the stage",
    ("exposure", "gain"): "images under another light of this rig",
    ("black", "exposure"): "a dark frame (lightopt capture --dark)",
    ("black", "gain"): "a dark frame (lightopt capture --dark)",
    ("camera", "camera"): "a calibration board on the tilted stage",
}
_ANOTHER_POSTURE = "images of another posture, with the stage rotated and tilted"
SURE = 3.0  # a blur is reported whose variance is so many standard errors
LEAST_DARK = 0.1  # a dark level that is off by less is not reported [sensor level]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fault, of the kinds of `_KINDS`."""

    kind: str
    light: str = ""  # whose fault it is; empty where it is no light's. For ``swap`` both names
    size: float  # share of the brightness, sensor levels, mm, degrees, px, or a number; of a shift or turn the length
    # its components by axis, signed, in the same unit; that of a single number has no name
    parts: dict[str, float] = field(default_factory=dict[str, float])
    error: float = 0.0  # standard error of `size`
    limit: float | None = None  # within tolerance up to this size; None for what is reported only
    alternatives: tuple[tuple[str, str], ...] = ()  # what explains the images as well: kinds and lights
    note: str = ""  # what its size in words ends with

    @property
    def exceeds(self) -> bool:
        """Whether the rig has left its tolerances."""
        return self.limit is not None and self.size > self.limit

    @property
    def cause(self) -> str:
        """The fault in words, or all that it may be."""
        return ", or ".join(fault_name(*one) for one in ((self.kind, self.light), *self.alternatives))

    @property
    def amount(self) -> str:
        _, factor, digits, unit = _KINDS[self.kind]
        sign, value = ("+", self.parts[""]) if "" in self.parts else ("", self.size)
        error = f" ± {factor * self.error:.{digits}f}" if self.error else ""
        axes = ", ".join(f"{axis} {part:+.{digits}f}" for axis, part in self.parts.items() if axis)
        return f"{factor * value:{sign}.{digits}f}{error}{unit}{f' ({axes})' if axes else ''}{self.note}"

    @property
    def limit_text(self) -> str:
        if not self.limit:
            return "none" if self.limit is None else "none allowed"
        _, factor, _, unit = _KINDS[self.kind]
        return f"{factor * self.limit:.3g}{unit}"

    @property
    def remedy(self) -> str:
        """What would tell the causes apart; empty where there is one."""
        own = self.kind.partition("_")[0]
        others = [kind.partition("_")[0] for kind, _ in self.alternatives]
        texts = [_TELLING.get((min(own, other), max(own, other)), _ANOTHER_POSTURE) for other in others]
        return "; ".join(dict.fromkeys(texts))

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "light": self.light,
            "cause": self.cause,
            "amount": self.amount,
            "size": round(self.size, 6),
            "components": {axis or "value": round(value, 6) for axis, value in self.parts.items()},
            "standard_error": round(self.error, 6),
            "limit": self.limit,
            "exceeds_limit": self.exceeds,
            "cannot_tell_from": [fault_name(*one) for one in self.alternatives],
            "what_would_tell": self.remedy,
        }


def fault_name(kind: str, light: str) -> str:
    return _KINDS[kind][0].format(light)


def group_finding(group: Group, theta: Float64, covariance: Float64, alternatives: Sequence[Group]) -> Finding:
    """A finding of a group of parameters.

    theta, covariance: Of all parameters, shapes (K,) and (K, K).
    """
    unit = math.degrees(1.0) if group.kind.endswith("turn") else 1.0
    value, spread = unit * theta[group.where], unit**2 * covariance[group.where, group.where]
    if group.kind in ("gain", "exposure"):
        value = np.expm1(value)
    size = float(np.linalg.norm(value))
    along = value / max(size, 1e-12)
    axes = _AXES.get(group.kind.partition("_")[0], ("",))
    return Finding(
        kind=group.kind,
        light=group.light,
        size=size,
        parts=dict(zip(axes, value.tolist(), strict=False)),
        error=float(np.sqrt(along @ spread @ along)),
        limit=unit * group.limit,
        alternatives=tuple((other.kind, other.light) for other in alternatives),
    )


def swap_findings(exchanged: Mapping[str, str]) -> list[Finding]:
    """A finding of lights that show each other's image; none where each shows its own."""
    if not exchanged:
        return []
    text = ", ".join(f"images of {name} show {other}" for name, other in exchanged.items())
    return [Finding(kind="swap", light=text, size=len(exchanged), limit=0.0, note=f" lights: {text}")]


def dark_findings(images: Sequence[Observation], good: Sequence[Observation], limit: float) -> list[Finding]:
    """A finding of the level of frames without light, if a set has them: it is subtracted from the images.

    good: Images of a known good set; empty without one.
    """
    some = [[float(np.mean(o.subtracted)) for o in of if not isinstance(o.subtracted, float)] for of in (images, good)]
    own, before = (float(np.median(levels)) if levels else 0.0 for levels in some)
    off = own - before
    if not some[0] or abs(off) <= LEAST_DARK:
        return []
    return [Finding(kind="black", size=abs(off), parts={"": off}, limit=limit, note=" in frames without light")]


def focus_findings(variance: float, error: float, limit: float) -> list[Finding]:
    """A finding of a blur that exceeds the limit [px]; its variance with a standard error [px²]."""
    if variance < max(limit**2, SURE * error):
        return []
    blur = math.sqrt(variance)
    return [Finding(kind="focus", size=blur, error=0.5 * error / blur, limit=limit)]


def spot_findings(spots: Sequence[Spot], side: int) -> list[Finding]:
    """Dust, on the part (no fault of the rig) and on lens or sensor; side: of the blocks [px]."""
    found: list[Finding] = []
    for where, kind, limit in (("lens", "dust_lens", 0.0), ("part", "dust_part", None), ("unknown", "dust_part", None)):
        some = [spot for spot in spots if spot.where == where]
        if some:
            spots_px = [(side * (s.column + 0.5), side * (s.row + 0.5)) for s in some[:3]]
            places = "; ".join(f"column {column:.0f}, row {row:.0f}" for column, row in spots_px)
            more = ", …" if len(some) > 3 else ""
            note = f" {'place' if len(some) == 1 else 'places'} (at {places} in posture {some[0].posture}{more})"
            others = (("dust_lens", ""),) if where == "unknown" else ()
            found.append(Finding(kind=kind, size=len(some), limit=limit, alternatives=others, note=note))
    return found
