"""Capture sessions: a plan that is checked before anything moves, and a run whose images survive any interruption.

- plan: ``_capture_plan.py`` (the capture as data, checked against limits before anything is opened), ``_wiring.py``
  (which device plays which role);
- devices: ``_connect.py`` (opens real or simulated ones), ``_safe_devices.py`` (lights off and stage stopped on every
  way out, never longer on than allowed), ``_lights_off.py``, ``_manual_control.py``;
- run: ``_capture.py`` (order of steps), ``_acquisition.py`` (lights, settling, frames, their exposures);
- images: ``_image_checks.py`` (and repeatability of the stage), ``_captured_set.py`` (on disk).
"""

from ._capture import CaptureResult, capture as capture
from ._capture_plan import CaptureOptions as CaptureOptions, CapturePlan, cycle_time, make_plan as make_plan
from ._captured_set import check_folder
from ._connect import check_devices, connect_devices
from ._lights_off import switch_off
from ._manual_control import (
    check_angles,
    check_level,
    check_on_time,
    check_snap,
    controller_place,
    device_statuses,
    hold_light,
    snap,
)
from ._safe_devices import Devices
from ._wiring import wiring_of
