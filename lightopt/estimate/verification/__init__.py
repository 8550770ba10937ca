"""Verification of a rig: predicted against captured images, and the causes of what differs, with their sizes.

Entry: ``verify_set(rig, part, image_set, ...) -> Verification``.
"""

from ._comparison import LightComparison
from ._findings import Finding
from ._parameters import VerifyLimits
from ._rig_adjustment import RigAdjustment, adjust_rig
from ._verify import HISTORY_NAME, REPORT_NAME, Verification, append_history, plan_limits, verify_folder, verify_set
