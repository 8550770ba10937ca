"""Design each lighting system for the part, and sum up what its images show and what they cost."""

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final

import numpy as np

from lightopt import design
from lightopt.comparison import _results
from lightopt.config import LightConfig, PartConfig, RigConfig, copied_text, load_part, load_rig, with_values
from lightopt.core.errors import CheckFailed, InputError, collected, counted, refuse
from lightopt.core.provenance import provenance
from lightopt.core.run_context import RunContext
from lightopt.images import ResultFolder, make_folder, write_text_atomic
from lightopt.lights import outlines
from lightopt.rendering import cast_rays_at, render_lights
from lightopt.report import Picture, camera_picture
from lightopt.report.design import blind_pictures, design_report
from lightopt.rig.capture import cycle_time
from lightopt.scene import build_camera, build_lights, pixel_footprint

PRESETS: Final[Mapping[str, str]] = {
    "four-panel": "four-panel",
    "bars": "bars",
    "ring-quadrants": "ring-quadrants",
    "low-ring": "low-angle-ring",
    "dome-quadrants": "dome-quadrants",
    "flat-dome": "flat-dome",
    "tunnel": "tunnel",
    "coaxial": "coaxial",
    "spot": "spot",
    "led-array": "led-array",
    "display": "display-stripes",
    "binary-stripes": "binary-stripes",
    "grid-backlight": "moving-grid",
    "dome-sines": "dome-stripes",
}
"""Name of each preset, and of the sample rig that it is."""


_OWN_CAMERA = "dome-quadrants"  # whose pixels and sensor the presets have where no rig is given

MOST_SIZES = 32  # combinations of the sizes of a rig's lights
SIZES = "sizes"  # folder of the rig files with other sizes

PICTURES = 4  # images of each system that the report shows
SIDE = 300  # longest side of an image in the report [px]
REPORT, TABLE, DOCUMENT = "report.html", "comparison.csv", "comparison.json"
SAME_FOOTPRINT = 0.05  # footprints that differ by more are not the same


def check_presets(names: Sequence[str]) -> None:
    """Refuse names that no preset has."""
    unknown = [name for name in names if name not in PRESETS]
    refuse(f'no preset "{name}"; presets are {", ".join(PRESETS)}' for name in unknown)


def preset_files(
    names: Sequence[str], folder: Path, *, camera_of: RigConfig | None = None, force: bool = False
) -> list[Path]:
    """Copy the rig files of presets to a folder, where they can be changed, and return them.

    Their cameras stand where the lights let them look through; they get the pixels, on the part, and the sensor of
    another rig, so that the systems can be compared.

    camera_of: The other rig; None for pixels and sensor of the preset dome-quadrants
    Raises InputError: A name that no preset has, or another file in its place without `force`.
    """
    check_presets(names)
    make_folder(folder)
    samples, found = files("lightopt.samples").joinpath("rigs"), list[Path]()
    with as_file(samples.joinpath(f"{PRESETS[_OWN_CAMERA]}.yaml")) as path:
        camera_of = camera_of or load_rig(path)
    for name in names:
        with as_file(samples.joinpath(f"{PRESETS[name]}.yaml")) as path:
            text = with_values(path.read_text(encoding="utf-8"), _same_pixels(load_rig(path), camera_of))
        text = "".join(line for line in text.splitlines(keepends=True) if "yaml-language-server" not in line)
        path = folder / f"{name}.yaml"
        if path.exists() and path.read_text(encoding="utf-8") != text and not force:
            raise InputError(
                f"{path}: differs from the preset; give it as a rig file without the preset, or use option 'force'"
            )
        write_text_atomic(path, text)
        found.append(path)
    return found


