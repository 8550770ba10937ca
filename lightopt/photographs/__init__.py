"""One's own photographs: from images, a table of lights and a calibration to rig, part and image set."""

from ._import import ImportOptions, import_photographs
