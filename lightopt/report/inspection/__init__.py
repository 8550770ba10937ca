"""Pictures, tables and pages of ``lightopt inspect``."""

from ._pictures import defect_overlay
from ._report import (
    batch_report,
    dark_text,
    defect_table,
    detection_table,
    inspection_report,
    missed_defects,
    placement_text,
    surface_notes,
    surface_table,
    threshold_text,
)
