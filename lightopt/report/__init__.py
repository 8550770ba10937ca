"""Pictures and pages for people: contact sheets, drawings, charts, HTML reports. Home of matplotlib and Pillow.

Those of ``lightopt optimize`` are in :mod:`lightopt.report.design`, those of ``lightopt inspect`` in
:mod:`lightopt.report.inspection`.
"""

from lightopt.report._calibration import (
    board_sheet as board_sheet,
    calibration_lines as calibration_lines,
    calibration_report as calibration_report,
)
from lightopt.report._contact_sheet import add_contact_sheets as add_contact_sheets, contact_sheet as contact_sheet
from lightopt.report._drawing import chart as chart, figure_image as figure_image, fixed_style as fixed_style
from lightopt.report._fit_pictures import fit_chart as fit_chart, residual_picture as residual_picture
from lightopt.report._images import png_bytes as png_bytes
from lightopt.report._page import (
    Answer as Answer,
    Gallery as Gallery,
    Note as Note,
    Page as Page,
    Picture as Picture,
    Section as Section,
    SurfaceView as SurfaceView,
    Table as Table,
    Warnings as Warnings,
    camera_picture as camera_picture,
    page_html as page_html,
)
from lightopt.report._rig_drawing import rig_drawing as rig_drawing
from lightopt.report._surface import (
    ColouredSurface as ColouredSurface,
    SurfaceClass as SurfaceClass,
    SurfaceLayer as SurfaceLayer,
)
from lightopt.report._verification import (
    findings_table as findings_table,
    history_chart as history_chart,
    lights_table as lights_table,
    verification_report as verification_report,
)
