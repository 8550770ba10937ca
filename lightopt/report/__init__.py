"""Pictures for people: contact sheets of image sets, drawings of rigs and of the conventions. The one home of Pillow."""

from lightopt.report._contact_sheet import contact_sheet

__all__ = ["contact_sheet"]
