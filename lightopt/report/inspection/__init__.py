"""Pictures, tables and pages of ``lightopt inspect``."""

from lightopt.report.inspection._pictures import defect_overlay
from lightopt.report.inspection._report import batch_report, inspection_report
from lightopt.report.inspection._tables import (
    dark_text,
    defect_table,
    detection_table,
    placement_text,
    surface_notes,
    surface_table,
)

__all__ = [
    "batch_report",
    "dark_text",
    "defect_overlay",
    "defect_table",
    "detection_table",
    "inspection_report",
    "placement_text",
    "surface_notes",
    "surface_table",
]
