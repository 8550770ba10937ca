"""Pictures for people: contact sheets, drawings of rigs and of the conventions. The one home of Pillow."""

from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._frames_drawing import frames_drawing
from lightopt.report._rig_drawing import rig_drawing

__all__ = ["add_contact_sheets", "contact_sheet", "frames_drawing", "rig_drawing"]
