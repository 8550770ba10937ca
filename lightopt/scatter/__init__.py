"""Defects for trials: a catalogue strewn over the surface that the camera sees, and the part file that names them."""

from lightopt.scatter._scatter import ScatteredDefect, scatter_defects
from lightopt.scatter._write import defects_text, scatter_provenance, write_defects

__all__ = ["ScatteredDefect", "defects_text", "scatter_defects", "scatter_provenance", "write_defects"]