def _same_pixels(rig: RigConfig, other: RigConfig) -> dict[tuple[str | int, ...], str | None]:
    # values of a rig file: pixels as large on the table as those of another rig, and the same sensor
    camera = build_camera(rig)
    footprint = pixel_footprint(build_camera(other), other.camera.distance_mm)
    pixel_um = 1000.0 * footprint * camera.image_distance / rig.camera.distance_mm
    width, height = other.camera.resolution_px
    sensor = other.camera.sensor.model_dump(exclude={"data_sheet"})
    return {
        ("camera", "resolution_px", 0): str(width),
        ("camera", "resolution_px", 1): str(height),
        ("camera", "pixel_size_um"): f"{pixel_um:.9g}",
        **{("camera", "sensor", key): None if value is None else f"{value:.9g}" for key, value in sensor.items()},
    }


def compare_lighting(
    rigs: Sequence[Path | str],
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: design.OptimizeOptions,
    plan: design.PlanOptions | None = None,
    tolerances: bool = True,
    force: bool = False,
    run: RunContext | None = None,
) -> _results.LightingComparison:
    """Compare lighting systems on a part: the same catalogue of defects, the same false-alarm rate.

    Each system's design goes to a folder of the name of its file, those with other sizes of its lights to
    `NAME-size-2` and so on, the best of which counts. A system that cannot be used, such as one in the camera's view,
    is reported and does not end the comparison.

    options, plan: Of each design; the objective is detectability
    tolerances: Whether the mounting tolerance and the pose tolerance of each system are computed
    Raises InputError: Whatever is wrong with the part, the rig files or the options, or no system that can be used.
    """
    folder, run, plan = Path(folder), run or RunContext(), plan or design.PlanOptions()
    part = part if isinstance(part, PartConfig) else load_part(part)
    options = replace(options, objectives=("detectability",), images=False)
    loaded = _loaded([Path(rig) for rig in rigs])
    facts = _provenance(loaded, part, options, plan, design.DEFAULT_TOLERANCE_TARGET if tolerances else None)
    kind = {"name": DOCUMENT, "format": _results.FORMAT, "what": "a comparison"}
    results = ResultFolder(folder, facts, **kind, also=(TABLE, REPORT), force=force)
    found: list[_results.SystemResult] = []
    unusable: dict[str, tuple[str, ...]] = {}
    warnings: dict[str, None] = {}
    for name, rig in loaded.items():
        fewer = min(options.min_images, len(rig.lights))
        if fewer < options.min_images:
            warnings[f"{name}: it has {counted(fewer, 'light')}, so that {design.deciding_text(fewer)}"] = None
        request = replace(options, min_images=fewer)
        best: tuple[_results.SizeResult, design.DesignOutput] | None = None
        tried: list[_results.SizeResult] = []
        for number, (size, sized) in enumerate(_sized_rigs(rig, folder / SIZES, force=force), start=1):
            which, what = (name, name) if number == 1 else (f"{name}-size-{number}", f"{name}, {size}")
            try:
                output = _design(sized, part, folder / which, request, plan, force=force, run=run.apart(which))
            except (CheckFailed, InputError) as error:
                if any(str(part.source.path) in text for text in error.messages) and isinstance(error, InputError):
                    raise
                unusable[what] = error.messages
                continue
            warnings |= dict.fromkeys(
                f"{what}: {text}" for text in output.warnings if "no light can be moved" not in text
            )
            tried.append(_results.SizeResult(size=size, folder=folder / which, share=_found(output)[0]))
            if best is None or tried[-1].share > best[0].share:
                best = tried[-1], output
        if best is None:
            continue
        allowed = design.design_tolerances(best[1].result, run=run.apart(name)) if tolerances else None
        if allowed is not None and allowed.lights is None:
            warnings[f"{name}: it has too many lights for its mounting tolerance; channels of a light are one"] = None
        sizes = {"chosen_size": best[0].size, "sizes": tuple(tried)} if _lights_of_sizes(rig) else {}
        found.append(replace(_system(name, best[1], allowed, run.threads), **sizes))
    if not found:
        raise InputError(*(f"{name}: {text}" for name, messages in unusable.items() for text in messages))
    footprints = [one.footprint_mm for one in found]
    if max(footprints) > (1.0 + SAME_FOOTPRINT) * min(footprints):
        sizes = ", ".join(f"{one.name} {one.footprint_mm:.3g} mm" for one in found)
        warnings[f"the cameras differ: a pixel's side at the origin is {sizes}; shares depend on it"] = None
    run.warn(*warnings)
    found.sort(key=lambda one: (-one.share, one.cost, one.name))
    comparison = _results.LightingComparison(
        part=part,
        options=options,
        provenance=facts,
        systems=tuple(found),
        unusable=unusable,
        warnings=tuple(warnings),
        paths=tuple(folder / name for name in (REPORT, TABLE, DOCUMENT)),
    )
    results.write_text(TABLE, _results.comparison_csv(comparison))
    results.write_text(REPORT, _results.comparison_report(comparison, folder))
    results.write_text(
        DOCUMENT, json.dumps(_results.comparison_document(comparison), indent=1, ensure_ascii=False) + "\n"
    )
    return comparison


