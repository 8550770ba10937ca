"""The drivers by the names that rig files use."""

from __future__ import annotations

from collections.abc import Callable

from lightopt.hardware._ccs import open_ccs
from lightopt.hardware._lights import LightSettings
from lightopt.hardware._log import SerialLog
from lightopt.hardware._roles import LightController
from lightopt.hardware._sa import open_sa
from lightopt.hardware._template import open_template

__all__ = ["light_drivers"]


def light_drivers() -> dict[str, Callable[[LightSettings, SerialLog | None], LightController]]:
    """What opens a light controller, by the name of its protocol."""
    return {"ccs": open_ccs, "sa": open_sa, "template": open_template}
