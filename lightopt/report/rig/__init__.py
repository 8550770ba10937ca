"""Pages, tables and charts of ``lightopt calibrate`` and ``lightopt verify``; printable boards."""

from ._calibration import board_sheet as board_sheet, calibration_lines, calibration_report
from ._verification import findings_table, history_chart, lights_table, verification_report
