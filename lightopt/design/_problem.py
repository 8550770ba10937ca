"""The problem to solve: a rig and a part as a scene, objectives, and candidate positions of the lights."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.defects import DARK
from lightopt.design._candidates import Angles, Candidates, can_move, find_candidates
from lightopt.design._options import OptimizeOptions
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._defect_hypotheses import planned_catalogue
from lightopt.design.responses._evidence import DetectionModel
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable, build_patches
from lightopt.scene import Scene, build_catalogue, build_lights, build_sensor


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """A scene, objectives, and the candidate positions to search."""

    rig: RigConfig
    part: PartConfig
    options: OptimizeOptions  # with the postures and positions that were chosen, where requested
    objectives: tuple[Objective, ...]
    scene: Scene  # the part in its postures, the lights as the rig file has them
    caster: RayCaster  # of the scene's mesh
    thresholds: LevelThresholds  # which levels are usable [sensor level]
    candidates: Candidates  # one position of each light where they were chosen with the postures
    all_candidates: Candidates  # the positions that there were to choose from
    provenance: Mapping[str, Any]  # inputs, options and versions, from :func:`lightopt.core.provenance.provenance`

    @property
    def defects(self) -> DetectabilityObjective | None:
        """The objective of defects; None where it is not among the objectives."""
        return next((one for one in self.objectives if isinstance(one, DetectabilityObjective)), None)

    def cut_patches(self, *, edges: bool, threads: int | None) -> PatchTable:
        """The patches of the scene, as many as the options want; `edges` as for :func:`build_patches`."""
        budget = self.options.patch_budget
        return build_patches(self.scene, caster=self.caster, budget=budget, edges=edges, threads=threads)


def detection_model_of(scene: Scene, part: PartConfig, options: OptimizeOptions) -> DetectionModel:
    """The part's defect catalogue, with the sensor's noise."""
    return DetectionModel(
        catalogue=planned_catalogue(build_catalogue(part)),
        sensor=scene.sensor,
        full_scale=scene.reflectance.full_scale,
        false_alarms=options.false_alarms,
        threshold=None if options.threshold is None else options.threshold.score,
        min_images=options.min_images,
    )


def images_that_decide(rig: RigConfig, part: PartConfig, min_images: int, *, longest: float) -> int:
    """In how many images a defect must show: 1 where the surface scatters too little light to be seen.

    Such a surface is dark in all images but those whose highlight a place lies in, so that no other image can confirm
    what one shows. The inspection decides likewise, place by place.

    longest: Exposure that an image may be taken with.
    """
    sensor, reflectance = build_sensor(rig.camera), part.reflectance
    weight = max(light.total_weight for light in build_lights(rig, None))
    level = longest * sensor.max_level / reflectance.full_scale * reflectance.R_d * weight
    return min_images if level >= DARK * math.sqrt(sensor.noise_variance(level)) else 1


def candidates_of(rig: RigConfig, options: OptimizeOptions) -> Candidates | None:
    """The positions that the lights are chosen from; None where no light moves."""
    return candidates_in(None, rig, options) if any(map(can_move, rig.lights)) else None


def candidates_in(
    scene: Scene | None, rig: RigConfig, options: OptimizeOptions, places: Sequence[Angles] | None = None
) -> Candidates:
    """The same, without positions inside the scene's part; or `places`, one position of each light."""
    return find_candidates(
        rig,
        step_deg=options.step_deg,
        common_elevation=options.common_elevation,
        points=options.points,
        places=places,
        scene=scene,
    )
