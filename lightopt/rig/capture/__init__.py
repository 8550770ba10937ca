"""Capture sessions: a plan that is checked before anything moves, and a run whose images survive any interruption.

- plan: ``_plan.py`` (the capture as data), ``_limits.py`` (limits of stage, camera and lights, checked before anything
  is opened), ``_wiring.py`` (which device plays which role);
- devices: ``_connect.py`` (opens real or simulated ones), ``_safe_devices.py`` (lights off and stage stopped on every
  way out), ``_watchdog.py`` (limits how long lights are on), ``_lights_off.py``, ``_manual_control.py``;
- run: ``_capture.py``, ``_session.py`` (order of steps), ``_acquisition.py`` (lights, settling, frames);
- images: ``_image_checks.py``, ``_repeatability.py``, ``_captured_set.py`` (on disk).
"""

from lightopt.rig.capture._acquisition import Timing
from lightopt.rig.capture._capture import CaptureResult, capture
from lightopt.rig.capture._captured_set import check_folder
from lightopt.rig.capture._connect import check_devices, connect_devices
from lightopt.rig.capture._lights_off import switch_off
from lightopt.rig.capture._limits import check_angles, check_exposure, check_level, check_on_time
from lightopt.rig.capture._manual_control import device_statuses, hold_light, snap, snap_on_s
from lightopt.rig.capture._plan import CaptureOptions, CapturePlan, make_plan
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._wiring import start_bench, wiring_of

__all__ = [
    "CaptureOptions",
    "CapturePlan",
    "CaptureResult",
    "Devices",
    "Timing",
    "capture",
    "check_angles",
    "check_devices",
    "check_exposure",
    "check_folder",
    "check_level",
    "check_on_time",
    "connect_devices",
    "device_statuses",
    "hold_light",
    "make_plan",
    "snap",
    "snap_on_s",
    "start_bench",
    "switch_off",
    "wiring_of",
]
