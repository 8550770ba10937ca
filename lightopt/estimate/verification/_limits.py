"""How far a rig may be off before it has left its tolerances: limits, given or from a plan."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError

PLAN_FORMAT = "lightopt-result/"


@dataclass(frozen=True, kw_only=True)
class VerifyLimits:
    """Greatest departures that are within tolerance; all above 0.

    gain, exposure: Shares of the brightness of one light, and of all of them.
    black: [sensor level]
    part_mm, part_deg: Shift and rotation of the part from its placement in the part file.
    camera_mm, camera_deg: Shift and rotation of the camera.
    panel_mm: Shift of a panel's centre; where `light_deg` names the light, that is its limit as seen from the origin.
    panel_deg: Rotation of a panel about its own centre.
    blur_px: Standard deviation of the blur at the part's outline beyond that of the pixel.
    light_deg: By light, how far its direction may be off; from a plan.
    """

    gain: float = 0.03
    exposure: float = 0.02
    black: float = 1.0
    part_mm: float = 0.05
    part_deg: float = 0.1
    camera_mm: float = 0.15
    camera_deg: float = 0.02
    panel_mm: float = 2.0
    panel_deg: float = 2.0
    blur_px: float = 1.0
    light_deg: Mapping[str, float] = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        problems = [
            f"limit {one.name}: expected a number above 0, found {value:g}"
            for one in fields(self)
            if isinstance(value := getattr(self, one.name), (int, float)) and not (0.0 < value < math.inf)
        ]
        if problems:
            raise InputError(*problems)

    def panel(self, light: str, distance: float) -> float:
        """Limit of a shift of a panel's centre [mm], whose distance from the origin is given [mm]."""
        angle = self.light_deg.get(light)
        return self.panel_mm if angle is None else distance * math.tan(math.radians(angle))

    @staticmethod
    def names() -> tuple[str, ...]:
        """Limits that are numbers."""
        return tuple(one.name for one in fields(VerifyLimits) if one.name != "light_deg")

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "light_deg": dict(self.light_deg)}


def plan_limits(path: Path) -> dict[str, Any]:
    """Limits from the tolerance analysis of a plan: fields of :class:`VerifyLimits`.

    path: ``result.json`` of ``lightopt optimize --light-tolerance`` or ``--pose-tolerance``, or its folder.
    Raises InputError: It cannot be read, is no such file, or has no tolerances.
    """
    path = path / "result.json" if path.is_dir() else path
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        tolerances = found["tolerances"]
        widest = [(str(w["what"]), str(w["angle"]), float(w["degrees"])) for w in tolerances[-1]["widest"]]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; give result.json of a plan") from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(
            f"{path}: no tolerance analysis in it; expected result.json of lightopt optimize --light-tolerance or "
            "--pose-tolerance"
        ) from error
    lights: dict[str, float] = {}
    for what, angle, degrees in widest:
        if angle in ("elevation", "azimuth"):
            lights[what] = min(degrees, lights.get(what, math.inf))
    part = [degrees for what, _, degrees in widest if what == "part"]
    if zero := [name for name, degrees in (*lights.items(), *(("part", d) for d in part)) if degrees <= 0.0]:
        raise InputError(
            f"{path}: the plan has a tolerance of 0° for {', '.join(dict.fromkeys(zero))}: no rig keeps that; plan "
            "with a lower tolerance target, or leave out the plan and give limits"
        )
    return {"light_deg": lights, **({"part_deg": min(part)} if part else {})}