def _design(
    rig: RigConfig,
    part: PartConfig,
    folder: Path,
    options: design.OptimizeOptions,
    plan: design.PlanOptions,
    *,
    force: bool,
    run: RunContext,
) -> design.DesignOutput:
    result = design.optimize(rig, part, folder, options=options, plan=plan, force=force, run=run)
    output = design.write_design(result, blind_pictures(result), force=force, run=run)
    design.finish_design(output, design_report(output) if options.report else None)
    return output


def _lights_of_sizes(rig: RigConfig) -> dict[int, LightConfig]:
    # lights that have other sizes, by the number of their first channel
    return {number: light for number, light in enumerate(rig.channels) if light.channel == 0 and light.sizes}


def _sized_rigs(rig: RigConfig, folder: Path, *, force: bool) -> Iterator[tuple[str, RigConfig]]:
    # a rig as it is, and with every combination of other sizes of its lights, whose files are written
    yield _results.AS_IN_FILE, rig
    channels = _lights_of_sizes(rig)
    choices = [[None, *(light.sizes or ())] for light in channels.values()]
    for number, chosen in enumerate(list(itertools.product(*choices))[1:], start=2):
        make_folder(folder)
        values: dict[tuple[str | int, ...], str | None] = {("lights", at, "sizes"): None for at in channels}
        texts: list[str] = []
        for at, size in zip(channels, chosen, strict=True):
            if size is not None:
                values |= {("lights", at, key): json.dumps(value) for key, value in size.values.items()}
                texts.append(f"{channels[at].entry_name} {size.text}")
        path = folder / f"{rig.source.path.stem}-size-{number}.yaml"
        text = copied_text(rig, folder, values)
        if path.exists() and path.read_text(encoding="utf-8") != text and not force:
            raise InputError(f"{path}: differs from this size of {rig.source.path}; use option 'force' to replace it")
        write_text_atomic(path, text)
        yield "; ".join(texts), load_rig(path)


def _provenance(
    rigs: Mapping[str, RigConfig],
    part: PartConfig,
    options: design.OptimizeOptions,
    plan: design.PlanOptions,
    target: float | None,
) -> dict[str, Any]:
    inputs = {"part": {"file": part.source.path.name, "sha256": part.source.sha256}}
    inputs |= {name: {"file": rig.source.path.name, "sha256": rig.source.sha256} for name, rig in rigs.items()}
    names = ("step_deg", "points", "min_images", "false_alarms", "patch_budget", "report")
    postures = None if options.postures is None else [posture.as_dict() for posture in options.postures]
    facts = {name: getattr(options, name) for name in names} | {"postures": postures, "tolerance_target": target}
    return provenance(inputs, facts | plan.facts())


def _loaded(paths: Sequence[Path]) -> dict[str, RigConfig]:
    problems: list[str] = []
    loaded: dict[str, RigConfig] = {}
    for path in paths:
        with collected(problems):
            if path.stem in loaded:
                problems.append(f"{path}: another rig file is named {path.name}, too; give each a name of its own")
            loaded[path.stem] = load_rig(path)
    for rig in loaded.values():
        combinations = math.prod(1 + len(light.sizes or ()) for light in _lights_of_sizes(rig).values())
        if combinations > MOST_SIZES:
            problems.append(
                f"{rig.source.path}: {combinations} combinations of the sizes of its lights; at most {MOST_SIZES} are "
                "compared: write some of them into rig files of their own"
            )
    if len(paths) < 2 and not any(map(_lights_of_sizes, loaded.values())):
        problems.append(f"expected two lighting systems or more to compare, found {len(paths)}")
    refuse(problems)
    return loaded


