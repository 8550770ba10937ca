"""Lighting systems to compare with, by name: sample rigs of the package."""

from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from types import MappingProxyType
from typing import Final

from lightopt.config import RigConfig, load_rig, with_values
from lightopt.core.errors import InputError
from lightopt.images import make_folder, write_text_atomic
from lightopt.scene import build_camera, pixel_footprint

PRESETS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "four-panel": "four-panel",
        "bars": "bars",
        "ring-quadrants": "ring-quadrants",
        "low-ring": "low-angle-ring",
        "dome-quadrants": "dome-quadrants",
        "flat-dome": "flat-dome",
        "tunnel": "tunnel",
        "coaxial": "coaxial",
        "spot": "spot",
        "led-array": "led-array",
        "display": "display-stripes",
        "binary-stripes": "binary-stripes",
        "grid-backlight": "moving-grid",
        "dome-sines": "dome-stripes",
    }
)
"""Name of each preset, and of the sample rig that it is."""


_OWN_CAMERA = "dome-quadrants"  # whose pixels and sensor the presets have where no rig is given


def preset_files(
    names: Sequence[str], folder: Path, *, camera_of: RigConfig | None = None, force: bool = False
) -> list[Path]:
    """Copy the rig files of presets to a folder, where they can be changed, and return them.

    Their cameras stand where the lights let them look through; they get the pixels, on the part, and the sensor of
    another rig, so that the systems can be compared.

    camera_of: The other rig; None for pixels and sensor of the preset dome-quadrants
    Raises InputError: A name that no preset has, or another file in its place without `force`.
    """
    unknown = [name for name in names if name not in PRESETS]
    if unknown:
        raise InputError(*(f'no preset "{name}"; presets are {", ".join(PRESETS)}' for name in unknown))
    make_folder(folder)
    samples, found = files("lightopt.samples").joinpath("rigs"), list[Path]()
    with as_file(samples.joinpath(f"{PRESETS[_OWN_CAMERA]}.yaml")) as path:
        camera_of = camera_of or load_rig(path)
    for name in names:
        with as_file(samples.joinpath(f"{PRESETS[name]}.yaml")) as path:
            text = with_values(path.read_text(encoding="utf-8"), _same_pixels(load_rig(path), camera_of))
        text = "".join(line for line in text.splitlines(keepends=True) if "yaml-language-server" not in line)
        path = folder / f"{name}.yaml"
        if path.exists() and path.read_text(encoding="utf-8") != text and not force:
            raise InputError(
                f"{path}: differs from the preset; give it as a rig file without the preset, or use option 'force'"
            )
        write_text_atomic(path, text)
        found.append(path)
    return found


def _same_pixels(rig: RigConfig, other: RigConfig) -> dict[tuple[str | int, ...], str | None]:
    # values of a rig file: pixels as large on the table as those of another rig, and the same sensor
    camera = build_camera(rig)
    footprint = pixel_footprint(build_camera(other), other.camera.distance_mm)
    pixel_um = 1000.0 * footprint * camera.image_distance / rig.camera.distance_mm
    width, height = other.camera.resolution_px
    sensor = other.camera.sensor.model_dump(exclude={"data_sheet"})
    return {
        ("camera", "resolution_px", 0): str(width),
        ("camera", "resolution_px", 1): str(height),
        ("camera", "pixel_size_um"): f"{pixel_um:.9g}",
        **{("camera", "sensor", key): None if value is None else f"{value:.9g}" for key, value in sensor.items()},
    }
