"""From two YAML files to an image set on disk."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lightopt import __version__
from lightopt.config import MOST_BOUNCES, PartConfig, RigConfig, input_hashes, load_part, load_rig, points_problem
from lightopt.core.arrays import Float32
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.provenance import provenance
from lightopt.core.run_context import RunContext, part_of
from lightopt.core.threads import BackgroundTasks
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.images import ImageEntry, ImageKey, ImageSetWriter, Manifest, SourceFile
from lightopt.lights import PanelLight
from lightopt.optics import expose, image_rng
from lightopt.rendering._images import LightImage, PostureImages, cast_rays_at, rays_of_images, render_posture
from lightopt.rendering._patches import DEFAULT_PATCH_BUDGET, build_patches
from lightopt.rendering._scene_checks import refuse_unusable_scene
from lightopt.scene import Scene, build_scene, coarse_warnings, defect_facts, pixel_footprint

BACK_FACE_SHARE = 1e-4
"""Share of the part's pixels that may see back faces without a warning: at the silhouette of a closed mesh, where a ray
only grazes a face, rounding turns one now and then."""


MOST_SUPERSAMPLE = 16  # rays a side of a pixel

# pixels of images that are written while the next posture is rendered; larger ones would be in memory twice
WRITTEN_AT_ONCE = 4_000_000

LEAST_RAYS_ACROSS = 3  # rays across a defect from which on its share of a pixel is about right


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """What to render and how; InputError where a number is out of range or something is given twice."""

    lights: tuple[str, ...] | None = None  # names of the lights to render; all by default
    postures: tuple[Posture, ...] | None = None
    points: int | Literal["auto"] | None = None  # point lights per panel, instead of the rig's
    # exposures of the camera's PNGs; the linear images are at exposure 1, of a part that moves as in the longest one
    exposures: tuple[float, ...] = (1.0,)
    noise: int | None = None  # seed of the sensor's noise in the PNGs; None for none
    layers: bool = False  # whether the EXRs get the diffuse and the specular component as channels of their own
    shadows: bool = True  # whether the part casts shadows on itself
    supersample: int = 1  # n² rays per pixel
    patch_budget: int = DEFAULT_PATCH_BUDGET  # about how many patches may be visible
    defects: bool = True  # whether the part's defects are shown; the good part otherwise
    bounces: int = 0  # how often light goes from the part to the part before it reaches the camera

    def __post_init__(self) -> None:
        refuse(self._problems())

    def _problems(self) -> Iterator[str]:
        for exposure in self.exposures:
            if not (math.isfinite(exposure) and exposure > 0.0):
                yield f"option 'exposures': expected a number above 0, found {exposure:g}"
        if len(set(self.exposures)) < len(self.exposures):
            yield "option 'exposures': the same exposure was given twice"
        if not 1 <= self.supersample <= MOST_SUPERSAMPLE:
            yield f"option 'supersample': expected 1 to {MOST_SUPERSAMPLE}, found {self.supersample}"
        if not 0 <= self.bounces <= MOST_BOUNCES:
            yield f"option 'bounces': expected 0 to {MOST_BOUNCES}, found {self.bounces}"
        if self.patch_budget < 1:
            yield f"option 'patch_budget': expected at least 1, found {self.patch_budget}"
        if self.noise is not None and self.noise < 0:
            yield f"option 'noise': expected a seed of 0 or more, found {self.noise}"
        if self.postures is not None and len(set(self.postures)) < len(self.postures):
            yield "option 'postures': the same posture was given twice"
        if self.points is not None and (problem := points_problem(self.points)):
            yield f"option 'points': {problem}"


@dataclass(frozen=True, kw_only=True)
class RenderedSet:
    """What :func:`render_image_set` left on disk."""

    folder: Path
    images: int
    resumed: int  # number of those that a previous run with the same inputs had finished
    warnings: tuple[str, ...]
    rays: int = 0  # number of rays cast for images
    patches: str | None = None  # what the patch refinement reached; None where nothing was left to do
    replaced: int = 0  # number of files of another set that were removed (with `force`)


def render_image_set(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: RenderOptions = RenderOptions(),
    force: bool = False,
    run: RunContext | None = None,
) -> RenderedSet:
    """Render a part on a rig into a folder: EXR and PNG per light, geometry, patches, manifest.

    Files are written one after the other while the next posture is rendered, each of them listed in the manifest when
    it is on disk; a run that was killed is resumed by running it again.

    rig, part: Configurations, or the paths of their YAML files
    folder: Made where it does not exist
    run: Its stages are the postures, with the share of all of them
    Raises InputError: Whatever is wrong with the files, the options or the folder; a panel inside the part; a part that
        too few pixels see. Nothing is written before all inputs are read.
    """
    run = run or RunContext()
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    scene = build_scene(rig, part, **_chosen(options, "postures", "lights", "points", "defects", "bounces"))
    caster: RayCaster | None = cast_rays_at(scene, rays=rays_of_images(scene, supersample=options.supersample))
    refuse_unusable_scene(scene, rig, part, caster)
    plan = [
        (light.name, posture, exposure)
        for posture in scene.postures
        for light in scene.lights
        for exposure in rig.exposures(light.name, options.exposures)
    ]
    writer = ImageSetWriter(folder, _header(rig, part, scene, options), force=force, plan=plan)
    if scene.motion is not None:
        _refuse_longer_exposures(writer, plan)
    warnings: dict[str, None] = {}

    def warn(*texts: str) -> None:
        warnings.update(dict.fromkeys(texts))
        run.warn(*texts)
        writer.add_warnings(texts)

    warn(*scene.warnings, *coarse_warnings(scene.lights, scene.sharpest), *_narrow_defects(scene, rig, options))
    resumed = sum(writer.done(*key) for key in plan)
    if resumed == len(plan) and writer.file_done() and all(map(writer.geometry_done, scene.postures)):
        return RenderedSet(folder=Path(folder), images=len(plan), resumed=resumed, warnings=tuple(warnings))
    table = build_patches(scene, caster=caster, budget=options.patch_budget, threads=run.threads)
    rays = 0
    # packing the patches takes as long as images and writing them
    with BackgroundTasks() as packing, BackgroundTasks() as disk:
        if not writer.file_done():
            packing.add(writer.add_patches, table.arrays())
        rounds = [(posture, exposure) for posture in scene.postures for exposure in _blurred_apart(scene, plan)]
        for number, (posture, exposure) in enumerate(rounds):
            todo = [key for key in plan if key[1] == posture and exposure in (None, key[2]) and not writer.done(*key)]
            if not todo and writer.geometry_done(posture):
                continue
            stage = run.stage(f"rendering {posture.elevation_deg:g},{posture.rotation_deg:g}")
            assert caster is not None
            names = {key[0] for key in todo}
            images = render_posture(
                scene if exposure is None else replace(scene, lights=tuple(x for x in scene.lights if x.name in names)),
                posture,
                caster=caster,
                patches=table.patches,
                exposure=exposure,
                threads=run.threads,
                progress=part_of(stage, number / len(rounds), (number + 1) / len(rounds)),
                **_chosen(options, "shadows", "supersample", "layers"),
            )
            rays += images.rays
            packing.check()
            if number + 1 == len(rounds):
                # its hierarchy takes as much memory as writing does; freed where no Ctrl-C arrives, which would be lost
                last, caster = [caster], None
                disk.add(last.clear)
            disk.wait()  # so that no more than two postures are in memory
            if images.back_faces > BACK_FACE_SHARE * images.geometry.hit.sum():
                warn(
                    f"posture {posture}: {counted(images.back_faces, 'pixel')} on the back of a face, black; the mesh "
                    "is open or its winding is wrong there"
                )
            _write_posture(disk, writer, scene, images, todo, [light.name for light in rig.lights], options.noise)
            if images.geometry.hit.size > WRITTEN_AT_ONCE:
                disk.wait()
    return RenderedSet(
        folder=Path(folder),
        images=len(plan),
        resumed=resumed,
        rays=rays,
        patches=table.message,
        replaced=writer.replaced,
        warnings=tuple(warnings),
    )


def _blurred_apart(scene: Scene, plan: Sequence[ImageKey]) -> Sequence[float | None]:
    # exposures that are rendered one by one, as those of a part that moves differ: the longest, which the linear image
    # is of, before the others
    return (None,) if scene.motion is None else sorted({key[2] for key in plan}, reverse=True)


def _refuse_longer_exposures(writer: ImageSetWriter, plan: Sequence[ImageKey]) -> None:
    # the linear image of a part that moves has the blur of its longest exposure, and is written once
    listed = [entry.key for entry in writer.manifest.images]
    for light, posture, exposure in plan:
        longest = max((key[2] for key in listed if key[:2] == (light, posture)), default=exposure)
        if exposure > longest:
            raise InputError(
                f"{writer.folder}: {light}, posture {posture}: the set has exposure {longest:g}, and its linear "
                f"image would be blurred as by exposure {exposure:g}, as the part moves; use option 'force' to replace "
                "the set, or choose another folder"
            )


def _chosen(options: RenderOptions, *names: str) -> dict[str, Any]:
    return {name: getattr(options, name) for name in names}


def _header(rig: RigConfig, part: PartConfig, scene: Scene, options: RenderOptions) -> Manifest:
    chosen: dict[str, Any] = {"postures": [posture.as_dict() for posture in scene.postures]}
    chosen |= _chosen(options, "points", "noise", "layers", "shadows", "supersample", "patch_budget")
    if options.bounces:
        chosen["bounces"] = options.bounces
    # sets of parts without defects do not mention them
    if part.defects and not options.defects:
        chosen["defects"] = False
    shown = {"defects": defect_facts(scene.defects, scene.placement)} if scene.defects else {}
    return set_manifest("simulated", rig, part, scene, options=chosen, extra=shown)


def set_manifest(
    kind: str,
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    *,
    options: Mapping[str, Any],
    extra: Mapping[str, Any] | None = None,
) -> Manifest:
    """Manifest of an image set that is begun, rendered or captured; no image is listed yet.

    options: Options of the run that change the images, in JSON form.
    """
    return Manifest(
        kind=kind,
        bit_depth=scene.sensor.bit_depth,
        full_scale=scene.reflectance.full_scale,
        saturation_level=scene.sensor.saturation_level,
        black_level=scene.sensor.black_level,
        lightopt=__version__,
        # names only, so that the same files give the same manifest wherever they lie
        rig=SourceFile(rig.source.path.name, rig.source.sha256),
        part=SourceFile(part.source.path.name, part.source.sha256),
        # a set that was begun by other code or packages is not continued: meshes, hits and noise depend on them
        provenance=provenance(input_hashes(rig, part), options),
        extra=extra or {},
    )


def _narrow_defects(scene: Scene, rig: RigConfig, options: RenderOptions) -> tuple[str, ...]:
    # defects between whose neighbouring rays there is room to be missed
    spacing = pixel_footprint(scene.camera, rig.camera.distance_mm) / options.supersample
    names = [defect.name for defect in scene.defects if defect.shape.width < spacing]
    if not names:
        return ()
    least = min(defect.shape.width for defect in scene.defects)
    enough = math.ceil(LEAST_RAYS_ACROSS * spacing * options.supersample / least)
    text = (
        f"{counted(len(names), 'defect')} narrower than the {spacing:.3g} mm between rays "
        f"({', '.join(names[:3])}{', …' if len(names) > 3 else ''}): some pixels miss what they would show; "
        f"supersampling by {min(enough, MOST_SUPERSAMPLE)} shows how far they fill each pixel"
    )
    return (text,)


def _write_posture(
    disk: BackgroundTasks,
    writer: ImageSetWriter,
    scene: Scene,
    images: PostureImages,
    todo: Sequence[ImageKey],
    numbered: Sequence[str],
    noise: int | None,
) -> None:
    """Have written what the folder lacks of a posture: its geometry, and the images of `todo`.

    numbered: Names of the rig's lights, whose order numbers their noise
    noise: Seed
    """
    if not writer.geometry_done(images.posture):
        disk.add(_add_geometry, writer, images)
    lights, levels = ({one.name: one for one in scene.lights}, {one.light: one for one in images.lights})
    for name, _, exposure in todo:
        seeds = None if noise is None else (noise, numbered.index(name))
        disk.add(_add_image, writer, scene, images, lights[name], levels[name], exposure, seeds)


def _add_geometry(writer: ImageSetWriter, images: PostureImages) -> None:
    g = images.geometry
    channels = {
        **{f"P.{axis}": g.points[..., i] for i, axis in enumerate("XYZ")},
        **{f"N.{axis}": g.normals[..., i] for i, axis in enumerate("XYZ")},
        "Z": g.distance,
        "patch": g.patch.astype(np.float32),
    }
    if g.defect is not None:
        channels["defect"] = g.defect.astype(np.float32)
    writer.add_geometry(images.posture, channels, metadata={"back_face_pixels": images.back_faces})


def _add_image(
    writer: ImageSetWriter,
    scene: Scene,
    images: PostureImages,
    light: PanelLight,
    image: LightImage,
    exposure: float,
    seeds: tuple[int, int] | None,
) -> None:
    rng = None
    if seeds is not None:
        seed, light_index = seeds
        # an image's noise must not depend on which others are rendered: the bits of angles and exposure are their
        # numbers
        posture = _bits(images.posture.elevation_deg) << 64 | _bits(images.posture.rotation_deg)
        rng = image_rng(seed, light=light_index, posture=posture, exposure=_bits(exposure))
    levels = expose(
        image.level, sensor=scene.sensor, exposure=exposure, full_scale=scene.reflectance.full_scale, rng=rng
    )
    entry = ImageEntry(
        light=light.name,
        light_elevation_deg=_degrees(light.elevation),
        light_azimuth_deg=_degrees(light.azimuth),
        posture=images.posture,
        exposure=exposure,
    )
    linear: dict[str, Float32] = {"Y": image.level}
    if image.diffuse is not None and image.specular is not None:
        linear |= {"diffuse.Y": image.diffuse, "specular.Y": image.specular}
    # the exposures of an image share its EXR; one that was lost or damaged is not known
    known = any(e.key[:2] == entry.key[:2] and writer.done(*e.key) for e in writer.manifest.images)
    writer.add_image(entry, png=levels, exr=None if known else linear)


def _bits(value: float) -> int:
    return int(np.float64(value + 0.0).view(np.uint64))  # −0 is 0


def _degrees(angle: float) -> float:
    # radians came from degrees of at most a few decimals; rounding gives those back
    return round(float(np.degrees(angle)), 9)
