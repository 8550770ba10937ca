"""What to optimise, what to plan in addition, and the problem to solve: a scene, objectives, candidate positions.

Candidate postures are a grid over the stage's ranges, without postures that cannot be used.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from lightopt.config import PartConfig, RigConfig, input_hashes, points_problem
from lightopt.core.errors import InputError, refuse
from lightopt.core.provenance import provenance
from lightopt.core.transforms import Posture
from lightopt.defects import DARK, DEFAULT_FALSE_ALARMS, false_alarms_problem
from lightopt.design._candidates import Candidates, Place, can_move, find_candidates, step_problems
from lightopt.design._tolerances import Tolerances
from lightopt.design.objectives import OBJECTIVES
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._exposures import DEFAULT_EXPOSURE_GAIN
from lightopt.design.responses._evidence import DetectionModel
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._pairs import planned_catalogue
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.rendering import DEFAULT_PATCH_BUDGET, PatchTable, build_patches, panels_in_part
from lightopt.scene import Scene, build_catalogue, build_lights, build_sensor, frame_part, part_postures, view_from_part

# of tilt and rotation [°], by default: a stage of ±45° and a full turn then has 80 postures
DEFAULT_POSTURE_STEP = 22.5

# How far the part may leave the view in a posture to choose from [px] by default: no further than a part may be off its
# place, so that its rim is near the image's border anyway. What is outside is not seen in that posture.
DEFAULT_OUTSIDE_PX = 10.0

MOST_POSTURES = 2000  # more candidate postures are refused

DEFAULT_SHADE_SHARE = 10.0 / 255.0  # share of full scale, above black, below which a level is shaded
DEFECT_OBJECTIVE = "detectability"  # the objective whose pairs of patch and defect are planned for


@dataclass(frozen=True, kw_only=True)
class CalibratedThreshold:
    """The score from which a calibrated inspection counts a defect: that of its posture with the highest."""

    score: float
    file: str  # name of the calibration
    sha256: str  # hash of the calibration


@dataclass(frozen=True, kw_only=True)
class OptimizeOptions:
    objectives: tuple[str, ...] = ()  # all where empty; the first decides where the lights go
    step_deg: float = 5.0  # of the angles within the lights' ranges [°]
    common_elevation: bool = False  # whether all lights that move in elevation stand at the same one
    common_lights: bool = True  # one set of positions, best for the sum over all postures; else one for each posture
    shade_below: float = DEFAULT_SHADE_SHARE  # share of full scale, above black, below which a level is shaded
    min_images: int = 2  # images that must show a defect, for objective detectability
    false_alarms: float = DEFAULT_FALSE_ALARMS  # per posture of a good part, for objective detectability
    threshold: CalibratedThreshold | None = None  # of a calibrated inspection; else that of noise
    postures: tuple[Posture, ...] | None = None  # instead of the part's own
    points: int | Literal["auto"] | None = None  # point lights per panel, instead of the rig's
    shadows: bool = True
    patch_budget: int = DEFAULT_PATCH_BUDGET  # about how many patches may be visible
    keep_matrix: bool = False
    images: bool = True  # whether images of the best set are part of the results
    report: bool = False  # whether an HTML report is part of the results
    rows: int = 100  # combinations in the ranking, for each posture and objective
    limit: int = DEFAULT_LIMIT  # most combinations to score
    # of each light, where they were chosen before for the first objective: then only the others are searched
    places: tuple[Place, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """What to plan in addition to the positions of the lights; nothing by default."""

    choose_postures: int | None = None  # how many to choose; as many as the target takes where None
    target: float | None = None  # share of the pairs of patch and defect that the chosen ones are to show
    posture_step_deg: float = DEFAULT_POSTURE_STEP  # step of the grid of postures to choose from [°]
    allow_outside_px: float = DEFAULT_OUTSIDE_PX  # how far the part may leave the view in them [px]
    exposures: tuple[float, ...] = ()  # to choose from beside exposure 1
    exposure_gain: float = DEFAULT_EXPOSURE_GAIN  # points that an exposure has to add
    tolerances: Tolerances | None = None

    @property
    def chooses(self) -> bool:
        return self.choose_postures is not None or self.target is not None

    @property
    def all_exposures(self) -> tuple[float, ...]:
        return (1.0, *(exposure for exposure in self.exposures if exposure != 1.0))

    def facts(self) -> dict[str, Any]:
        facts: dict[str, Any] = {}
        if self.chooses:
            names = ("choose_postures", "target", "posture_step_deg", "allow_outside_px")
            facts |= {name: getattr(self, name) for name in names}
        if self.exposures:
            facts |= {"exposures": list(self.exposures), "exposure_gain": self.exposure_gain}
        if self.tolerances is not None:
            values = asdict(self.tolerances)
            facts["tolerances"] = {name.removeprefix("tolerance_"): value for name, value in values.items()}
        return facts


def check_options(options: OptimizeOptions, plan: PlanOptions) -> None:
    """Refuse options that are out of range, all at once."""
    problems: list[str] = []
    if options.points is not None and (problem := points_problem(options.points)):
        problems.append(f"option 'points': {problem}")
    problems += step_problems("step_deg", options.step_deg)
    problems += step_problems("posture_step_deg", plan.posture_step_deg)
    known = (*OBJECTIVES, DEFECT_OBJECTIVE)
    problems += [
        f"option 'objectives': expected {' or '.join(known)}, found \"{name}\""
        for name in options.objectives
        if name not in known
    ]
    numbers = {name: getattr(options, name) for name in ("patch_budget", "rows", "limit", "min_images")}
    for name, value in {**numbers, "choose_postures": plan.choose_postures}.items():
        if value is not None and value < 1:
            problems.append(f"option '{name}': expected at least 1, found {value}")
    problems += filter(None, [false_alarms_problem(options.false_alarms)])
    if plan.target is not None and not 0.0 < plan.target <= 1.0:
        share = "a share of the surface above 0 and up to 1, such as 0.95"
        problems.append(f"option 'target': expected {share}, found {plan.target:g}")
    if not 0.0 <= plan.allow_outside_px < math.inf:
        problems.append(f"option 'allow_outside_px': expected pixels, 0 or more, found {plan.allow_outside_px:g}")
    problems += [
        f"option 'exposures': expected numbers above 0, such as 1/16,1/4,1,4,16, found {exposure:g}"
        for exposure in plan.exposures
        if not 0.0 < exposure < math.inf
    ]
    given_names = ("posture", options.postures or ()), ("exposure", plan.exposures), ("objective", options.objectives)
    for name, given in given_names:
        if len(set(given)) < len(given):
            problems.append(f"option '{name}s': the same {name} was given twice")
    if not 0.0 <= plan.exposure_gain <= 100.0:
        problems.append(f"option 'exposure_gain': expected points from 0 to 100, found {plan.exposure_gain:g}")
    refuse(problems)


def run_provenance(
    rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions, known: dict[str, Any] | None = None
) -> Mapping[str, Any]:
    """What ``result.json`` says a run depends on.

    known: Names of the objectives, and postures; None before these are: then only what does not depend on them.
    """
    names = ("step_deg", "common_elevation", "points", "shadows", "patch_budget")
    if known is not None:
        names += ("common_lights", "shade_below", "images", "report")
    facts: dict[str, Any] = {name: getattr(options, name) for name in names}
    if known is not None:
        facts |= {**known, "max_combinations": options.limit, "ranking_rows": options.rows}
    # postures and exposures are planned for defects, whatever the objective
    if plan.chooses or plan.exposures or DEFECT_OBJECTIVE in (known or {}).get("objectives", ()):
        facts |= {"min_images": options.min_images, "false_alarms": options.false_alarms}
        facts |= {} if options.threshold is None else {"calibration": asdict(options.threshold)}
    return provenance(input_hashes(rig, part), {**facts, **plan.facts()})


@dataclass(frozen=True, eq=False)
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
    return candidates_in(None, rig, options) if any(map(can_move, rig.lights)) else None


def candidates_in(
    scene: Scene | None, rig: RigConfig, options: OptimizeOptions, places: Sequence[Place] | None = None
) -> Candidates:
    """The same, without positions inside the scene's part; or `places`, one position of each light."""
    same = {name: getattr(options, name) for name in ("step_deg", "common_elevation", "points")}
    return find_candidates(rig, **same, places=places, scene=scene)


