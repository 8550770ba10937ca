"""What was found: each fault with its size, its limit, what else it might be, and what would tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._parameters import Group, axes_of
from lightopt.estimate.verification._spots import Spot

_NAMES = {
    "gain": "gain of {}",
    "exposure": "exposure",
    "black": "black level",
    "part_shift": "part moved",
    "part_turn": "part turned",
    "camera_shift": "camera moved",
    "camera_turn": "camera turned",
    "panel_shift": "panel of {} moved",
    "panel_turn": "panel of {} turned",
    "swap": "lights exchanged",
    "focus": "focus",
    "dust_part": "dust or a defect on the part",
    "dust_lens": "dust on lens or sensor",
}
_UNITS = {"gain": "%", "exposure": "%", "black": "levels", "focus": "px"}

_TELLING = (
    ({"gain", "panel_shift"}, "a mirror ball on the stage shows where the panel stands; a light meter its brightness"),
    ({"gain", "panel_turn"}, "a mirror ball on the stage shows where the panel stands; a light meter its brightness"),
    ({"gain", "exposure"}, "images under another light of this rig"),
    ({"panel_shift", "panel_turn"}, "a mirror ball on the stage"),
    ({"part_shift", "camera_shift"}, "images of another posture, with the stage rotated"),
    ({"part_shift", "camera_turn"}, "images of another posture, with the stage rotated"),
    ({"part_turn", "camera_turn"}, "images of another posture, with the stage rotated"),
    ({"part_turn", "camera_shift"}, "images of another posture, with the stage rotated"),
    ({"camera_shift", "camera_turn"}, "a calibration board on the tilted stage"),
    ({"part_shift", "part_turn"}, "images of another posture, with the stage tilted"),
    ({"part_shift", "panel_shift"}, "images of another posture, with the stage rotated"),
    ({"black", "exposure"}, "a dark frame (lightopt capture --dark)"),
    ({"black", "gain"}, "a dark frame (lightopt capture --dark)"),
    ({"dust_part", "dust_lens"}, "images of another posture, with the stage rotated"),
)


LEAST_DARK = 0.1  # a dark level that is off by less is not reported [sensor level]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fault.

    kind: ``gain``, ``exposure``, ``black``, ``part_shift``, ``part_turn``, ``camera_shift``, ``camera_turn``,
        ``panel_shift``, ``panel_turn``, ``swap``, ``focus``, ``dust_part`` or ``dust_lens``.
    light: Whose fault it is; empty where it is no light's. For ``swap`` both names.
    size: Share of the brightness, sensor levels, mm, degrees, px, or a number of spots or lights; the length of a shift
        or a rotation.
    parts: Its components by axis, signed, in the same unit; empty for those that have none.
    error: Standard error of `size`.
    limit: Within tolerance up to this size; None for what is reported only.
    alternatives: What explains the images as well: kinds and lights.
    remedy: What would tell; empty where nothing needs to.
    """

    kind: str
    light: str = ""
    size: float
    parts: dict[str, float]
    error: float = 0.0
    limit: float | None = None
    alternatives: tuple[tuple[str, str], ...] = ()
    remedy: str = ""
    detail: str = ""

    @property
    def exceeds(self) -> bool:
        """Whether the rig has left its tolerances."""
        return self.limit is not None and self.size > self.limit

    @property
    def cause(self) -> str:
        """The fault in words, or all that it may be."""
        return ", or ".join(_NAMES[kind].format(light) for kind, light in ((self.kind, self.light), *self.alternatives))

    @property
    def amount(self) -> str:
        """Its size in words."""
        if self.kind == "swap":
            return self.light
        if self.kind.startswith("dust"):
            return f"{self.size:.0f} place{'' if self.size == 1.0 else 's'}{self.detail}"
        unit = _UNITS.get(self.kind, "°" if self.kind.endswith("turn") else "mm")
        if self.kind in ("gain", "exposure"):
            return f"{100.0 * self.parts['']:+.2f} % ± {100.0 * self.error:.2f} %"
        digits = 3 if unit in ("°", "mm") else 2
        space = "" if unit == "°" else " "
        value = self.parts.get("", self.size)
        sign = "+" if "" in self.parts and self.kind != "focus" else ""
        inside = ", ".join(f"{axis} {part:+.{digits}f}" for axis, part in self.parts.items() if axis)
        error = f" ± {self.error:.{digits}f}" if self.error else ""
        return f"{value:{sign}.{digits}f}{error}{space}{unit}{f' ({inside})' if inside else ''}{self.detail}"

    @property
    def limit_text(self) -> str:
        """The limit in words."""
        if self.limit is None:
            return "none"
        if self.kind in ("gain", "exposure"):
            return f"{100.0 * self.limit:g} %"
        unit = _UNITS.get(self.kind, "°" if self.kind.endswith("turn") else "mm")
        return "none allowed" if self.limit == 0.0 else f"{self.limit:.3g}{'' if unit == '°' else ' '}{unit}"

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
            "cannot_tell_from": [_NAMES[kind].format(light) for kind, light in self.alternatives],
            "what_would_tell": self.remedy,
        }


