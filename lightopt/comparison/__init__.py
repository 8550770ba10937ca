"""Lighting systems compared by what their images of the same part show.

:func:`compare_lighting` designs each system for the part, writes each design with its report, and writes the
comparison: ``comparison.json``, ``comparison.csv`` and ``report.html``.
"""

from ._compare import PRESETS, check_presets, compare_lighting, preset_files
from ._results import answer_text, systems_table
