"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. Home of matplotlib and Pillow.

Those of ``lightopt optimize`` are in :mod:`lightopt.report.design`, those of ``lightopt inspect`` in
:mod:`lightopt.report.inspection`, those of ``lightopt calibrate`` and ``verify`` in :mod:`lightopt.report.rig`.
"""

from ._contact_sheet import add_contact_sheets, contact_sheet
from ._fit_pictures import fit_chart, residual_picture
from ._page import (
    Answer,
    Gallery,
    Note,
    Page as Page,
    Picture,
    Section as Section,
    SurfaceView as SurfaceView,
    Table as Table,
    Warnings,
    camera_picture,
    page_html as page_html,
)
from ._pictures import chart, figure_image, fixed_style, png_bytes
from ._rig_drawing import rig_drawing
from ._surface import ColouredSurface as ColouredSurface, SurfaceClass as SurfaceClass, SurfaceLayer as SurfaceLayer
