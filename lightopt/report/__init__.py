"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. Home of matplotlib and Pillow."""

from lightopt.report._charts import chart
from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._drawing import figure_image, fixed_style
from lightopt.report._fit_pictures import fit_chart, residual_picture
from lightopt.report._inspection_batch import batch_report
from lightopt.report._inspection_pictures import defect_overlay
from lightopt.report._inspection_report import inspection_report
from lightopt.report._inspection_tables import (
    dark_text,
    defect_table,
    placement_text,
    surface_notes,
    surface_table,
)
from lightopt.report._optimum_blind import blind_pictures
from lightopt.report._optimum_report import optimum_report
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
    "batch_report",
    "blind_pictures",
    "chart",
    "contact_sheet",
    "dark_text",
    "defect_overlay",
    "defect_table",
    "figure_image",
    "fit_chart",
    "fixed_style",
    "inspection_report",
    "optimum_report",
    "page_html",
    "placement_text",
    "residual_picture",
    "rig_drawing",
    "surface_notes",
    "surface_table",
]
