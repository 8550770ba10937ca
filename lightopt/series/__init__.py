"""Series of images of one light: derived images, slopes of a mirror surface, and the picture that looks flat in it."""

from lightopt.series._derived import DERIVED_FOLDER as DERIVED_FOLDER, write_derived as write_derived
from lightopt.series._inverse_pattern import (
    defects_shown as defects_shown,
    display_of as display_of,
    inverse_pattern as inverse_pattern,
    tilt_residuals as tilt_residuals,
)
