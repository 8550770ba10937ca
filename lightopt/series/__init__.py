"""Series of images of one light: derived images, slopes of a mirror surface, and the picture that looks flat in it."""

from ._derived import DERIVED_FOLDER, write_derived
from ._inverse_pattern import defects_shown, display_of, inverse_pattern, tilt_residuals
