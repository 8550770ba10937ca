"""What the camera resolves and delivers, and where the part lies in its image and on the table."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from lightopt.optics import airy_diameter, depth_of_field
from lightopt.preflight._findings import CheckedRig, CheckedScene, Finding, Level, percent
from lightopt.rendering import too_few_pixels
from lightopt.scene import MOST_MOTION_PX, blur_diameter, build_sensor, motion_blur, pixel_footprint, view_size

# a black level or a saturation level that costs more than this share of the full scale is worth a warning
LOST_RANGE = 0.25
SMALL_WELL = 1000.0  # electrons at saturation below which shot noise alone is over 3 % of the level
MOST_MAGNIFICATION, LEAST_PIXEL_UM = 20.0, 0.3  # beyond these a length has probably another unit
# what is blurred over more than a pixel is out of focus; a larger share of the surface seen is worth a warning
FOCUS_PX, MOST_OUT_OF_FOCUS = 1.0, 0.05
TABLE_TOLERANCE_MM = 1e-3


def check_lens(checked: CheckedRig) -> Iterator[Finding]:
    """The lens in both of its descriptions."""
    camera = checked.rig.camera
    a, b = camera.focus_distance_mm or camera.distance_mm, checked.camera.image_distance
    focal = a * b / (a + b)
    keys = ("focal_px", "image_distance_mm", "focal_length_mm")
    key = next(key for key in keys if getattr(camera, key) is not None)
    text = f"image distance {b:.4g} mm: focal length {focal:.4g} mm focused at {a:g} mm; magnification {b / a:.3g}"
    values = {"image_distance_mm": b, "focal_length_mm": focal, "magnification": b / a}
    level: Level = "ok"
    if b / a > MOST_MAGNIFICATION:
        level, key = "warning", "distance_mm"
        text += f", which no lens of a machine has: is the distance of {a:g} mm in another unit?"
    yield Finding(level, "lens", text, checked.at("camera", key), values)


def check_depth_of_field(checked: CheckedRig) -> Iterator[Finding]:
    """Where the lens is sharp, and what diffraction leaves."""
    camera, lens = checked.camera, checked.camera.lens
    if lens is None:
        return
    near, far = depth_of_field(
        FOCUS_PX * camera.pixel_size, focus=lens.focus, aperture=lens.aperture, image_distance=camera.image_distance
    )
    text = f"f/{checked.rig.camera.aperture:g}, focused at {lens.focus:g} mm: a point is {FOCUS_PX:g} px or less from "
    text += f"{near:.5g} to {far:.5g} mm from the camera ({far - near:.3g} mm of depth)"
    values = {"near_mm": near, "far_mm": far if math.isfinite(far) else None, "aperture_mm": lens.aperture}
    cutoff = camera.diffraction_cutoff
    if cutoff is not None:
        text += f"; Airy's disc is {2.44 / cutoff:.3g} px wide"
        values["airy_px"] = 2.44 / cutoff
    yield Finding("ok", "depth of field", text, checked.at("camera", "aperture"), values)


def check_resolution(checked: CheckedRig) -> Iterator[Finding]:
    """A pixel's footprint at the origin, where the camera looks."""
    footprint = pixel_footprint(checked.camera, checked.rig.camera.distance_mm)
    text = f"a pixel's footprint at the table is {footprint:.3g} mm ({1000 * footprint:.3g} µm)"
    pixel_um = checked.rig.camera.pixel_size_um
    level: Level = "ok"
    if pixel_um < LEAST_PIXEL_UM:
        level = "warning"
        text += f"; no sensor has pixels of {pixel_um:g} µm: are they in another unit?"
    yield Finding(level, "resolution", text, checked.at("camera", "pixel_size_um"), {"footprint_mm": footprint})


def check_field_of_view(checked: CheckedRig) -> Iterator[Finding]:
    """Width and height of what the camera sees of the table."""
    where = checked.at("camera")
    size = view_size(checked.camera)
    if size is None:
        text = "reaches beyond the table's horizon: the camera leans too far"
        yield Finding("note", "field of view", text, where)
        return
    width, height = size
    text = f"{width:.4g} × {height:.4g} mm at the table through the image's centre"
    yield Finding("ok", "field of view", text, where, {"width_mm": width, "height_mm": height})