def _system(
    name: str, output: design.DesignOutput, tolerances: design.JointTolerances | None, threads: int | None
) -> _results.SystemResult:
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
    return _results.SystemResult(
        name=name,
        rig=result.rig,
        folder=result.folder,
        share=share,
        grain=grain,
        defects=defects,
        most=_most(output),
        reasons=_reasons(result),
        moved=_moved(result),
        mounting=None if tolerances is None else tolerances.lights,
        pose=None if tolerances is None else tolerances.part,
        images=images,
        seconds=seconds,
        size_mm=(float(size[0]), float(size[1]), float(size[2])),
        footprint_mm=pixel_footprint(result.scene.camera, result.rig.camera.distance_mm),
        pictures=_pictures(name, result, threads),
    )


def _found(output: design.DesignOutput) -> tuple[float, float, Mapping[str, float]]:
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


def _most(output: design.DesignOutput) -> float | None:
    # of the same images as the share: exposures that were planned afterwards are not part of the bound
    result = output.result
    one, answer = result.results[0], result.results[0].answers[0]
    if answer.between is None or (result.plan.brackets is not None and result.plan.chosen is None):
        return None
    return answer.objective.share_of_whole(answer.between.bound, one.area)


def _reasons(result: design.DesignResult) -> dict[str, float]:
    if result.blind is None:
        return {}
    # the evidence of postures adds up in a plan; without one, each decides by itself
    together = result.plan.chosen is not None or result.plan.brackets is not None
    parts = result.blind.parts[:1] if together else result.blind.parts[1:]
    seen, shares = 0.0, dict[str, float]()
    for _, chosen, _ in parts:
        lost = chosen.by_reason()
        # no light changes what the camera sees
        seen += chosen.counted * (1.0 - lost.pop(design.BlindReason.CAMERA, 0.0))
        for code, share in lost.items():
            saturated = code >= design.BlindReason.SATURATED
            reason = "saturated" if saturated else design.blind_text(code, result.blind.lights)
            shares[reason] = shares.get(reason, 0.0) + share * chosen.counted
    shares = {reason: share / max(seen, 1e-9) for reason, share in shares.items()}
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _moved(result: design.DesignResult) -> tuple[str, ...]:
    # texts of the lights whose best place is another one
    answer = result.results[0].answers[0]
    if answer.nothing is not None:
        return ()
    standing = zip(result.rig.lights, result.candidates.places, answer.found.best.candidates, strict=True)
    found: dict[str, None] = {}
    for light, places, k in standing:
        if places[k] != design.place_of(light):
            found[f"{light.entry_name} to {design.place_text(places[k])}"] = None
    return tuple(found)


def _pictures(name: str, result: design.DesignResult, threads: int | None) -> tuple[Picture, ...]:
    best, lights = result.results[0].answers[0], result.scene.lights
    if best.nothing is None:
        lights = result.candidates.panels_at(best.found.best.candidates)
    # the first channels of each light, in turns
    order = sorted(range(len(lights)), key=lambda i: (result.rig.lights[i].channel, i))[:PICTURES]
    scene = replace(result.scene, lights=tuple(lights[i] for i in sorted(order)))
    sensor, full_scale = scene.sensor, scene.reflectance.full_scale
    images = render_lights(scene, scene.postures[0], caster=cast_rays_at(scene), threads=threads)
    return tuple(
        camera_picture(
            (image.level / full_scale).astype(np.float32),
            image.level * (sensor.max_level / full_scale) >= sensor.saturated_from - sensor.black_level,
            limit=SIDE,
            alt=f"{name}, {image.light}",
            caption=image.light,
        )
        for image in images
    )