def group_finding(
    group: Group, theta: Float64, covariance: Float64, alternatives: Sequence[Group], *, distance: float = 0.0
) -> Finding:
    """A finding of a group of parameters.

    theta, covariance: Of all parameters, shapes (K,) and (K, K).
    distance: Of the panel's centre from the origin [mm].
    """
    value, limit, detail = theta[group.where].copy(), group.limit, ""
    spread = covariance[group.where, group.where]
    if group.kind in ("gain", "exposure"):
        value = np.expm1(value)
    if group.kind.endswith("turn"):
        value, spread, limit = np.degrees(value), np.degrees(np.degrees(spread)), math.degrees(limit)
    size = float(np.linalg.norm(value))
    along = value / max(size, 1e-12)
    if group.kind == "panel_shift":
        detail = f", {math.degrees(math.atan(float(np.hypot(*value[:2])) / distance)):.2f}° as seen from the origin"
    return Finding(
        kind=group.kind,
        light=group.light,
        size=size,
        parts=dict(zip(axes_of(group), value.tolist(), strict=True)),
        error=float(np.sqrt(along @ spread @ along)),
        limit=limit,
        alternatives=tuple((other.kind, other.light) for other in alternatives),
        remedy=telling(group.kind, [other.kind for other in alternatives]),
        detail=detail,
    )


def telling(kind: str, others: Sequence[str]) -> str:
    """What would tell causes apart; empty where there is one."""
    if not others:
        return ""
    texts = [text for pair, text in _TELLING if kind in pair and any(pair == {kind, other} for other in others)]
    return "; ".join(dict.fromkeys(texts)) or "images of another posture, or a calibration of the rig"


def group_name(group: Group) -> str:
    """A group in words."""
    return _NAMES[group.kind].format(group.light)


def swap_findings(exchanged: Mapping[str, str]) -> list[Finding]:
    """A finding of lights that show each other's image; none where each shows its own."""
    if not exchanged:
        return []
    text = ", ".join(f"images of {name} show {other}" for name, other in exchanged.items())
    return [Finding(kind="swap", light=text, size=float(len(exchanged)), parts={}, limit=0.0)]


def dark_findings(images: Sequence[Observation], good: Sequence[Observation], limit: float) -> list[Finding]:
    """A finding of the level of frames without light, if a set has them: it is subtracted from the images.

    good: Images of a known good set; empty without one.
    """

    def level(some: Sequence[Observation]) -> float | None:
        found = [float(np.mean(o.subtracted)) for o in some if not isinstance(o.subtracted, float)]
        return float(np.median(found)) if found else None

    own, before = level(images), level(good)
    if own is None or abs(own - (before or 0.0)) <= LEAST_DARK:
        return []
    off = own - (before or 0.0)
    return [Finding(kind="black", size=abs(off), parts={"": off}, limit=limit, detail=" in frames without light")]


def focus_findings(blur: float | None, limit: float) -> list[Finding]:
    """A finding of a blur that exceeds the limit [px]."""
    return [Finding(kind="focus", size=blur, parts={"": blur}, limit=limit)] if blur and blur > limit else []


def spot_findings(spots: Sequence[Spot]) -> list[Finding]:
    """Dust, on the part (no fault of the rig) and on lens or sensor."""
    found: list[Finding] = []
    for where, kind, limit in (("lens", "dust_lens", 0.0), ("part", "dust_part", None), ("unknown", "dust_part", None)):
        some = [spot for spot in spots if spot.where == where]
        if some:
            places = "; ".join(f"column {s.column:.0f}, row {s.row:.0f}" for s in some[:3])
            others = (("dust_lens", ""),) if where == "unknown" else ()
            found.append(
                Finding(
                    kind=kind, size=float(len(some)), parts={}, limit=limit, alternatives=others,
                    remedy=telling("dust_part", ["dust_lens"]) if others else "",
                    detail=f" (at {places} in posture {some[0].posture}{', …' if len(some) > 3 else ''})",
                )
            )  # fmt: skip
    return found
