"""The good part as predicted for a posture: its images, the evaluable pixels, its surface patches; other references."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np

from lightopt import rendering
from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.threads import blocks
from lightopt.core.transforms import Posture
from lightopt.defects import Waviness, tangent_references
from lightopt.geometry import RayCaster
from lightopt.scene import Scene, lens_share, surface_footprint, with_reflectances

ReferenceName = Literal["model", "good-parts", "self"]


TRACE = 1e-6  # least R_d that is rendered: far below what a camera detects

# about so many patches that the camera sees stand for the surface, whatever the resolution of the images
PATCHES = 50_000


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Levels that a good part is expected to have."""

    basis: str  # what they come from, for people
    remedy: str  # what is wrong where far too much of a part deviates from them, and what to do
    # what a comparison with them cannot show; empty for the model, whose limits are those of its files
    limits: str = ""


REFERENCES: Final[Mapping[ReferenceName, Reference]] = {
    "model": Reference(
        basis="model of the part (mesh and reflectance)",
        remedy="the model does not describe the part; check the sensor's noise in the rig file and that the images "
        "have it, give a STEP file, fit the reflectance (lightopt fit-specular), or compare with good parts "
        "(option 'reference': good-parts)",
    ),
    "good-parts": Reference(
        basis="good parts of the calibration",
        remedy="the part is not like the good parts of the calibration; calibrate with good parts of each batch",
        limits="a deviation that good parts show at the same place to the same extent is not found; a shift or "
        "rotation that registration cannot observe must be that of the good parts",
    ),
    "self": Reference(
        basis="smooth neighbourhood of each place in the part's own images",
        remedy="the part is not smooth; compare with good parts (option 'reference': good-parts)",
        limits="deviations wider than the neighbourhood, slow changes of brightness, and defects at edges are not "
        "found; a feature that the surface has only once or twice looks like a defect",
    ),
}
"""By the name that :class:`lightopt.inspection.InspectOptions` takes."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WavyLevels:
    """By how much the waviness of good parts changes the images of a posture."""

    # standard deviation of the level before the camera clips, by light [grey level at exposure 1], each (H, W)
    spread: dict[str, Float32]
    waviness: Waviness  # of the surface
    footprint: float  # side of a pixel [mm]


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """The good part in a posture: its images, and its evaluable pixels."""

    # under each light, with the specular component apart; evaluable pixels are means over their area
    images: rendering.PostureImages
    clean: Bool  # pixels off silhouettes, creases, back faces and grazing views, shape (H, W)
    # pixels that see the part at more than :data:`lightopt.rendering.GRAZING_DEG` to its normal, shape (H, W)
    grazing: Bool
    area: Float32  # of the surface that each pixel sees [mm²], shape (H, W); 0 off the part
    waviness: WavyLevels | None = None  # of good parts; None for smooth ones
    # of a part that moves the images of each exposure, from the longest on; `images` are those of each light's longest
    blurred: Mapping[float, rendering.PostureImages] = field(default_factory=dict[float, rendering.PostureImages])

    def image(self, light: str, exposure: float) -> rendering.LightImage:
        """The image of a light as an exposure shows it."""
        images = self.blurred.get(exposure, self.images)
        return next(one for one in images.lights if one.light == light)


def predict(
    scene: Scene,
    posture: Posture,
    caster: RayCaster,
    *,
    lights: Sequence[str],
    exposures: Mapping[str, Sequence[float]] | None = None,
    edges: bool = False,
    threads: int | None = None,
) -> Prediction:
    """Render the good part in a posture of a scene with the part at its registered placement.

    exposures: Of the images of each light, by whose times a part that moves is blurred; None for a part at rest.
    edges: Whether pixels that cannot be judged are means over their area, too.
    """
    chosen = tuple(light for light in scene.lights if light.name in lights)
    # with a trace of scattered light, what a light reaches has some, and what is in its shadow none
    traced = [replace(one, R_d=max(one.R_d, TRACE)) for one in scene.reflectances]
    lit = replace(with_reflectances(scene, traced), lights=chosen)
    masks = rendering.mask_pixels(scene, posture, caster, threads=threads)
    averaged = np.ones_like(masks.clean) if edges else masks.clean
    how: dict[str, Any] = {"caster": caster, "layers": True, "averaged": averaged, "threads": threads}
    blurred: dict[float, rendering.PostureImages] = {}
    if exposures is not None and scene.motion is not None:
        for exposure in sorted({one for own in exposures.values() for one in own}, reverse=True):
            own = replace(lit, lights=tuple(light for light in chosen if exposure in exposures[light.name]))
            blurred[exposure] = rendering.render_posture(own, posture, exposure=exposure, **how)
        longest = {image.light: image for images in reversed(blurred.values()) for image in images.lights}
        images = replace(next(iter(blurred.values())), lights=tuple(longest[light.name] for light in chosen))
    else:
        images = rendering.render_posture(lit, posture, **how)
    return Prediction(
        images=images,
        blurred=blurred,
        clean=masks.clean & images.geometry.hit,
        grazing=masks.grazing,
        area=masks.area,
        waviness=None if scene.waviness is None else _wavy_levels(lit, posture, caster, threads),
    )


def _wavy_levels(scene: Scene, posture: Posture, caster: RayCaster, threads: int | None) -> WavyLevels:
    assert scene.waviness is not None
    pixels = rendering.trace_pixels(scene, posture, caster, threads=threads)
    surface = pixels.surface
    axes = scene.placement.rotation
    references = tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
    slope, direction = scene.waviness.leans
    variants = rendering.surface_variants(
        slope=slope,
        direction=direction,
        R_d_factor=np.ones(2),
        sigma_factor=np.ones(2),
        reflectances=scene.reflectances,
    )

    share = lens_share(scene.camera, pixels.column + 0.5, pixels.row + 0.5)
    passed = np.ones(len(surface)) if share is None else share
    sources = [rendering.panel_to_shade(panel, caster) for panel in pixels.view.lights]
    names = [panel.name for panel in pixels.view.lights]
    spread: dict[str, Float32] = {name: np.zeros(pixels.shape, np.float32) for name in names}
    for group in rendering.channel_groups(sources):
        own = [sources[i] for i in group]
        # channels together in parts, so that they take no more memory than one alone
        for start, end in blocks(len(surface), max(1, -(-len(surface) // len(own)))):
            some, place = surface.take(slice(start, end)), (pixels.row[start:end], pixels.column[start:end])
            how: dict[str, Any] = {"caster": caster, "dtype": np.float32}
            found = rendering.shade_variants(some, references[start:end], own, variants, **how)
            for i, shaded in zip(group, found, strict=True):
                change = np.hypot(*(one - shaded.good for one in shaded.varied))
                spread[names[i]][place] = change * passed[start:end]
    return WavyLevels(
        spread=spread, waviness=scene.waviness, footprint=surface_footprint(pixels.view.camera, surface.points)
    )


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Patches of the surface, and the pixel that sees each in each posture."""

    areas: Float64  # of the patches [mm²], shape (n,)
    # by posture: indices of the patches that the camera sees, and raveled indices of the pixels that they lie in, −1
    # where it sees them at a grazing angle: these are left out
    seen: dict[Posture, tuple[Index, Index]]


def map_surface(scene: Scene, caster: RayCaster, *, threads: int | None = None) -> SurfaceMap:
    """Divide the surface into patches and find the pixel that sees each in each posture of `scene`."""
    table = rendering.build_patches(scene, caster=caster, budget=PATCHES, threads=threads)
    seen: dict[Posture, tuple[Index, Index]] = {}
    for posture, visible, grazing in zip(table.postures, table.visible, table.grazing, strict=True):
        patch = np.flatnonzero(visible)
        columns, rows = (np.floor(a[patch]).astype(np.intp) for a in rendering.patch_positions(table, scene, posture))
        seen[posture] = patch, np.where(grazing[patch], -1, rows * scene.camera.width + columns)
    return SurfaceMap(areas=table.patches.areas, seen=seen)
