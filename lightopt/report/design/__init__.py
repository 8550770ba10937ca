"""Tables, pictures and the page of ``lightopt optimize``."""

from ._from_images import chosen_table, defects_table, from_images_report, scores_table
from ._pictures import capture_text
from ._plan import (
    blind_tables,
    defect_tables,
    exposure_note,
    exposure_table,
    plan_proof,
    posture_facts,
    posture_table,
    tolerance_table,
)
from ._report import best_table, design_report as design_report
from ._surface import blind_pictures
