"""From rig and part files to the scene: camera, lights, mesh and its placement, checked against each other."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lightopt import geometry
from lightopt.config import CameraConfig, PartConfig, ReflectanceConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import InputError, refuse
from lightopt.core.transforms import Posture, rotation_from_vector, rotation_x, rotation_y, rotation_z
from lightopt.core.units import MM_PER_UNIT
from lightopt.defects import Waviness
from lightopt.optics import DiffuseForm, Reflectance, Sensor, SpecularModel, least_white_level, white_level
from lightopt.scene import _camera as cameras
from lightopt.scene._brushing import brushings, faces_without_direction, with_brushing
from lightopt.scene._defects import outside_stage_range, place_defects
from lightopt.scene._image_area import obstructions
from lightopt.scene._lights import build_housings, build_lights, housing_corners
from lightopt.scene._reflectance_table import table_lobes
from lightopt.scene._regions import mesh_of_regions
from lightopt.scene._scene import Motion, PartRegion, Placement, Scene, view_from_part
from lightopt.scene._stage import Stage

CHORD_TOLERANCE_MM = 0.01
# CAD surfaces are tessellated to within the smaller of 10 µm and a fifth of a pixel's footprint
CHORD_TOLERANCE_FOOTPRINTS = 0.2

# largest angle between neighbouring triangles along an edge, and where a coarser chord asks for more, up to [rad]
ANGULAR_TOLERANCE, MOST_ANGULAR_TOLERANCE = 0.1, 0.5


def build_scene(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    *,
    postures: Sequence[Posture] | None = None,
    lights: Sequence[str] | None = None,
    points: int | Literal["auto"] | None = None,
    defects: bool = True,
    bounces: int = 0,
) -> Scene:
    """Place a rig's camera and lights and a part in the world frame.

    rig, part: Configurations, or the paths of their YAML files
    lights: Names of the lights to keep, instead of all
    points: Point lights per panel, instead of the rig's
    defects: Whether the part has the defects and the waviness that its file names, or is good and smooth
    bounces: How often images show light that goes from the part to the part
    Raises InputError: A white level at which the part would reflect more light than it gets, a posture outside the
        stage's range, an unknown light, a mesh that cannot be loaded, a part
        wholly outside the view or a camera inside the part (with what another unit of the mesh file would make of it,
        where that explains it), a lens that folds the image over, a defect that is not on the part
    """
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    camera = build_camera(rig)
    chosen = _postures(rig, part, postures)
    placed = build_lights(rig, lights, points)
    # lights that are off stand there, too
    standing = build_lights(rig) if lights else placed
    camera = replace(camera, obstructions=obstructions(camera, standing, housing_corners(rig).values()))
    mesh, placement, warnings = _mesh(part, cameras.pixel_footprint(camera, rig.camera.distance_mm))
    housings = build_housings(rig)
    surrounded = rig.environment.level > 0.0 or (housings is not None and housings.level > 0.0)
    mirrored = bounces > 0 or part.inspection.bounces > 0
    reflectance, regions = _reflectances(part, seen=mirrored or surrounded)
    scene = Scene(
        camera=camera,
        lights=placed,
        mesh=mesh,
        reflectance=reflectance,
        regions=regions,
        sensor=build_sensor(rig.camera),
        stage=build_stage(rig),
        postures=chosen,
        placement=placement,
        freedoms=6 if part.placement.registration == "full" else 3,
        bounces=bounces,
        environment=rig.environment.level,
        housings=housings,
        motion=_motion(rig),
    )
    warnings += _check_view(scene, rig, part)
    waviness = None
    if part.surface is not None:
        bands = tuple((math.radians(slope), length) for slope, length in part.surface.waves)
        waviness = Waviness(bands=bands, seed=0 if defects else None)
    placed_defects = place_defects(scene, rig, part) if defects else ()
    return replace(scene, warnings=warnings, defects=placed_defects, waviness=waviness)


def _reflectances(part: PartConfig, *, seen: bool) -> tuple[Reflectance, tuple[PartRegion, ...]]:
    # `seen`: whether the part shows itself or its surroundings, for which its white level counts
    base = part.reflectance
    read = partial(_reflectance, part, seen=seen)
    own = [read(one.reflectance, "regions", i, "reflectance") for i, one in enumerate(part.regions)]
    regions = tuple(PartRegion(name=one.name, reflectance=each) for one, each in zip(part.regions, own, strict=True))
    reflectance = read(base, "reflectance")
    if regions and base.white_level is None:
        # a white surface is as bright everywhere: as where the part reflects most
        most = max(white_level(one) for one in (reflectance, *(region.reflectance for region in regions)))
        reflectance = replace(reflectance, white_level=most)
        regions = tuple(replace(one, reflectance=replace(one.reflectance, white_level=most)) for one in regions)
    return reflectance, regions


def _reflectance(part: PartConfig, own: ReflectanceConfig, *keys: str | int, seen: bool) -> Reflectance:
    full_scale, white = part.reflectance.full_scale, part.reflectance.white_level
    lobes: tuple[tuple[float, float], ...] = ()
    if own.table is not None:
        try:
            lobes = table_lobes(part.source.resolve(own.table))
        except InputError as error:
            raise InputError(f"{part.source.at(*keys, 'table')}: {error.args[0]}") from None
    model = SpecularModel(
        name=own.model,
        wide_share=own.R_s_wide / own.R_s if own.R_s_wide is not None and own.R_s > 0.0 else 0.0,
        wide_ratio=1.0 if own.sigma_wide_rad is None else own.sigma_wide_rad / own.sigma,
        refractive_index=own.refractive_index,
        across_ratio=1.0 if own.sigma_across is None else own.sigma_across / own.sigma,
        measured=lobes,
    )
    diffuse = DiffuseForm(
        exponent=1.0 if own.diffuse_exponent is None else own.diffuse_exponent,
        roughness=own.oren_nayar_roughness or 0.0,
    )
    reflectance = Reflectance(
        R_d=own.R_d,
        R_s=own.R_s,
        sigma=own.width_factor * lobes[0][1] if lobes else own.sigma,
        full_scale=full_scale,
        model=model,
        diffuse=diffuse,
        white_level=white,
    )
    if seen and white is not None and white < (least := least_white_level(reflectance)):
        why = f"with the coefficients of {part.source.at(*keys)} the part would reflect more light than it gets"
        where = part.source.at("reflectance", "white_level")
        raise InputError(f"{where}: expected at least {least:.4g}, found {white:g}: {why}")
    return reflectance


def build_camera(rig: RigConfig) -> cameras.PinholeCamera:
    """The rig's camera, world frame; InputError where the lens model folds the image over."""
    c = rig.camera
    aspect = 1.0
    focus = c.focus_distance_mm or c.distance_mm
    if c.focal_px is not None:
        image_distance = c.focal_px[0] * c.pixel_size_um * 1e-3
        aspect = c.focal_px[1] / c.focal_px[0]
    elif c.image_distance_mm is not None:
        image_distance = c.image_distance_mm
    else:
        assert c.focal_length_mm is not None
        # thin lens: 1/f = 1/a + 1/b
        image_distance = c.focal_length_mm * focus / (focus - c.focal_length_mm)
    image: dict[str, Any] = {
        "width": c.resolution_px[0],
        "height": c.resolution_px[1],
        "pixel_size": c.pixel_size_um * 1e-3,
        "image_distance": image_distance,
        "distortion": cameras.Distortion(**c.distortion.model_dump()),
        "principal_point": c.principal_point_px,
        "aspect": aspect,
        "vignetting": (0.0, 0.0) if c.vignetting is None else (c.vignetting.v2, c.vignetting.v4),
        "cos4": c.vignetting is not None and c.vignetting.cos4,
        "lens": None
        if c.aperture is None
        else cameras.Lens(
            aperture=focus * image_distance / (focus + image_distance) / c.aperture,
            focus=focus,
            wavelength=None if c.wavelength_nm is None else c.wavelength_nm * 1e-6,
        ),
    }
    if c.pose is None:
        camera = cameras.place_camera(
            distance=c.distance_mm,
            elevation=math.radians(c.elevation_deg),
            azimuth=math.radians(c.azimuth_deg),
            roll=math.radians(c.roll_deg),
            **image,
        )
    else:
        rotation = rotation_from_vector(np.radians(c.pose.rotation_vector_deg))
        camera = cameras.pose_camera(position=np.array(c.pose.position_mm, np.float64), rotation=rotation, **image)
    columns, rows = np.meshgrid(np.linspace(0.0, camera.width, 33), np.linspace(0.0, camera.height, 33))
    if not np.isfinite(cameras.pixel_directions(camera, columns.ravel(), rows.ravel())).all():
        why = "this lens model folds the image over; expected a calibration that covered the whole image"
        raise InputError(f"{rig.source.at('camera', 'distortion')}: {why}")
    return camera


