"""Images on disk: EXR, PNG and the sets that rendering and capturing share. The one home of OpenImageIO."""

from ._atomic import csv_text, make_folder, remove_file, write_bytes_atomic, write_npz_atomic, write_text_atomic
from ._image_files import (
    PhotographFormat,
    photograph_format,
    read_exr,
    read_metadata,
    read_photograph,
    read_png,
    write_exr,
    write_png,
)
from ._manifest import (
    DARK_CHECKED_KEY,
    EVENTS_KEY,
    MANIFEST_NAME,
    REPEATABILITY_KEY,
    ImageEntry,
    ImageKey,
    Manifest,
    SourceFile,
    dark_name,
    png_name,
    posture_folder,
    read_manifest,
    sheet_name,
)
from ._overlap import Overlap, find_overlaps, overlap_map_name, write_overlap_map, write_overlaps
from ._result_folder import ResultFolder, paths_inside, read_listing, remove_listed
from ._set_reader import ImageSet, read_image_set as read_image_set
from ._set_writer import ImageSetWriter, remove_image_set, resumable_manifest
