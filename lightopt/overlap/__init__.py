"""Where the saturated regions of several images overlap: the table and the map (paper, figure 11), of any image set."""

from lightopt.overlap._overlap import Overlap, find_overlaps, overlap_map_name, write_overlap_map
from lightopt.overlap._write import write_overlaps

__all__ = ["Overlap", "find_overlaps", "overlap_map_name", "write_overlap_map", "write_overlaps"]