def build_stage(rig: RigConfig) -> Stage:
    """The rig's stage, world frame."""
    s = rig.stage
    pivot = np.array(s.pivot_mm, dtype=np.float64)
    rotary_scale = 1.0 if s.rotary_axis is None else s.rotary_axis.scale
    if s.tilt_axis is None:
        return Stage(pivot=pivot, rotary_scale=rotary_scale)
    direction = np.array(s.tilt_axis.direction, dtype=np.float64)
    return Stage(
        pivot=pivot,
        tilt_point=None if s.tilt_axis.point_mm is None else np.array(s.tilt_axis.point_mm, dtype=np.float64),
        tilt_direction=direction / np.linalg.norm(direction),
        tilt_scale=s.tilt_axis.scale,
        rotary_scale=rotary_scale,
    )


def _motion(rig: RigConfig) -> Motion | None:
    own, exposure_us = rig.stage.motion, rig.camera.exposure_us
    if own is None or exposure_us is None or not any((*own.velocity_mm_per_s, own.rotation_deg_per_s)):
        return None
    velocity = np.array(own.velocity_mm_per_s, np.float64)
    return Motion(velocity=velocity, turn_deg_per_s=own.rotation_deg_per_s, exposure_s=1e-6 * exposure_us)


def build_sensor(camera: CameraConfig) -> Sensor:
    own = camera.sensor
    noise, electrons = own.read_noise_levels, own.electrons_per_level
    if own.dark_current_e_per_s > 0 and electrons is not None and camera.exposure_us is not None:
        noise = math.sqrt(noise**2 + own.dark_current_e_per_s * camera.exposure_us * 1e-6 / electrons**2)
    return Sensor(
        bit_depth=own.bit_depth,
        saturation_level=own.saturation_level or 2**own.bit_depth - 1,
        black_level=own.black_level,
        read_noise_levels=noise,
        electrons_per_level=electrons,
        dsnu_levels=own.dsnu_levels,
        prnu=0.01 * own.prnu_percent,
        linearity_error=0.01 * own.linearity_error_percent,
    )


