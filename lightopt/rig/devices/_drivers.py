"""The drivers by the names that rig files use."""

from __future__ import annotations

from collections.abc import Callable

from lightopt.rig.devices._ccs import open_ccs
from lightopt.rig.devices._lights import LightSettings
from lightopt.rig.devices._log import SerialLog
from lightopt.rig.devices._roles import LightController
from lightopt.rig.devices._sa import open_sa
from lightopt.rig.devices._template import open_template


def light_drivers() -> dict[str, Callable[[LightSettings, SerialLog | None], LightController]]:
    """What opens a light controller, by the name of its protocol."""
    return {"ccs": open_ccs, "sa": open_sa, "template": open_template}