@dataclass(frozen=True)
class ExcludedPosture:
    """A posture in the stage's range that cannot be planned; `kind` is ``view`` or ``part``."""

    posture: Posture
    reason: str
    kind: str


def posture_grid(rig: RigConfig, part: PartConfig, *, step_deg: float) -> tuple[Posture, ...]:
    """Candidate postures: the part's own ones that the stage reaches, then tilts and rotations at a step.

    Each angle takes the multiples of the step within the stage's range, 0 among them, and both ends of the range; a
    range of a full turn or more takes one turn, without its end. An axis that the rig's stage does not have stays at
    0.
    """
    refuse(step_problems("posture_step_deg", step_deg))
    # an axis that a given stage lacks does not turn
    tilt_range, rotation_range = rig.stage.elevation_range_deg, rig.stage.rotation_range_deg
    if rig.hardware is not None:
        stage = rig.hardware.stage
        tilt_range = (0.0, 0.0) if stage is None or stage.elevation is None else tilt_range
        rotation_range = (0.0, 0.0) if stage is None or stage.rotation is None else rotation_range
    tilts, rotations = _angles(tilt_range, step_deg), _angles(rotation_range, step_deg)
    if len(tilts) * len(rotations) > MOST_POSTURES:
        number = f"{len(tilts):,} × {len(rotations):,} postures at {step_deg:g}°, more than {MOST_POSTURES:,}"
        raise InputError(f"option 'posture_step_deg': {number}; take a larger step, or narrow the stage's ranges")
    (lowest, highest), (first, last) = tilt_range, rotation_range
    own = [p for p in part_postures(part) if lowest <= p.elevation_deg <= highest and first <= p.rotation_deg <= last]
    return tuple(dict.fromkeys([*own, *(Posture(tilt, rotation) for tilt in tilts for rotation in rotations)]))