def part_postures(part: PartConfig) -> tuple[Posture, ...]:
    """The postures that a part's file asks for, in its order."""
    return tuple(Posture(elevation_deg=p.elevation_deg, rotation_deg=p.rotation_deg) for p in part.postures)


def _postures(rig: RigConfig, part: PartConfig, chosen: Sequence[Posture] | None) -> tuple[Posture, ...]:
    if chosen is None:
        named = [(posture, part.source.at("postures", i)) for i, posture in enumerate(part_postures(part))]
    else:
        named = [(posture, "posture") for posture in chosen]
    refuse(problem for posture, where in named for problem in outside_stage_range(rig, posture, where=where))
    return tuple(posture for posture, _ in named)


def _mesh(part: PartConfig, footprint: float) -> tuple[geometry.TriangleMesh, Placement, tuple[str, ...]]:
    m = part.mesh
    path = part.source.resolve(m.file)
    tolerance = chord_tolerance(part, footprint)
    # the sagitta of a chord goes with the square of its angle: both limits coarsen alike
    angular_tolerance = ANGULAR_TOLERANCE * max(1.0, math.sqrt(tolerance / CHORD_TOLERANCE_MM))
    loaded = geometry.load_mesh(
        path,
        # formats that carry their unit are checked against `units` when the file is read
        unit_mm=MM_PER_UNIT[m.units] if m.units and path.suffix.lower() in geometry.UNITLESS_SUFFIXES else None,
        normals=m.normals,
        crease_angle=math.radians(m.crease_angle_deg),
        chord_tolerance_mm=tolerance,
        angular_tolerance=min(MOST_ANGULAR_TOLERANCE, angular_tolerance),
        max_triangles=m.max_triangles,
        pieces=bool(part.regions) or any(own and own.along_texture for _, own in brushings(part)),
    )
    loaded = with_brushing(loaded, part)
    mesh = mesh_of_regions(loaded, part) if part.regions else loaded.mesh
    warnings = loaded.warnings + faces_without_direction(mesh, part)
    rx, ry, rz = (math.radians(angle) for angle in part.placement.rotate_deg)
    rotation = rotation_z(rz) @ rotation_y(ry) @ rotation_x(rx)
    turned = geometry.transformed(mesh, rotation, np.zeros(3))
    low, high = turned.bounds
    shift = np.zeros(3)
    if part.placement.anchor == "rest_on_table":
        shift = -np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    elif part.placement.anchor == "centred":
        shift = -0.5 * (low + high)
    shift = shift + np.array(part.placement.translate_mm, dtype=np.float64)
    placed = geometry.transformed(turned, np.eye(3), shift)
    return placed, Placement(rotation=rotation, translation=shift), warnings


def chord_tolerance(part: PartConfig, footprint: float) -> float:
    """How far triangles may be from the CAD surface of a STEP file, for the side of a pixel's footprint [mm]."""
    if part.mesh.chord_tolerance_mm is not None:
        return part.mesh.chord_tolerance_mm
    return min(CHORD_TOLERANCE_MM, CHORD_TOLERANCE_FOOTPRINTS * footprint)


