"""Driving the rig: the plan, the devices it needs, and a run that loses nothing.

The only room that chooses between the virtual bench and real devices.
"""

from lightopt.capture._options import CaptureOptions
from lightopt.capture._plan import Plan, PostureTask, Step, make_plan
from lightopt.capture._wiring import Wiring, wiring_of

__all__ = ["CaptureOptions", "Plan", "PostureTask", "Step", "Wiring", "make_plan", "wiring_of"]