def usable_postures(
    scene: Scene, panels: Sequence[PanelLight], *, allow_outside_px: float = DEFAULT_OUTSIDE_PX
) -> tuple[tuple[Posture, ...], tuple[ExcludedPosture, ...]]:
    """The scene's postures that keep the part in view and clear of the lights, and the others with the reason.

    panels: Every position of a light, world frame; the scene's own lights are ignored.
    allow_outside_px: How far the part may leave the view at a side of the image [px].
    """
    unseen = {posture: _out_of_view(scene, posture, allow_outside_px) for posture in scene.postures}
    others = tuple(posture for posture, reason in unseen.items() if reason is None)
    # all postures at once: the points of thousands of panels are computed once
    inside = panels_in_part(replace(scene, lights=tuple(panels), postures=others))
    first_inside = {found.posture: found.light for found in reversed(inside)}
    usable: list[Posture] = []
    left_out: list[ExcludedPosture] = []
    for posture, found in unseen.items():
        if found is None and posture in first_inside:
            found = f"a position of {first_inside[posture]} is inside the part", "part"
        if found is None:
            usable.append(posture)
        else:
            left_out.append(ExcludedPosture(posture, *found))
    if not usable:
        first = left_out[0]
        raise InputError(
            f"no posture of {len(left_out)} is left to choose from: in {first.posture} {first.reason}; change the "
            "part's placement or the stage's ranges, or raise option 'allow_outside_px'"
        )
    return tuple(usable), tuple(left_out)


def _angles(ends: tuple[float, float], step: float) -> list[float]:
    low, high = ends
    if high - low > 360.0:  # of what is more than a turn, the one from 0 on, or as near to it as there is
        low = max(low, min(0.0, high - 360.0))
        high = low + 360.0
    if (high - low) / step > MOST_POSTURES:
        return [low] * (MOST_POSTURES + 1)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    inner = [round(k * step, 9) + 0.0 for k in range(first, last + 1)]
    angles = sorted({low, high, *(angle for angle in inner if low < angle < high)})
    return angles[:-1] if math.isclose(high - low, 360.0) else angles


def _out_of_view(scene: Scene, posture: Posture, allowed: float) -> tuple[str, str] | None:
    framing = frame_part(view_from_part(scene, posture).camera, scene.mesh)
    if framing.nearest <= 0.0:
        return "the part reaches behind the camera", "view"
    if not framing.outside and -min(framing.margins.values()) <= allowed:
        return None
    leaves = [f"{_pixels(-pixels)} at the {side}" for side, pixels in framing.margins.items() if pixels < 0.0]
    limit = "nothing of it is visible" if framing.outside else f"{_pixels(allowed)} are allowed"
    return f"the part leaves the view by {', '.join(leaves)}; {limit}", "view"


def _pixels(amount: float) -> str:
    # rounded up, so that what is more than what is allowed does not read as the same
    return f"{math.ceil(10.0 * amount) / 10.0:g} px"
