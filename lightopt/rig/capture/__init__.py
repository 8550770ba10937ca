"""Capture sessions: a plan that is checked before anything moves, and a run whose images survive any interruption.

- plan: ``_capture_plan.py`` (the capture as data, checked against limits before anything is opened), ``_wiring.py``
  (which device plays which role);
- devices: ``_connect.py`` (opens real or simulated ones), ``_safe_devices.py`` (lights off and stage stopped on every
  way out, never longer on than allowed), ``_lights_off.py``, ``_manual_control.py``;
- run: ``_capture.py`` (order of steps), ``_acquisition.py`` (lights, settling, frames, their exposures);
- images: ``_image_checks.py`` (and repeatability of the stage), ``_captured_set.py`` (on disk).
"""

from lightopt.rig.capture._acquisition import Timing as Timing
from lightopt.rig.capture._capture import CaptureResult as CaptureResult, capture as capture
from lightopt.rig.capture._capture_plan import (
    CaptureOptions as CaptureOptions,
    CapturePlan as CapturePlan,
    cycle_time as cycle_time,
    make_plan as make_plan,
)
from lightopt.rig.capture._captured_set import check_folder as check_folder
from lightopt.rig.capture._connect import check_devices as check_devices, connect_devices as connect_devices
from lightopt.rig.capture._lights_off import switch_off as switch_off
from lightopt.rig.capture._manual_control import (
    check_angles as check_angles,
    check_level as check_level,
    check_on_time as check_on_time,
    check_snap as check_snap,
    controller_place as controller_place,
    device_statuses as device_statuses,
    hold_light as hold_light,
    snap as snap,
)
from lightopt.rig.capture._safe_devices import Devices as Devices
from lightopt.rig.capture._wiring import wiring_of as wiring_of
