"""Whether the unit of a mesh file can be right: the part's size against what the camera sees."""

from dataclasses import dataclass

import numpy as np

from lightopt.config import PartConfig
from lightopt.core.units import MM_PER_UNIT
from lightopt.scene._camera import PinholeCamera, pixel_directions

# a part whose longest side is not between these shares of the view's shorter side is suspected of a wrong unit
ABSURD = (1.0 / 15.0, 2.5)

SENSIBLE = (0.15, 1.3)  # a unit is proposed where it brings the part's longest side between these shares


@dataclass(frozen=True)
class UnitGuess:
    """What other units would make of a part that does not fit the view at all.

    likely: Those that would make sense of it
    """

    unit: str
    likely: tuple[str, ...]
    text: str


def view_size(camera: PinholeCamera) -> tuple[float, float] | None:
    """Width and height of the view along the image's middle lines on the table [mm]; None where a ray misses it."""
    w, h = float(camera.width), float(camera.height)
    directions = pixel_directions(camera, np.array([0.0, w, 0.5 * w, 0.5 * w]), np.array([0.5 * h, 0.5 * h, 0.0, h]))
    down = -directions[:, 2]
    if down.min() <= 1e-9:
        return None
    at = camera.position + directions * (camera.position[2] / down)[:, None]
    return float(np.linalg.norm(at[1] - at[0])), float(np.linalg.norm(at[3] - at[2]))


def is_absurd(longest: float, view: float) -> bool:
    """Whether a part of this longest side [mm] is far too small or large for a view of this shorter side [mm]."""
    return not ABSURD[0] <= longest / view <= ABSURD[1]


def likely_units(longest: float, view: float, unit: str) -> tuple[str, ...]:
    """Units that would make sense of a part that does not fit the view at all; none where it does.

    longest: The part's longest side as it is read now [mm]
    view: The view's shorter side [mm]
    """
    if not is_absurd(longest, view):
        return ()
    shares = {name: longest / view * mm / MM_PER_UNIT[unit] for name, mm in MM_PER_UNIT.items()}
    return tuple(name for name, share in shares.items() if SENSIBLE[0] <= share <= SENSIBLE[1])


def guess_unit(part: PartConfig, longest: float, view: float) -> UnitGuess | None:
    """Units that the part's file is more probably in; None where the part fits the view, or no unit explains it.

    longest: Its longest side as it is read now [mm]
    view: The view's shorter side [mm]
    """
    # formats that carry their unit: GLB is in metres, STEP is converted to millimetres as it is read
    unit = part.mesh.units or ("m" if part.mesh.file.lower().endswith(".glb") else "mm")
    likely = likely_units(longest, view, unit)
    if not likely:
        return None
    ratios = {name: MM_PER_UNIT[name] / MM_PER_UNIT[unit] for name in likely}
    factors = {name: f"{ratio:.4g}" if ratio >= 1.0 else f"1/{1.0 / ratio:.4g}" for name, ratio in ratios.items()}
    likely_text = " or ".join(
        f"{name} ({longest * ratios[name]:.4g} mm, a factor of {factors[name]})" for name in likely
    )
    read = f"Read as {unit}, the part's longest side is {longest:.4g} mm"
    text = f"a wrong unit? {read}; it would be about as large as the view if the file were in {likely_text}"
    return UnitGuess(unit, likely, text)
