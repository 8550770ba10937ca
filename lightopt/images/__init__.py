"""Images on disk: EXR, PNG and the sets that rendering and capturing share. The one home of OpenImageIO."""

from lightopt.images._atomic import make_folder, remove_file, write_bytes_atomic, write_npz_atomic, write_text_atomic
from lightopt.images._exr import read_exr, read_exr_metadata, write_exr
from lightopt.images._file_names import MANIFEST_NAME, dark_name, png_name, posture_folder, sheet_name
from lightopt.images._manifest import (
    DARK_CHECKED_KEY,
    EVENTS_KEY,
    REPEATABILITY_KEY,
    ImageEntry,
    Manifest,
    SourceFile,
    read_manifest,
)
from lightopt.images._overlap import Overlap, find_overlaps, overlap_map_name, write_overlap_map, write_overlaps
from lightopt.images._png import read_png, read_png_metadata, write_png
from lightopt.images._result_folder import ResultFolder
from lightopt.images._set_reader import ImageSet, read_image_set
from lightopt.images._set_writer import ImageSetWriter, remove_image_set, resumable_manifest

__all__ = [
    "DARK_CHECKED_KEY",
    "EVENTS_KEY",
    "MANIFEST_NAME",
    "REPEATABILITY_KEY",
    "ImageEntry",
    "ImageSet",
    "ImageSetWriter",
    "Manifest",
    "Overlap",
    "ResultFolder",
    "SourceFile",
    "dark_name",
    "find_overlaps",
    "make_folder",
    "overlap_map_name",
    "png_name",
    "posture_folder",
    "read_exr",
    "read_exr_metadata",
    "read_image_set",
    "read_manifest",
    "read_png",
    "read_png_metadata",
    "remove_file",
    "remove_image_set",
    "resumable_manifest",
    "sheet_name",
    "write_bytes_atomic",
    "write_exr",
    "write_npz_atomic",
    "write_overlap_map",
    "write_overlaps",
    "write_png",
    "write_text_atomic",
]
