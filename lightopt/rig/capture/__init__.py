"""Capture sessions: a plan that is checked before anything moves, and a run whose images survive any interruption.

- plan: ``_capture_plan.py`` (the capture as data, checked against limits before anything is opened), ``_wiring.py``
  (which device plays which role);
- devices: ``_connect.py`` (opens real or simulated ones), ``_safe_devices.py`` (lights off and stage stopped on every
  way out, never longer on than allowed), ``_lights_off.py``, ``_manual_control.py``;
- run: ``_capture.py`` (order of steps), ``_acquisition.py`` (lights, settling, frames, their exposures);
- images: ``_image_checks.py`` (and repeatability of the stage), ``_captured_set.py`` (on disk).
"""

from lightopt.rig.capture._acquisition import Timing
from lightopt.rig.capture._capture import CaptureResult, capture as capture
from lightopt.rig.capture._capture_plan import (
    CaptureOptions as CaptureOptions,
    CapturePlan,
    cycle_time,
    make_plan as make_plan,
)
from lightopt.rig.capture._captured_set import check_folder
from lightopt.rig.capture._connect import check_devices, connect_devices
from lightopt.rig.capture._lights_off import switch_off
from lightopt.rig.capture._manual_control import (
    check_angles,
    check_level,
    check_on_time,
    check_snap,
    controller_place,
    device_statuses,
    hold_light,
    snap,
)
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._wiring import wiring_of
