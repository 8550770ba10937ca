"""Verification of a rig: predicted against captured images, and the causes of what differs, with their sizes.

Entry: ``verify_set(rig, part, image_set, ...) -> Verification``.
"""

from lightopt.estimate.verification._comparison import LightComparison as LightComparison
from lightopt.estimate.verification._findings import Finding as Finding
from lightopt.estimate.verification._parameters import VerifyLimits as VerifyLimits
from lightopt.estimate.verification._verify import (
    HISTORY_NAME as HISTORY_NAME,
    REPORT_NAME as REPORT_NAME,
    Verification as Verification,
    append_history as append_history,
    plan_limits as plan_limits,
    verify_folder as verify_folder,
    verify_set as verify_set,
)
