"""What the camera resolves, sees and delivers."""

from __future__ import annotations

from collections.abc import Iterator

from lightopt.preflight._report import Finding, Level
from lightopt.preflight._subject import RigSubject
from lightopt.scene import pixel_footprint, view_size

LOST_RANGE = 0.25
"""A black level or a saturation level that costs more than this share of the full scale is worth a warning."""

SMALL_WELL = 1000.0
"""Electrons at saturation below which shot noise alone is over 3 % of the level."""


def check_lens(subject: RigSubject) -> Iterator[Finding]:
    """The lens in both of its descriptions."""
    a, b = subject.rig.camera.distance_mm, subject.camera.image_distance
    focal = a * b / (a + b)
    key = "image_distance_mm" if subject.rig.camera.image_distance_mm is not None else "focal_length_mm"
    yield Finding(
        "ok",
        "lens",
        f"image distance {b:.4g} mm, the same as a lens of focal length {focal:.4g} mm focused at {a:g} mm; "
        f"magnification {b / a:.3g}",
        subject.rig.source.at("camera", key),
        {"image_distance_mm": b, "focal_length_mm": focal, "magnification": b / a},
    )


def check_resolution(subject: RigSubject) -> Iterator[Finding]:
    """A pixel's footprint at the origin, where the camera looks."""
    footprint = pixel_footprint(subject.camera, subject.rig.camera.distance_mm)
    yield Finding(
        "ok",
        "resolution",
        f"a pixel's footprint at the table is {footprint:.3g} mm ({1000 * footprint:.3g} µm)",
        subject.rig.source.at("camera", "pixel_size_um"),
        {"footprint_mm": footprint},
    )


def check_field_of_view(subject: RigSubject) -> Iterator[Finding]:
    """Width and height of what the camera sees of the table."""
    where = subject.rig.source.at("camera")
    size = view_size(subject.camera)
    if size is None:
        yield Finding(
            "note", "field of view", "reaches beyond the table's horizon: the camera leans too far", where
        )
        return
    width, height = size
    yield Finding(
        "ok",
        "field of view",
        f"{width:.4g} × {height:.4g} mm at the table through the image's centre",
        where,
        {"width_mm": width, "height_mm": height},
    )


def check_sensor(subject: RigSubject) -> Iterator[Finding]:
    """Range of levels between black and saturation, and the noise that comes with it."""
    sensor = subject.rig.camera.sensor
    at = subject.rig.source.at
    full = 2**sensor.bit_depth - 1
    top = full if sensor.saturation_level is None else sensor.saturation_level
    values = {"full_scale": full, "saturation_level": top, "black_level": sensor.black_level}
    usable = top - sensor.black_level
    level: Level = "warning" if usable < (1.0 - LOST_RANGE) * full else "ok"
    text = f"{usable:g} of {full} levels between black level {sensor.black_level:g} and saturation at {top}"
    if level == "warning":
        text += "; check saturation_level, black_level and bit_depth against the camera's data sheet"
    yield Finding(level, "sensor", text, at("camera", "sensor"), values)
    if sensor.electrons_per_level is None:
        return
    electrons = usable * sensor.electrons_per_level
    if electrons < SMALL_WELL:
        yield Finding(
            "warning",
            "sensor",
            f"a pixel saturates at {electrons:.3g} electrons ({sensor.electrons_per_level:g} per level): shot noise "
            f"there is {100 / electrons**0.5:.2g} % of the level. Real sensors hold 5,000 and more; "
            "electrons_per_level is the full well divided by the full scale",
            at("camera", "sensor", "electrons_per_level"),
            {"electrons_at_saturation": electrons},
        )
