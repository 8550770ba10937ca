"""Pictures for people: contact sheets of image sets, drawings of rigs and of the conventions. The one home of Pillow."""

from lightopt.report._contact_sheet import contact_sheet
from lightopt.report._rig_drawing import rig_drawing

__all__ = ["contact_sheet", "rig_drawing"]
