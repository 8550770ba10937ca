"""Tables, pictures and the page of ``lightopt optimize``."""

from lightopt.report.design._plan import (
    blind_tables,
    defect_tables,
    exposure_note,
    exposure_table,
    plan_proof,
    posture_facts,
    posture_table,
    tolerance_table,
)
from lightopt.report.design._report import design_report
from lightopt.report.design._surface import blind_pictures

__all__ = [
    "blind_pictures",
    "blind_tables",
    "defect_tables",
    "design_report",
    "exposure_note",
    "exposure_table",
    "plan_proof",
    "posture_facts",
    "posture_table",
    "tolerance_table",
]
