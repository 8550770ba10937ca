"""Tables, pictures and the page of ``lightopt optimize``."""

from lightopt.report.design._from_images import (
    chosen_table as chosen_table,
    defects_table as defects_table,
    from_images_report as from_images_report,
    scores_table as scores_table,
)
from lightopt.report.design._pictures import capture_text as capture_text
from lightopt.report.design._plan import (
    blind_tables as blind_tables,
    defect_tables as defect_tables,
    exposure_note as exposure_note,
    exposure_table as exposure_table,
    plan_proof as plan_proof,
    posture_facts as posture_facts,
    posture_table as posture_table,
    tolerance_table as tolerance_table,
)
from lightopt.report.design._report import best_table as best_table, design_report as design_report
from lightopt.report.design._surface import blind_pictures as blind_pictures
