"""lightopt: decide where the lights go in an appearance-inspection machine, and run it.

Conventions, said once and obeyed everywhere
--------------------------------------------
Units
    Lengths in mm and angles in radians inside the package; degrees in files and on the command line, where field
    names carry the unit (``distance_mm``, ``elevation_deg``). Image values are grey levels: levels of the full scale
    that the reflectance is expressed in (255 unless the part says otherwise), at exposure 1.
World frame
    Origin at the centre of the table top, right-handed, +Z up, the table is the plane Z = 0. Column vectors.
Direction
    (elevation θ, azimuth φ) is ``d = (cosθ·cosφ, cosθ·sinφ, sinθ)``; elevation is measured from the table plane, 90°
    is straight above, and it may pass 90°. ``e_θ = (−sinθ·cosφ, −sinθ·sinφ, cosθ)``, ``e_φ = (−sinφ, cosφ, 0)``,
    ``e_φ × e_θ = d``.
Camera
    At ``distance·d``, looking at the origin. With roll ρ, image right is ``cosρ·e_φ + sinρ·e_θ`` and image up is
    ``−sinρ·e_φ + cosρ·e_θ``. Pixel (0, 0) is the top left one, pixel centres at +0.5; images are arrays (row, column).
Light
    A rectangular panel centred at ``distance·d``, facing the origin, its size along e_φ and e_θ.
Posture
    ``p' = pivot + R·(p − pivot)`` with ``R = Rx(θ_j)·Rz(φ_j)``. The part frame is the world frame at posture (0, 0).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__version__ = "0.2.0"
__all__ = ["__version__", "build_scene", "load_part", "load_rig", "render"]

if TYPE_CHECKING:
    from lightopt.config import load_part, load_rig
    from lightopt.rendering import render
    from lightopt.scene import build_scene

_HOMES = {
    "load_rig": "lightopt.config",
    "load_part": "lightopt.config",
    "build_scene": "lightopt.scene",
    "render": "lightopt.rendering",
}


def __getattr__(name: str) -> object:
    """Import the public functions on first use, so that ``lightopt --help`` stays instant."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
