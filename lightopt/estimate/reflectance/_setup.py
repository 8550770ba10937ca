"""The set-up of a fit: its options, and rig, part and images made ready."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from lightopt.config import PartConfig, PlacementConfig, RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.run_context import RunContext
from lightopt.estimate import registration
from lightopt.estimate.reflectance._estimate import FreeParameters
from lightopt.estimate.reflectance._paper import PaperOptions
from lightopt.estimate.reflectance._samples import OCTAVES, Samples, collect_samples
from lightopt.estimate.reflectance._sigma_scan import scan_sigma
from lightopt.estimate.registration import Observation, Registration
from lightopt.geometry import RayCaster
from lightopt.images import ImageSet
from lightopt.optics import LAMBERT, DiffuseForm, ModelName, Reflectance, SpecularModel
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, at_rest_warnings, build_scene

Points = int | Literal["auto"]

# pixels per octave of the deflection, light and posture; under lights that are no panels most pixels are in one octave,
# and each takes longer
MOST_PER_OCTAVE, FEW_PER_OCTAVE = 20_000, 4000
PLACING_PER_OCTAVE = 800
PAPER_PIXELS = 150_000  # pixels per image that the paper's procedure counts


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    method: Literal["likelihood", "paper"] = "likelihood"
    joint: bool = False
    gain: bool = False  # whether it is freed as well, and the dark level
    dark: bool = False
    register: bool = False  # whether the part's placement on the stage is found first
    points: tuple[Points, ...] = ()  # numbers of point lights per panel to try; the rig's own where empty
    pixels: int = 1_500_000  # about so many are used, over all images
    validate: bool = True
    write_noise: bool = False  # whether to write the noise of the images into the rig file
    # form of the specular lobe, not the part file's; auto for that by which left-out lights are predicted best
    model: ModelName | Literal["auto"] | None = None
    # form of the diffuse component, whose exponent or roughness is fitted, too; None for that of the part file
    diffuse: Literal["lambert", "exponent", "oren-nayar"] | None = None
    paper: PaperOptions = field(default_factory=PaperOptions)

    @property
    def freed(self) -> FreeParameters:
        return FreeParameters(diffuse=self.joint, gain=self.gain, dark=self.dark)


@dataclass(frozen=True)
class FitSetup:
    """The inputs of a fit: the scene with its part placed, the rays of the part, the images, and the options."""

    scene: Scene
    caster: RayCaster
    observations: tuple[Observation, ...]
    # how the part was placed, relative to its file and as values of the part file; None where the part was not
    # registered
    registration: Registration | None = None
    file_placement: PlacementConfig | None = None
    options: FitOptions = field(default_factory=FitOptions)
    run: RunContext = field(default_factory=RunContext)

    @property
    def warnings(self) -> tuple[str, ...]:
        found = () if self.registration is None else self.registration.warnings
        return (*at_rest_warnings(self.scene, max(o.exposure for o in self.observations)), *found)

    @property
    def held(self) -> Float64:
        """R_d, R_s and σ of the part file."""
        reflectance = self.scene.reflectance
        return np.array([reflectance.R_d, reflectance.R_s, reflectance.sigma])

    def with_lobe(self, name: ModelName | None) -> "FitSetup":
        """The same with a specular lobe of this form; None and that of the part file change nothing."""
        own = self.scene.reflectance.model
        if name in (None, own.name):
            return self
        return self.with_model(replace(own, name=name, wide_share=0.0, wide_ratio=1.0, measured=()))

    def with_model(self, model: SpecularModel) -> "FitSetup":
        return replace(self, scene=replace(self.scene, reflectance=replace(self.scene.reflectance, model=model)))

    def with_form(self, form: DiffuseForm) -> "FitSetup":
        return replace(self, scene=replace(self.scene, reflectance=replace(self.scene.reflectance, diffuse=form)))

    def collect(self, *, uniform: bool = False) -> Samples:
        """Samples of the images, as many as the options want; `uniform` for the paper's procedure."""
        pairs = len({(o.light, o.posture) for o in self.observations})
        most = MOST_PER_OCTAVE if self.scene.panels_only else FEW_PER_OCTAVE
        budget = max(20, min(most, self.options.pixels // (pairs * OCTAVES)))
        return collect_samples(
            self.scene,
            self.observations,
            caster=self.caster,
            budget=PAPER_PIXELS if uniform else budget,
            uniform=uniform,
            threads=self.run.threads,
            progress=self.run.stage("geometry"),
        )


def prepare_fit(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    points: Points | None,
    options: FitOptions,
    run: RunContext,
    *,
    model: ModelName | None = None,
) -> FitSetup:
    """Read the images, build the scene that they show, and register the part where its shift is freed.

    model: Form of the specular lobe; the part file's where it is None
    """
    observations = registration.read_observations(image_set, rig, part, threads=run.threads)
    used = {o.light for o in observations}
    names = [light.name for light in rig.lights if light.name in used]
    postures = registration.observed_postures(image_set)
    scene = build_scene(rig, part, postures=postures, lights=names, points=points, defects=False)
    setup = FitSetup(scene, cast_rays_at(scene), observations, options=options, run=run).with_lobe(model)
    if options.diffuse is not None:
        setup = setup.with_form(LAMBERT)
    if not options.register:
        return setup
    freed = FreeParameters(gain=options.gain, dark=options.dark)
    found = register_with_fit(setup.scene, observations, caster=setup.caster, freed=freed, run=run)
    moved = registration.place_part(setup.scene, found.placement)
    file_placement = registration.part_file_placement(scene, found.placement, part.placement)
    return replace(setup, scene=moved, caster=cast_rays_at(moved), registration=found, file_placement=file_placement)


def register_with_fit(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    freed: FreeParameters | None = None,
    reduced: bool = False,
    run: RunContext,
) -> Registration:
    """Register the part, its placement refined with a first fit of the reflectance."""

    def first_reflectance(moved: Scene) -> Reflectance:
        rays = cast_rays_at(moved)
        samples = collect_samples(moved, observations, caster=rays, budget=PLACING_PER_OCTAVE, threads=run.threads)
        # least squares alone, without intervals, are good enough to find a part by
        found = scan_sigma(samples, freed or FreeParameters(), None).best
        return replace(moved.reflectance, R_d=found.R_d, R_s=found.R_s, sigma=found.sigma)

    return registration.register(
        scene, observations, caster=caster, reflectance_at=first_reflectance, reduced=reduced, run=run
    )
