"""Images on disk: EXR, PNG and the sets that rendering and capturing share. The one home of OpenImageIO."""

from lightopt.images._atomic import (
    write_atomically,
    write_bytes_atomic,
    write_npz_atomic,
    write_text_atomic,
)
from lightopt.images._exr import read_exr, read_exr_metadata, write_exr
from lightopt.images._folders import make_folder
from lightopt.images._manifest import (
    CAME_BACK_KEY,
    ENDED_DARK_KEY,
    EVENTS_KEY,
    MANIFEST_NAME,
    GeometryEntry,
    ImageEntry,
    Manifest,
    SourceFile,
)
from lightopt.images._names import dark_name, exr_name, geometry_name, png_name, posture_folder, sheet_name
from lightopt.images._parse import parse_manifest, read_manifest
from lightopt.images._png import read_png, read_png_metadata, write_png
from lightopt.images._reader import ImageSet, LoadedImage, read_image_set
from lightopt.images._result_folder import ResultFolder
from lightopt.images._resume import remove_file, remove_image_set, resumable_manifest
from lightopt.images._writer import ImageSetWriter
from lightopt.transforms import Posture

__all__ = [
    "CAME_BACK_KEY",
    "ENDED_DARK_KEY",
    "EVENTS_KEY",
    "MANIFEST_NAME",
    "GeometryEntry",
    "ImageEntry",
    "ImageSet",
    "ImageSetWriter",
    "LoadedImage",
    "Manifest",
    "Posture",
    "ResultFolder",
    "SourceFile",
    "dark_name",
    "exr_name",
    "geometry_name",
    "make_folder",
    "parse_manifest",
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
    "write_atomically",
    "write_bytes_atomic",
    "write_exr",
    "write_npz_atomic",
    "write_png",
    "write_text_atomic",
]
