"""Design each lighting system for the part, and sum up what its images show and what they cost."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.comparison._report import comparison_report
from lightopt.comparison._results import (
    LightingComparison,
    Picture,
    SystemResult,
    UnusableSystem,
    comparison_csv,
    comparison_document,
)
from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import CheckFailed, InputError, counted
from lightopt.core.provenance import differences, provenance
from lightopt.core.run_context import RunContext
from lightopt.design import (
    DEFAULT_TOLERANCE_TARGET,
    BlindReason,
    DesignOutput,
    DesignResult,
    JointTolerances,
    OptimizeOptions,
    PlanOptions,
    blind_text,
    deciding_text,
    design_tolerances,
    finish_design,
    optimize,
    place_of,
    place_text,
    write_design,
)
from lightopt.images import make_folder, write_text_atomic
from lightopt.lights import outlines
from lightopt.rendering import cast_rays_at, render_lights
from lightopt.report.design import blind_pictures, design_report
from lightopt.rig.capture import cycle_time
from lightopt.scene import build_lights, pixel_footprint

PICTURES = 4  # images of each system that the report shows
REPORT, TABLE, DOCUMENT = "report.html", "comparison.csv", "comparison.json"
SAME_FOOTPRINT = 0.05  # footprints that differ by more are not the same


def compare_lighting(
    rigs: Sequence[Path | str],
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: OptimizeOptions,
    plan: PlanOptions | None = None,
    tolerances: bool = True,
    force: bool = False,
    run: RunContext | None = None,
) -> LightingComparison:
    """Compare lighting systems on a part: the same catalogue of defects, the same false-alarm rate.

    Each system's design goes to a folder of the name of its file. A system that cannot be used, such as one in the
    camera's view, is reported and does not end the comparison.

    options, plan: Of each design; the objective is detectability
    tolerances: Whether the mounting tolerance and the pose tolerance of each system are computed
    Raises InputError: Whatever is wrong with the part, the rig files or the options, or no system that can be used.
    """
    folder, run, plan = Path(folder), run or RunContext(), plan or PlanOptions()
    part = part if isinstance(part, PartConfig) else load_part(part)
    options = replace(options, objectives=("detectability",), images=False)
    loaded = _loaded([Path(rig) for rig in rigs])
    facts = _provenance(loaded, part, options, plan, DEFAULT_TOLERANCE_TARGET if tolerances else None)
    if not force:
        _refuse_other_comparison(folder / DOCUMENT, facts)
    found: list[SystemResult] = []
    unusable: list[UnusableSystem] = []
    warnings: dict[str, None] = {}
    for name, rig in loaded.items():
        own = run.apart(name)
        fewer = min(options.min_images, len(rig.lights))
        if fewer < options.min_images:
            warnings[f"{name}: it has {counted(fewer, 'light')}, so that {deciding_text(fewer)}"] = None
        try:
            request = replace(options, min_images=fewer)
            result = optimize(rig, part, folder / name, options=request, plan=plan, force=force, run=own)
            output = write_design(result, blind_pictures(result), force=force, run=own)
            finish_design(output, design_report(output) if options.report else None)
        except CheckFailed as error:
            unusable.append(UnusableSystem(name=name, messages=error.messages))
            continue
        except InputError as error:
            if len(loaded) == 1 or any(str(part.source.path) in text for text in error.messages):
                raise
            unusable.append(UnusableSystem(name=name, messages=error.messages))
            continue
        warnings |= dict.fromkeys(f"{name}: {text}" for text in output.warnings if "no light can be moved" not in text)
        allowed = design_tolerances(result, run=own) if tolerances else None
        if allowed is not None and allowed.lights is None:
            warnings[f"{name}: it has too many lights for its mounting tolerance; channels of a light are one"] = None
        found.append(_system(name, output, allowed, run.threads))
    if not found:
        raise InputError(*(f"{one.name}: {text}" for one in unusable for text in one.messages))
    footprints = [one.footprint_mm for one in found]
    if max(footprints) > (1.0 + SAME_FOOTPRINT) * min(footprints):
        sizes = ", ".join(f"{one.name} {one.footprint_mm:.3g} mm" for one in found)
        warnings[f"the cameras differ: a pixel's side at the origin is {sizes}; shares depend on it"] = None
    run.warn(*warnings)
    found.sort(key=lambda one: (-one.share, one.cost, one.name))
    comparison = LightingComparison(
        part=part,
        options=options,
        provenance=facts,
        systems=tuple(found),
        unusable=tuple(unusable),
        warnings=tuple(warnings),
        paths=tuple(folder / name for name in (REPORT, TABLE, DOCUMENT)),
    )
    _write(comparison, folder, force=force)
    return comparison


def _provenance(
    rigs: Mapping[str, RigConfig], part: PartConfig, options: OptimizeOptions, plan: PlanOptions, target: float | None
) -> dict[str, Any]:
    inputs = {"part": {"file": part.source.path.name, "sha256": part.source.sha256}}
    inputs |= {name: {"file": rig.source.path.name, "sha256": rig.source.sha256} for name, rig in rigs.items()}
    names = ("step_deg", "points", "min_images", "false_alarms", "patch_budget", "report")
    postures = None if options.postures is None else [posture.as_dict() for posture in options.postures]
    facts = {name: getattr(options, name) for name in names} | {"postures": postures, "tolerance_target": target}
    return provenance(inputs, facts | plan.facts())


def _refuse_other_comparison(path: Path, facts: Mapping[str, Any]) -> None:
    if not path.exists():
        return
    try:
        other = json.loads(path.read_text(encoding="utf-8"))["provenance"]
    except (ValueError, KeyError, TypeError):
        other = {}
    if changes := differences(other, facts):
        advice = "use option 'force' to replace it, or choose another output folder"
        raise InputError(f"{path}: the result of another comparison ({changes}); {advice}")


def _loaded(paths: Sequence[Path]) -> dict[str, RigConfig]:
    problems: list[str] = []
    loaded: dict[str, RigConfig] = {}
    for path in paths:
        try:
            rig = load_rig(path)
        except InputError as error:
            problems += error.messages
            continue
        if path.stem in loaded:
            problems.append(f"{path}: another rig file is named {path.name}, too; give each a name of its own")
        loaded[path.stem] = rig
    if len(paths) < 2:
        problems.append(f"expected two lighting systems or more to compare, found {len(paths)}")
    if problems:
        raise InputError(*problems)
    return loaded


def _system(name: str, output: DesignOutput, tolerances: JointTolerances | None, threads: int | None) -> SystemResult:
    result = output.result
    share, grain, defects = _found(output)
    answered = [one for one in result.results if one.answers[0].nothing is None]
    exposures = {posture: result.plan.exposures_of(posture) for one in answered for posture in one.postures}
    images = len(result.candidates.names) * sum(map(len, exposures.values()))
    try:
        seconds = cycle_time(result.rig, result.part, exposures).seconds
    except InputError:
        seconds = None
    corners = np.concatenate([outlines(light).reshape(-1, 3) for light in build_lights(result.rig)])
    size = np.ptp(corners, axis=0)
    return SystemResult(
        name=name,
        rig=result.rig,
        folder=result.folder,
        share=share,
        grain=grain,
        defects=defects,
        reasons=_reasons(result),
        moved=_moved(result),
        mounting=None if tolerances is None else tolerances.lights,
        pose=None if tolerances is None else tolerances.part,
        images=images,
        seconds=seconds,
        size_mm=(float(size[0]), float(size[1]), float(size[2])),
        footprint_mm=pixel_footprint(result.scene.camera, result.rig.camera.distance_mm),
        pictures=_pictures(result, threads),
    )


def _found(output: DesignOutput) -> tuple[float, float, Mapping[str, float]]:
    # share of the surface × defects, how far it may be off, and share of each kind
    result, document = output.result, output.document
    one = result.results[0]
    answer = one.answers[0]
    kinds: Mapping[str, float] = answer.details.get("defects", {})
    if answer.nothing is not None:
        return 0.0, one.grain, {}
    if (planned := document.get("exposures")) is not None:
        return planned["share"], planned["grain"], planned.get("defects", kinds)
    if (chosen := document.get("chosen_postures")) is not None:
        return chosen["share"], chosen["patches"]["grain"], kinds
    share = answer.objective.share_of_whole(answer.found.best.score, one.area)
    return share or 0.0, one.grain, kinds


def _reasons(result: DesignResult) -> dict[str, float]:
    if result.blind is None:
        return {}
    # the evidence of postures adds up in a plan; without one, each decides by itself
    together = result.plan.chosen is not None or result.plan.brackets is not None
    parts = result.blind.parts[:1] if together else result.blind.parts[1:]
    seen, shares = 0.0, dict[str, float]()
    for _, chosen, _ in parts:
        lost = chosen.by_reason()
        seen += chosen.counted * (1.0 - lost.pop(BlindReason.CAMERA, 0.0))  # no light changes what the camera sees
        for code, share in lost.items():
            reason = "saturated" if code >= BlindReason.SATURATED else blind_text(code, result.blind.lights)
            shares[reason] = shares.get(reason, 0.0) + share * chosen.counted
    shares = {reason: share / max(seen, 1e-9) for reason, share in shares.items()}
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _moved(result: DesignResult) -> tuple[str, ...]:
    # texts of the lights whose best place is another one
    answer = result.results[0].answers[0]
    if answer.nothing is not None:
        return ()
    standing = zip(result.rig.lights, result.candidates.places, answer.found.best.candidates, strict=True)
    found: dict[str, None] = {}
    for light, places, k in standing:
        if places[k] != place_of(light):
            found[f"{light.entry_name} to {place_text(places[k])}"] = None
    return tuple(found)


def _pictures(result: DesignResult, threads: int | None) -> tuple[Picture, ...]:
    best = result.results[0].answers[0]
    lights = (
        result.scene.lights if best.nothing is not None else result.candidates.panels_at(best.found.best.candidates)
    )
    # the first channels of each light, in turns
    order = sorted(range(len(lights)), key=lambda i: (result.rig.lights[i].channel, i))[:PICTURES]
    scene = replace(result.scene, lights=tuple(lights[i] for i in sorted(order)))
    sensor, full_scale = scene.sensor, scene.reflectance.full_scale
    images = render_lights(scene, scene.postures[0], caster=cast_rays_at(scene), threads=threads)
    return tuple(
        Picture(
            light=image.light,
            level=(image.level / full_scale).astype(np.float32),
            saturated=image.level * (sensor.max_level / full_scale) >= sensor.saturated_from - sensor.black_level,
        )
        for image in images
    )


def _write(comparison: LightingComparison, folder: Path, *, force: bool) -> None:
    make_folder(folder)
    document = comparison_document(comparison)
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(folder / TABLE, comparison_csv(comparison), overwrite=force)
    write_text_atomic(folder / REPORT, comparison_report(comparison, folder), overwrite=force)
    write_text_atomic(folder / DOCUMENT, text, overwrite=force)
