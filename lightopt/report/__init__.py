"""Pictures for people: contact sheets, drawings, charts of fits. The one home of Pillow."""

from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._fit_pictures import fit_chart, residual_picture
from lightopt.report._frames_drawing import frames_drawing
from lightopt.report._inspection_pictures import defect_overlay
from lightopt.report._rig_drawing import rig_drawing

__all__ = [
    "add_contact_sheets",
    "contact_sheet",
    "defect_overlay",
    "fit_chart",
    "frames_drawing",
    "residual_picture",
    "rig_drawing",
]
