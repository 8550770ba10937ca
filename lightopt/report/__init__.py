"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. Home of matplotlib and Pillow.

Those of ``lightopt inspect`` are in :mod:`lightopt.report.inspection`.
"""

from lightopt.report._charts import chart
from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._design_blind_spots import blind_pictures
from lightopt.report._design_plan import exposure_table, posture_table, search_text, sets_text, tolerance_table
from lightopt.report._design_report import design_report
from lightopt.report._drawing import figure_image, fixed_style
from lightopt.report._fit_pictures import fit_chart, residual_picture
from lightopt.report._page import Page, Section, SurfaceView, Table
from lightopt.report._page_html import page_html
from lightopt.report._rig_drawing import rig_drawing
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer

__all__ = [
    "ColouredSurface",
    "Page",
    "Section",
    "SurfaceClass",
    "SurfaceLayer",
    "SurfaceView",
    "Table",
    "add_contact_sheets",
    "blind_pictures",
    "chart",
    "contact_sheet",
    "design_report",
    "exposure_table",
    "figure_image",
    "fit_chart",
    "fixed_style",
    "page_html",
    "posture_table",
    "residual_picture",
    "rig_drawing",
    "search_text",
    "sets_text",
    "tolerance_table",
]
