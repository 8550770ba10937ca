"""Images on disk: EXR, PNG and the sets that rendering and capturing share. The one home of OpenImageIO."""

from lightopt.images._atomic import (
    csv_text as csv_text,
    make_folder as make_folder,
    remove_file as remove_file,
    write_bytes_atomic as write_bytes_atomic,
    write_npz_atomic as write_npz_atomic,
    write_text_atomic as write_text_atomic,
)
from lightopt.images._image_files import (
    PhotographFormat as PhotographFormat,
    photograph_format as photograph_format,
    read_exr as read_exr,
    read_metadata as read_metadata,
    read_photograph as read_photograph,
    read_png as read_png,
    write_exr as write_exr,
    write_png as write_png,
)
from lightopt.images._manifest import (
    DARK_CHECKED_KEY as DARK_CHECKED_KEY,
    EVENTS_KEY as EVENTS_KEY,
    MANIFEST_NAME as MANIFEST_NAME,
    REPEATABILITY_KEY as REPEATABILITY_KEY,
    ImageEntry as ImageEntry,
    Manifest as Manifest,
    SourceFile as SourceFile,
    dark_name as dark_name,
    png_name as png_name,
    posture_folder as posture_folder,
    read_manifest as read_manifest,
    sheet_name as sheet_name,
)
from lightopt.images._overlap import (
    Overlap as Overlap,
    find_overlaps as find_overlaps,
    overlap_map_name as overlap_map_name,
    write_overlap_map as write_overlap_map,
    write_overlaps as write_overlaps,
)
from lightopt.images._result_folder import (
    ResultFolder as ResultFolder,
    paths_inside as paths_inside,
    read_listing as read_listing,
    remove_listed as remove_listed,
)
from lightopt.images._set_reader import ImageSet as ImageSet, read_image_set as read_image_set
from lightopt.images._set_writer import (
    ImageSetWriter as ImageSetWriter,
    remove_image_set as remove_image_set,
    resumable_manifest as resumable_manifest,
)