def unit_hint(part: PartConfig, scene: Scene) -> tuple[str, ...]:
    """A message that proposes other units for a file that carries none, where they explain the part's size."""
    size = view_size(scene.camera)
    if size is None or Path(part.mesh.file).suffix.lower() not in geometry.UNITLESS_SUFFIXES:
        return ()
    longest = float(np.max(np.subtract(*scene.mesh.bounds[::-1])))
    guess = guess_unit(part, longest, min(size))
    return () if guess is None else (f"{part.source.at('mesh', 'units')}: {guess.text}",)


def _check_view(scene: Scene, rig: RigConfig, part: PartConfig) -> tuple[str, ...]:
    size = " × ".join(f"{side:.4g}" for side in np.subtract(*scene.mesh.bounds[::-1]))
    where = part.source.at("mesh", "file")
    warnings: list[str] = []
    outside: list[str] = []
    hint = unit_hint(part, scene)
    for posture in scene.postures:
        camera = view_from_part(scene, posture).camera
        if geometry.points_inside(camera.position[None], scene.mesh)[0]:
            text = f"the camera, {rig.camera.distance_mm:g} mm from the origin, is inside the part, {size} mm large"
            raise InputError(f"{where}: {text}; check the mesh's units and the part's placement", *hint)
        framing = cameras.frame_part(camera, scene.mesh)
        if framing.outside:
            view = f"{camera.width} × {camera.height} px"
            text = f"the part, {size} mm, lies wholly outside the camera's view of {view}; check units and placement"
            outside.append(f"{where}: in posture {posture} {text}")
        elif not framing.inside:
            over = [(side, -px, -px * framing.footprint[0]) for side, px in framing.margins.items() if px < 0.0]
            by = ", ".join(f"{excess:.3g} px ({mm:.3g} mm) at the {side}" for side, excess, mm in over)
            text = f"the part leaves the view by {by}" if by else f"the part, {size} mm, reaches behind the camera"
            warnings.append("; ".join([f"posture {posture}: {text}", *([] if by else hint)]))
    if outside:
        raise InputError(*outside, *hint)
    return tuple(warnings)


# a part whose longest side is not between these shares of the view's shorter side is suspected of a wrong unit
ABSURD = (1.0 / 15.0, 2.5)

SENSIBLE = (0.15, 1.3)  # a unit is proposed where it brings the part's longest side between these shares


@dataclass(frozen=True)
class UnitGuess:
    """What other units would make of a part that does not fit the view at all."""

    unit: str
    likely: tuple[str, ...]  # those that would make sense of it
    text: str


def view_size(camera: cameras.PinholeCamera) -> tuple[float, float] | None:
    """Width and height of the view along the image's middle lines on the table [mm]; None where a ray misses it."""
    w, h = float(camera.width), float(camera.height)
    directions = cameras.pixel_directions(
        camera, np.array([0.0, w, 0.5 * w, 0.5 * w]), np.array([0.5 * h, 0.5 * h, 0.0, h])
    )
    down = -directions[:, 2]
    if down.min() <= 1e-9:
        return None
    at = camera.position + directions * (camera.position[2] / down)[:, None]
    return float(np.linalg.norm(at[1] - at[0])), float(np.linalg.norm(at[3] - at[2]))


def is_absurd(longest: float, view: float) -> bool:
    """Whether a part of this longest side [mm] is far too small or large for a view of this shorter side [mm]."""
    return not ABSURD[0] <= longest / view <= ABSURD[1]


def likely_units(longest: float, view: float, unit: str) -> tuple[str, ...]:
    """Units that would make sense of a part that does not fit the view at all; none where it does.

    longest: The part's longest side as it is read now [mm]
    view: The view's shorter side [mm]
    """
    if not is_absurd(longest, view):
        return ()
    shares = {name: longest / view * mm / MM_PER_UNIT[unit] for name, mm in MM_PER_UNIT.items()}
    return tuple(name for name, share in shares.items() if SENSIBLE[0] <= share <= SENSIBLE[1])


def guess_unit(part: PartConfig, longest: float, view: float) -> UnitGuess | None:
    """Units that the part's file is more probably in, as :func:`likely_units`; None where there are none."""
    # formats that carry their unit: GLB is in metres, STEP is converted to millimetres as it is read
    unit = part.mesh.units or ("m" if part.mesh.file.lower().endswith(".glb") else "mm")
    likely = likely_units(longest, view, unit)
    if not likely:
        return None
    ratios = {name: MM_PER_UNIT[name] / MM_PER_UNIT[unit] for name in likely}
    factors = {name: f"{ratio:.4g}" if ratio >= 1.0 else f"1/{1.0 / ratio:.4g}" for name, ratio in ratios.items()}
    sizes = " or ".join(f"{name} ({longest * ratios[name]:.4g} mm, a factor of {factors[name]})" for name in likely)
    read = f"Read as {unit}, the part's longest side is {longest:.4g} mm"
    text = f"a wrong unit? {read}; it would be about as large as the view if the file were in {sizes}"
    return UnitGuess(unit, likely, text)
