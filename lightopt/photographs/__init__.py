"""One's own photographs: from images, a table of lights and a calibration to rig, part and image set."""

from lightopt.photographs._import import import_photographs as import_photographs
from lightopt.photographs._inputs import ImportOptions as ImportOptions
