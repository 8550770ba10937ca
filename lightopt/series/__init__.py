"""Series of images of one light: derived images, slopes of a mirror surface, and the picture that looks flat in it."""

from lightopt.series._derived import DERIVED_FOLDER as DERIVED_FOLDER, write_derived as write_derived
