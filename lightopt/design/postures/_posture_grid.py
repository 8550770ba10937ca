"""The candidate postures: a grid over the stage's ranges, without postures that cannot be used."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.lights import PanelLight
from lightopt.rendering import panels_in_part
from lightopt.scene import Scene, frame_part, part_postures, view_from_part

# of tilt and rotation [°], by default: a stage of ±45° and a full turn then has 80 postures
DEFAULT_POSTURE_STEP = 22.5

# How far the part may leave the view in a posture to choose from [px] by default: no further than a part may be off its
# place, so that its rim is near the image's border anyway. What is outside is not seen in that posture.
DEFAULT_OUTSIDE_PX = 10.0

MOST_POSTURES = 2000  # more candidate postures are refused
_SIDES = ("left", "top", "right", "bottom")


@dataclass(frozen=True)
class ExcludedPosture:
    """A posture in the stage's range that cannot be planned; `kind` is ``view`` or ``part``."""

    posture: Posture
    reason: str
    kind: str


def posture_grid(rig: RigConfig, part: PartConfig, *, step_deg: float) -> tuple[Posture, ...]:
    """Candidate postures: the part's own ones that the stage reaches, then tilts and rotations at a step.

    Each angle takes the multiples of the step within the stage's range, 0 among them, and both ends of the range; a
    range of a full turn or more takes one turn, without its end. An axis that the rig's stage does not have stays at
    0.
    """
    if not (math.isfinite(step_deg) and step_deg > 0.0):
        raise InputError(f"option 'posture_step_deg': expected degrees above 0, found {step_deg:g}")
    # an axis that a given stage lacks does not turn
    tilt_range, rotation_range = rig.stage.elevation_range_deg, rig.stage.rotation_range_deg
    if rig.hardware is not None:
        stage = rig.hardware.stage
        tilt_range = (0.0, 0.0) if stage is None or stage.elevation is None else tilt_range
        rotation_range = (0.0, 0.0) if stage is None or stage.rotation is None else rotation_range
    tilts, rotations = _angles(tilt_range, step_deg), _angles(rotation_range, step_deg)
    if len(tilts) * len(rotations) > MOST_POSTURES:
        raise InputError(
            f"option 'posture_step_deg': at {step_deg:g}° the stage has {len(tilts):,} × {len(rotations):,} postures, "
            f"more than the maximum of {MOST_POSTURES:,}; take a larger step, or narrow the stage's ranges"
        )
    (lowest, highest), (first, last) = tilt_range, rotation_range
    own = [p for p in part_postures(part) if lowest <= p.elevation_deg <= highest and first <= p.rotation_deg <= last]
    return tuple(dict.fromkeys([*own, *(Posture(tilt, rotation) for tilt in tilts for rotation in rotations)]))


def usable_postures(
    scene: Scene, panels: Sequence[PanelLight], *, allow_outside_px: float = DEFAULT_OUTSIDE_PX
) -> tuple[tuple[Posture, ...], tuple[ExcludedPosture, ...]]:
    """The scene's postures that keep the part in view and clear of the lights, and the others with the reason.

    panels: Every position of a light, world frame; the scene's own lights are ignored.
    allow_outside_px: How far the part may leave the view at a side of the image [px].
    """
    usable: list[Posture] = []
    left_out: list[ExcludedPosture] = []
    for posture in scene.postures:
        found = _out_of_view(scene, posture, allow_outside_px)
        if found is None and (inside := panels_in_part(replace(scene, lights=tuple(panels), postures=(posture,)))):
            found = f"a position of {inside[0].light} is inside the part", "part"
        if found is None:
            usable.append(posture)
        else:
            left_out.append(ExcludedPosture(posture, *found))
    if not usable:
        first = left_out[0]
        raise InputError(
            f"no posture of {len(left_out)} is left to choose from: in {first.posture} {first.reason}; change the "
            "part's placement, the stage's pivot or its ranges, let the camera see more, or allow the part to leave "
            "the view (option 'allow_outside_px')"
        )
    return tuple(usable), tuple(left_out)


def _angles(ends: tuple[float, float], step: float) -> list[float]:
    low, high = ends
    if high - low > 360.0:  # of what is more than a turn, the one from 0 on, or as near to it as there is
        low = max(low, min(0.0, high - 360.0))
        high = low + 360.0
    if (high - low) / step > MOST_POSTURES:
        return [low] * (MOST_POSTURES + 1)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    inner = [round(k * step, 9) + 0.0 for k in range(first, last + 1)]
    angles = sorted({low, high, *(angle for angle in inner if low < angle < high)})
    return angles[:-1] if math.isclose(high - low, 360.0) else angles


def _out_of_view(scene: Scene, posture: Posture, allowed: float) -> tuple[str, str] | None:
    framing = frame_part(view_from_part(scene, posture).camera, scene.mesh)
    if framing.nearest <= 0.0:
        return "the part reaches behind the camera", "view"
    if not framing.outside and max(framing.excess) <= allowed:
        return None
    leaves = [
        f"{_pixels(pixels)} at the {side}" for pixels, side in zip(framing.excess, _SIDES, strict=True) if pixels > 0.0
    ]
    limit = "nothing of it is visible" if framing.outside else f"{_pixels(allowed)} are allowed"
    return f"the part leaves the view by {', '.join(leaves)}; {limit}", "view"


def _pixels(amount: float) -> str:
    # rounded up, so that what is more than what is allowed does not read as the same
    return f"{math.ceil(10.0 * amount) / 10.0:g} px"
