"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. Home of matplotlib and Pillow.

Those of ``lightopt optimize`` are in :mod:`lightopt.report.design`, those of ``lightopt inspect`` in
:mod:`lightopt.report.inspection`.
"""

from lightopt.report._charts import chart
from lightopt.report._contact_sheet import add_contact_sheets, contact_sheet
from lightopt.report._drawing import figure_image, fixed_style
from lightopt.report._fit_pictures import fit_chart, residual_picture
from lightopt.report._page import Page, Section, SurfaceView, Table, page_html
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
    "chart",
    "contact_sheet",
    "figure_image",
    "fit_chart",
    "fixed_style",
    "page_html",
    "residual_picture",
    "rig_drawing",
]