def check_sensor(checked: CheckedRig) -> Iterator[Finding]:
    """Range of levels between black and saturation, and the noise that comes with it."""
    sensor = checked.rig.camera.sensor
    full = 2**sensor.bit_depth - 1
    top = sensor.saturation_level or full
    values = {"full_scale": full, "saturation_level": top, "black_level": sensor.black_level}
    usable = top - sensor.black_level
    level: Level = "warning" if usable < (1.0 - LOST_RANGE) * full else "ok"
    text = f"{usable:g} of {full} levels between black level {sensor.black_level:g} and saturation at {top}"
    if level == "warning":
        text += "; check saturation_level, black_level and bit_depth against the camera's data sheet"
    yield Finding(level, "sensor", text, checked.at("camera", "sensor"), values)
    if sensor.electrons_per_level is None:
        return
    electrons = usable * sensor.electrons_per_level
    if sensor.quantum_efficiency_percent is not None:
        noise = math.sqrt(build_sensor(checked.rig.camera).noise_variance(0.0))
        decibels = 20.0 * math.log10(usable / noise)
        photons = electrons / (0.01 * sensor.quantum_efficiency_percent)
        text = f"a pixel saturates at {electrons:.4g} electrons, {photons:.4g} photons; dark noise "
        text += f"{noise * sensor.electrons_per_level:.3g} electrons, dynamic range {decibels:.2g} dB"
        found = {"electrons_at_saturation": electrons, "photons_at_saturation": photons, "dark_noise_levels": noise}
        yield Finding("ok", "photons", text, checked.at("camera", "sensor"), found)
    if electrons < SMALL_WELL:
        text = f"a pixel saturates at {electrons:.3g} electrons, and real sensors at 5,000 and more; "
        text += "electrons_per_level is the full well divided by the full scale"
        where = checked.at("camera", "sensor", "electrons_per_level")
        yield Finding("warning", "sensor", text, where, {"electrons_at_saturation": electrons})


def check_depth(checked: CheckedScene) -> Iterator[Finding]:
    """Range of depths that the lens has to keep sharp, and a pixel's footprint at both ends."""
    framings = [sample.framing for sample in checked.samples]
    near, far = min(f.nearest for f in framings), max(f.farthest for f in framings)
    values = {"nearest_mm": near, "farthest_mm": far}
    if near <= 0.0:
        text = f"the part reaches {-near:.3g} mm behind the camera; check its units and its placement"
        yield Finding("warning", "depth", text, checked.part.source.at("placement"), values)
        return
    small, large = min(f.footprint[0] for f in framings), max(f.footprint[1] for f in framings)
    text = f"the part lies {near:.4g} to {far:.4g} mm from the camera ({far - near:.3g} mm of depth); a pixel's "
    text += f"footprint is {1000 * small:.3g} µm at the nearest and {1000 * large:.3g} µm at the farthest point"
    values |= {"nearest_footprint_mm": small, "farthest_footprint_mm": large}
    yield Finding("ok", "depth", text, None, values)


def check_focus(checked: CheckedScene) -> Iterator[Finding]:
    """Share of the surface seen that is out of focus, and by how much."""
    if checked.scene.camera.lens is None:
        return
    for sample in checked.samples:
        camera, surface = sample.view.camera, sample.surface
        if not len(surface):
            continue
        blur = blur_diameter(camera, (surface.points - camera.position) @ camera.forward)
        cosine = np.abs(np.einsum("ij,ij->i", surface.facets, surface.views))
        area = sample.hits.distance**2 / np.maximum(cosine, 0.05)
        share, largest = float(area[blur > FOCUS_PX].sum() / area.sum()), float(blur.max())
        text = f"the lens blurs the part over up to {largest:.3g} px"
        if share > 0.0:
            text += f", {percent(share)} of the surface seen over more than {FOCUS_PX:g} px"
        level: Level = "warning" if share > MOST_OUT_OF_FOCUS else "ok"
        if level == "warning":
            cutoff = camera.diffraction_cutoff
            diffracted = cutoff is not None and airy_diameter(cutoff) > math.sqrt(0.5) * largest
            if diffracted:
                text += ", most of it by diffraction; open the aperture"
            else:
                text += "; stop the aperture down, or change focus_distance_mm"
            text += ". Fits take all that is seen to be in focus"
        yield checked.of_posture(sample, level, "focus", text, largest_px=largest, out_of_focus_share=share)


