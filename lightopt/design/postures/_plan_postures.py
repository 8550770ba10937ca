"""Choose the postures of a plan, from a rig and a part: the entry to this package."""

from __future__ import annotations

from dataclasses import replace

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool
from lightopt.core.errors import CheckFailed, counted
from lightopt.core.run_context import RunContext
from lightopt.design._commands import way_through
from lightopt.design._options import OptimizeOptions, PlanOptions
from lightopt.design._plan_result import ChosenPostures
from lightopt.design.blind_spots._unreachable_target import target_not_reached
from lightopt.design.candidates._candidates import Candidates, find_candidates
from lightopt.design.exposures._joint_choice import choose_with_exposures
from lightopt.design.postures._choice import PostureChoice, PostureRequest
from lightopt.design.postures._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.postures._posture_grid import posture_grid, usable_postures
from lightopt.design.responses._contrast import Contrast
from lightopt.design.responses._defect_hypotheses import defect_hypotheses
from lightopt.design.responses._detection import DetectionModel
from lightopt.rendering import PatchTable, build_patches, cast_rays_at
from lightopt.scene import Scene, build_catalogue, build_lights, build_scene, pace_text


def plan_postures(
    rig: RigConfig,
    part: PartConfig,
    options: OptimizeOptions,
    wanted: PlanOptions,
    run: RunContext,
) -> tuple[ChosenPostures, ImageEvaluator]:
    """Choose the postures, and the light positions that go with them; also returns the evaluator of all patches.

    Raises InputError: Whatever is wrong with the files or the options.
    Raises CheckFailed: A target that cannot be reached, or no defect that any posture shows.
    """
    candidates = candidates_of(rig, options)
    scene = build_scene(rig, part, points=options.points, defects=False)
    grid = posture_grid(rig, part, step_deg=wanted.posture_step_deg)
    caster = cast_rays_at(scene)
    lights = build_lights(rig, None, options.points)
    positions = lights if candidates is None else tuple(p for some in candidates.panels for p in some)
    postures, left_out = usable_postures(
        replace(scene, postures=grid), positions, allow_outside_px=wanted.allow_outside_px
    )
    few = wanted.postures is not None and len(postures) < wanted.postures
    shortfall = f", fewer than the {wanted.postures} that were asked for" if few else ""
    run.inform(
        f"{counted(len(postures), 'posture')} to choose from{shortfall}, {len(left_out)} left out; patches are cut "
        "for all of them"
    )
    scene = replace(scene, postures=postures)
    table = build_patches(scene, caster=caster, budget=options.patch_budget)
    whole = ImageEvaluator(
        scene=scene,
        table=table,
        caster=caster,
        detection=detection_model_of(scene, part, options),
        shadows=options.shadows,
        threads=run.threads,
    )
    drawn = replace(whole, table=drawn_patches(table, DRAWN_PATCHES))
    choice, brackets = choose_with_exposures(
        whole,
        drawn,
        postures,
        lights,
        candidates,
        PostureRequest(
            seen_in=options.seen_in, count=wanted.postures, target=wanted.target, limit=options.limit
        ),
        exposures=wanted.all_exposures,
        gain_points=wanted.exposure_gain,
        run=run,
    )
    if wanted.target is not None and choice.cover.share < wanted.target:
        offered = replace(drawn, exposures=wanted.all_exposures)
        raise target_not_reached(wanted.target, choice, offered, least=options.seen_in)
    if not choice.postures:
        raise CheckFailed(
            f"no posture of {len(postures)} shows any defect of {part.source.path}'s catalogue in "
            f"{counted(options.seen_in, 'image')} or more: lower --threshold or --seen-in, or change the lights' gain, "
            "their ranges, or the catalogue"
        )

    chosen = ChosenPostures(
        choice=choice,
        brackets=brackets,
        candidate_count=len(postures),
        left_out=left_out,
        way=way_through(rig, choice.postures),
        pace=pace_text(rig),
        least=options.seen_in,
        requested=wanted.postures,
        target=wanted.target,
        drawn=len(drawn.patches),
        patches=len(whole.patches),
        max_edge=table.max_edge,
        footprint=table.footprint,
        grain=table.grain,
        inspectable_share=_area_share(table, table.inspectable_anywhere),
        left_out_share=_area_share(table, table.visible.any(axis=0) & ~table.inspectable_anywhere),
        exposures=wanted.all_exposures,
    )
    return chosen, whole


def _area_share(table: PatchTable, which: Bool) -> float:
    areas = table.patches.areas
    return float(areas[which].sum() / areas.sum())


def chosen_angles(
    rig: RigConfig, choice: PostureChoice, options: OptimizeOptions
) -> tuple[tuple[float, float], ...]:
    """Elevation and azimuth of each light in a choice [°]."""
    if choice.lights is None:
        return tuple((light.elevation_deg, light.azimuth_deg) for light in rig.lights)
    angles = candidates_of(rig, options)
    assert angles is not None
    return tuple(places[k] for places, k in zip(angles.angles, choice.lights, strict=True))


def detection_model_of(scene: Scene, part: PartConfig, options: OptimizeOptions) -> DetectionModel:
    """The part's defect catalogue, with the sensor's noise."""
    return DetectionModel(
        hypotheses=defect_hypotheses(build_catalogue(part)),
        contrast=Contrast(
            sensor=scene.sensor, full_scale=scene.reflectance.full_scale, threshold=options.contrast
        ),
    )


def candidates_of(rig: RigConfig, options: OptimizeOptions) -> Candidates | None:
    """The positions that the lights are chosen from; None where no light moves."""
    if all(light.elevation_range_deg is None and light.azimuth_range_deg is None for light in rig.lights):
        return None
    return find_candidates(
        rig, step_deg=options.step_deg, common_elevation=options.common_elevation, points=options.points
    )
