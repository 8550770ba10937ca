"""From two YAML files to the best light positions, on disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.design._additions import Appendix, Appraise, Outcome
from lightopt.design._files import Written, write_outputs
from lightopt.design._found import Draft
from lightopt.design._options import OptimizeOptions, check_options
from lightopt.design._previous_result import refuse_other_result
from lightopt.design._provenance import provenance_of
from lightopt.design._result import SetResult
from lightopt.design._rig_file import check_editable
from lightopt.design._texts import combinations_text
from lightopt.design.blind_spots._classes import Legend
from lightopt.design.blind_spots._files import blind_files, blind_pictures
from lightopt.design.blind_spots._summary import BlindReport
from lightopt.design.candidates._angles import can_move
from lightopt.design.candidates._candidates import Candidates, find_candidates
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.objectives._registry import objectives_named
from lightopt.design.responses._contrast import Contrast
from lightopt.design.responses._defect_hypotheses import defect_hypotheses
from lightopt.design.responses._detection import DetectionModel
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._posture_matrices import PostureMatrices
from lightopt.design.search._all_objectives import (
    candidates_of_others,
    search_objectives,
    search_other_objectives,
)
from lightopt.images import Overlap
from lightopt.rendering import PatchTable, Report, cast_rays_at, refuse_hopeless
from lightopt.scene import build_catalogue, build_scene, coarse_warnings


@dataclass(frozen=True, kw_only=True)
class Optimum:
    """What :func:`optimize` found and left on disk.

    Attributes
    ----------
    candidates
        The positions that the results are of: one of each light where these were chosen before.
    offered
        The positions that there were to choose from.
    thresholds
        Which levels are usable [sensor level].
    results
        One per posture, or one for all of them.
    blind
        Blind spots, where defects were looked for.
    written
        The files.
    reused
        Number of luminance matrices that were kept from an earlier run.
    patches
        What the patch refinement reached; None where all matrices were kept and there is no report.
    warnings
        What was repaired or is partly wrong.
    """

    candidates: Candidates
    offered: Candidates
    thresholds: LevelThresholds
    results: tuple[SetResult, ...]
    blind: BlindReport | None
    written: Written
    reused: int
    patches: str | None
    warnings: tuple[str, ...]


def optimize(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: OptimizeOptions | None = None,
    force: bool = False,
    warn: Callable[[str], None] | None = None,
    tell: Callable[[str], None] | None = None,
    report: Report | None = None,
    searching: Callable[[str, float], None] | None = None,
    appraise: Appraise | None = None,
    page: Callable[[Draft], str] | None = None,
    legend: Legend | None = None,
    table: PatchTable | None = None,
) -> Optimum:
    """Find the best positions of a rig's lights for a part (paper, section 5), and write them to a folder.

    Parameters
    ----------
    rig, part
        Configurations, or the paths of their YAML files.
    folder
        Made where it does not exist.
    options
        What to optimise and how; by default all as :class:`OptimizeOptions` has it.
    force
        Replace results that are there and differ.
    warn
        Called with each warning as it comes up.
    tell
        Called with how many positions and combinations there are, before the rays are cast.
    report
        Called as the luminance matrices are computed.
    searching
        Called with what is searched for and the share of that which is done.
    appraise
        Called with what was found; what it returns is written with the rest.
    page
        Makes the HTML of report.html, such as :func:`lightopt.report.optimum_report`; None for no report.
    legend
        Adds the legend to pictures of blind spots, such as :func:`lightopt.report.with_legend`; None for none.
    table
        Patches that were cut before, of the postures of the options in their order.

    Raises
    ------
    InputError
        Whatever is wrong with the files, the options or the folder.
    """
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    options = options or OptimizeOptions()
    check_options(options)
    warnings: list[str] = []

    def say(text: str) -> None:
        if text not in warnings:
            warnings.append(text)
            if warn is not None:
                warn(text)

    find = partial(
        find_candidates,
        rig,
        step_deg=options.step_deg,
        common_elevation=options.common_elevation,
        points=options.points,
        places=options.places,
    )
    find()  # what is wrong with the rig alone is told before the part is loaded
    check_editable(rig)
    objectives = _objectives(rig, part, options, say)
    scene = build_scene(rig, part, postures=options.postures, points=options.points, defects=False)
    thresholds = LevelThresholds.of_sensor(
        shade_share=options.shade_below,
        max_level=scene.sensor.max_level,
        saturated_from=scene.sensor.saturated_from,
        black_level=scene.sensor.black_level,
    )
    provenance = provenance_of(rig, part, scene, options, objectives, report=page is not None)
    if not force:
        refuse_other_result(Path(folder), provenance)
    caster = cast_rays_at(scene)
    # a light that moves may find its way out of the part: only its candidates count
    still = tuple(panel for panel, light in zip(scene.lights, rig.lights, strict=True) if not can_move(light))
    refuse_hopeless(replace(scene, lights=still), rig, part, caster)
    candidates = offered = find(scene=scene)
    if options.places is not None and any(map(can_move, rig.lights)):
        offered = find(places=None, scene=scene)
    for text in (*scene.warnings, *coarse_warnings(scene.lights, scene.reflectance.sigma)):
        say(text)
    defects = next(
        (objective for objective in objectives if isinstance(objective, DetectabilityObjective)), None
    )
    inspection = defects and DetectionModel(
        hypotheses=defects.hypotheses,
        contrast=Contrast(
            sensor=scene.sensor, full_scale=scene.reflectance.full_scale, threshold=options.contrast
        ),
    )
    makers = PostureMatrices(rig, part, scene, candidates, options, Path(folder), caster, inspection, table)
    beside = candidates_of_others(makers, rig, offered, len(objectives), say)
    if tell is not None and (beside is not None or options.places is None):
        tell(combinations_text(beside or candidates))
    results, looked = search_objectives(
        makers, objectives if beside is None else objectives[:1], thresholds, report, searching, say
    )
    if beside is not None:
        results = search_other_objectives(
            makers, beside, results, objectives, thresholds, report, searching, say
        )
        candidates = beside
    if page is not None:
        makers.patches()
    if makers.coarse_warning is not None:
        say(makers.coarse_warning)
    appendix = Appendix()
    if appraise is not None:
        appendix = appraise(
            Outcome(
                scene=scene,
                caster=caster,
                candidates=candidates,
                thresholds=thresholds,
                results=results,
                table=makers.patches,
            )
        )
        results = appendix.results or results
    blind = None
    if defects is not None:
        patches = makers.patches().patches
        blind = BlindReport.of(appendix.looked or looked, patches.areas, defects, candidates.names)
        appendix = replace(
            appendix,
            sections={"blind_spots": blind.as_dict(), **appendix.sections},
            files={
                **blind_files(blind, patches, scene.placement),
                **blind_pictures(blind, patches, scene, caster, legend),
                **appendix.files,
            },
        )

    def draw(document: Mapping[str, Any], overlaps: Sequence[Overlap]) -> str:
        assert page is not None
        return page(
            Draft(
                document=document,
                folder=Path(folder),
                rig=rig,
                part=part,
                scene=scene,
                caster=caster,
                table=makers.patches(),
                candidates=candidates,
                offered=offered,
                thresholds=thresholds,
                results=results,
                overlaps=overlaps,
                warnings=tuple(warnings),
                blind=blind,
            )
        )

    written = write_outputs(
        Path(folder),
        rig,
        part,
        results,
        candidates,
        thresholds,
        offered=offered,
        provenance=provenance,
        options=options,
        appendix=appendix,
        force=force,
        warn=say,
        page=None if page is None else draw,
    )
    return Optimum(
        candidates=candidates,
        offered=offered,
        thresholds=thresholds,
        results=results,
        blind=blind,
        written=written,
        reused=makers.reused,
        patches=makers.message,
        warnings=tuple(warnings),
    )


def _objectives(
    rig: RigConfig, part: PartConfig, options: OptimizeOptions, say: Callable[[str], None]
) -> tuple[Objective, ...]:
    # one that was asked for must be possible; one that was not is left out
    chosen = objectives_named(
        options.objectives,
        # places that were chosen before were chosen for the images of all postures together
        lambda: DetectabilityObjective(
            defect_hypotheses(build_catalogue(part)),
            options.seen_in,
            across_postures=options.places is not None,
        ),
    )
    refusals = {objective.name: objective.refusal(len(rig.lights)) for objective in chosen}
    problems = [text for text in refusals.values() if text is not None]
    possible = tuple(objective for objective in chosen if refusals[objective.name] is None)
    if problems and (options.objectives or not possible):
        raise InputError(*problems)
    for text in problems:
        say(text)
    return possible