def check_motion(checked: CheckedScene) -> Iterator[Finding]:
    """How far the part moves in the image while the camera exposes."""
    motion = checked.scene.motion
    if motion is None:
        return
    for sample in checked.samples:
        path = motion_blur(checked.scene, sample.posture, sample.surface.points)
        if not len(path):
            continue
        least, largest = float(path.min()), float(path.max())
        text = f"the part moves {least:.3g} to {largest:.3g} px in the {1e3 * motion.exposure_s:.4g} ms of exposure 1"
        level: Level = "warning" if largest > MOST_MOTION_PX else "ok"
        if level == "warning":
            text += f"; {MOST_MOTION_PX:g} px takes exposure {MOST_MOTION_PX / largest:.2g}. Fits, plans, training "
            text += "sets and verify take the part to be at rest"
        yield checked.of_posture(sample, level, "motion", text, least_px=least, largest_px=largest)


def check_part_in_view(checked: CheckedScene) -> Iterator[Finding]:
    """The margin around the part's image, or by how much it leaves the view."""
    for sample in checked.samples:
        framing, camera = sample.framing, sample.view.camera
        if framing.nearest <= 0.0:
            yield checked.of_posture(sample, "warning", "view", "the part reaches behind the camera")
            continue
        margins, per_pixel = dict(framing.margins), framing.footprint[0]
        in_mm = {side: per_pixel * m for side, m in margins.items()}
        values: dict[str, Any] = {"margin_px": margins, "margin_mm": in_mm}
        texts = {side: f"{abs(m):.0f} px ({abs(m) * per_pixel:.3g} mm) at the {side}" for side, m in margins.items()}
        leaves = [texts[side] for side, m in margins.items() if m < 0.0]
        if leaves:
            text = f"the part leaves the view by {', '.join(leaves)}; move it, or let the camera see more"
        else:
            side = min(margins, key=lambda name: margins[name])
            width, height = framing.size
            share, along = max((width / camera.width, "width"), (height / camera.height, "height"))
            text = f"inside the view, by {texts[side]} at least; the part fills {percent(share)} of the image's {along}"
            values["least_margin_px"] = margins[side]
        yield checked.of_posture(sample, "warning" if leaves else "ok", "view", text, **values)


def check_pixels(checked: CheckedScene) -> Iterator[Finding]:
    """Whether next to no pixel sees the part."""
    found = too_few_pixels(checked.scene, checked.caster)
    if found is not None:
        where = checked.part.source.at("mesh", "file")
        pixels, text = found
        yield Finding("error", "view", text, where, {"pixels": pixels})


def check_below_table(checked: CheckedScene) -> Iterator[Finding]:
    """By how much the part would have to pass through the table."""
    vertices = checked.scene.mesh.vertices
    for sample in checked.samples:
        lowest = float((vertices @ sample.view.rotation[2] + sample.view.translation[2]).min())
        if lowest >= -TABLE_TOLERANCE_MM:
            continue
        if sample.posture.elevation_deg == 0.0:
            text = f"posture {sample.posture}: the part reaches {-lowest:.3g} mm below the table; raise it by "
            text += "translate_mm, or let it rest_on_table"
            values = {"posture": sample.posture.as_dict(), "lowest_mm": lowest}
            yield Finding("warning", "table", text, checked.part.source.at("placement"), values)
        else:
            text = f"the tilt moves the part {-lowest:.3g} mm below the plane Z = 0, where nothing is hidden here; on "
            text += "a stage whose table does not tilt along, raise the part or the pivot"
            yield checked.of_posture(sample, "note", "table", text, lowest_mm=lowest)
