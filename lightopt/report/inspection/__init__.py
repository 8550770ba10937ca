"""Pictures, tables and pages of ``lightopt inspect``."""

from lightopt.report.inspection._pictures import defect_overlay as defect_overlay
from lightopt.report.inspection._report import (
    batch_report as batch_report,
    dark_text as dark_text,
    defect_table as defect_table,
    detection_table as detection_table,
    inspection_report as inspection_report,
    placement_text as placement_text,
    surface_notes as surface_notes,
    surface_table as surface_table,
)
