"""Driving the rig: the plan, the devices it needs, and a run that loses nothing.

The only room that chooses between the virtual bench and real devices.
"""

from lightopt.capture._connect import check_devices, connect_devices
from lightopt.capture._devices import Devices
from lightopt.capture._lit import LitCheck, Predictions, check_lit, lights_left_on, predict
from lightopt.capture._manual import (
    DeviceRow,
    burn,
    check_angles,
    check_burning,
    check_exposure,
    check_level,
    device_rows,
    snap,
    snap_s,
)
from lightopt.capture._merge import merge_bracket
from lightopt.capture._options import CaptureOptions
from lightopt.capture._plan import Plan, PostureTask, Step, make_plan
from lightopt.capture._records import check_folder
from lightopt.capture._run import Captured, CaptureReport, Connect, capture
from lightopt.capture._switch_off import SwitchedOff, switch_off
from lightopt.capture._timing import Timing
from lightopt.capture._virtual import start_bench
from lightopt.capture._wiring import Wiring, wiring_of

__all__ = [
    "CaptureOptions",
    "CaptureReport",
    "Captured",
    "Connect",
    "DeviceRow",
    "Devices",
    "LitCheck",
    "Plan",
    "PostureTask",
    "Predictions",
    "Step",
    "SwitchedOff",
    "Timing",
    "Wiring",
    "burn",
    "capture",
    "check_angles",
    "check_burning",
    "check_devices",
    "check_exposure",
    "check_folder",
    "check_level",
    "check_lit",
    "connect_devices",
    "device_rows",
    "lights_left_on",
    "make_plan",
    "merge_bracket",
    "predict",
    "snap",
    "snap_s",
    "start_bench",
    "switch_off",
    "wiring_of",
]
