"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. The one home of Pillow."""

from lightopt.report._chart import ChartPanel, draw_chart
from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._fit_pictures import fit_chart, residual_picture
from lightopt.report._frames_drawing import frames_drawing
from lightopt.report._inspection_batch import BatchRow, batch_report
from lightopt.report._inspection_pictures import defect_overlay
from lightopt.report._inspection_report import inspection_report
from lightopt.report._inspection_tables import (
    dark_told,
    defect_table,
    placement_told,
    surface_table,
    surface_told,
)
from lightopt.report._legend import with_legend
from lightopt.report._optimum_blind import blind_pictures
from lightopt.report._optimum_report import optimum_report
from lightopt.report._rig_drawing import rig_drawing

__all__ = [
    "BatchRow",
    "ChartPanel",
    "add_contact_sheets",
    "batch_report",
    "blind_pictures",
    "contact_sheet",
    "dark_told",
    "defect_overlay",
    "defect_table",
    "draw_chart",
    "fit_chart",
    "frames_drawing",
    "inspection_report",
    "optimum_report",
    "placement_told",
    "residual_picture",
    "rig_drawing",
    "surface_table",
    "surface_told",
    "with_legend",
]
