"""From image sets to the images to take: the pipeline, and its files."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from lightopt import images as files
from lightopt.config import RANGE_KEYS, RigConfig, copied_text, load_rig, with_list
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, counted, percent, refuse
from lightopt.core.provenance import provenance
from lightopt.core.run_context import RunContext
from lightopt.defects import DEFAULT_FALSE_ALARMS, false_alarms_problem
from lightopt.design.from_images import _samples
from lightopt.design.from_images._choice import DEFAULT_LIMIT, Choice, choose_lights, score
from lightopt.design.from_images._evidence import Evidence, measure_evidence
from lightopt.design.from_images._mixture import MixedImages, Mixture, mix_lights

RESULT_NAME, PROGRAMME_NAME, RIG_NAME = "result.json", "programme.yaml", "rig.optimized.yaml"
REPORT_NAME, IMAGES_FOLDER = "report.html", "images"

_FORMAT = "lightopt-from-images/1"
_SHOWN = 4  # lights of an image in a table
_COMMENT = "Chosen by lightopt optimize --from-images"


@dataclass(frozen=True, kw_only=True)
class FromImagesOptions:
    images: int = 4  # how many images of a part are to be taken
    mix: bool = False  # whether an image may show several lights with weights; one light each otherwise
    false_alarms: float = DEFAULT_FALSE_ALARMS
    limit: int = DEFAULT_LIMIT  # about how many choices to score before the search stops with a bound


@dataclass(frozen=True, kw_only=True)
class FromImagesResult:
    samples: _samples.Samples
    evidence: Evidence
    options: FromImagesOptions
    choice: Choice  # of single lights
    mixture: Mixture  # of several lights per image
    images: tuple[_samples.ChosenImage, ...]  # those to take: of the choice, or of the mixture with `mix`
    gains: Float64  # evidence of each defect in them in units of its threshold, shape (J,)
    found_alone: tuple[int, ...]  # by each of them, defects that it shows without the others
    rig: RigConfig | None  # that takes the images as its programme
    captured: files.ImageSet | None  # taken with a previous result of the same sets
    # with its images: the set of the same sample, and each
    agreement: tuple[str, tuple[_samples.Agreement, ...]] | None
    warnings: tuple[str, ...]

    @property
    def score(self) -> float:
        return score(self.gains) if self.options.mix else self.choice.score

    @property
    def bound(self) -> float:
        """A score that no other choice of as many images of the kind exceeds."""
        return self.mixture.bound if self.options.mix else self.choice.bound

    @property
    def proven(self) -> bool:
        return self.mixture.bound <= self.score if self.options.mix else self.choice.proven

    def lights_text(self, image: _samples.ChosenImage) -> str:
        """The lights of an image with their weights, the brightest few."""
        lit = sorted(image.weights.items(), key=lambda one: -one[1])
        shown = [light if len(lit) == 1 else f"{light} {weight:.3g}" for light, weight in lit[:_SHOWN]]
        more = len(lit) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")


def optimize_from_images(
    sets: Sequence[Path],
    *,
    options: FromImagesOptions = FromImagesOptions(),
    region: Path | None = None,
    rig: Path | None = None,
    captured: Path | None = None,
    run: RunContext | None = None,
) -> FromImagesResult:
    """Choose the images that show the defects of samples best, from images of one light at a time.

    sets: Image sets of good and defective samples under the same lights, all at the same place of the image.
    region: PNG that is not 0 where the part is to be inspected.
    rig: Rig file whose lights are those of the sets, without a programme; weights are whole levels of its controllers.
    captured: Image set taken with a previous result of the same sets, which is compared with synthesised images.
    Raises InputError: What is wrong with the options, the sets or their masks.
    """
    run = run or RunContext()
    refuse(filter(None, [false_alarms_problem(options.false_alarms)]))
    samples = _samples.read_samples(sets, region, run)
    loaded = None if rig is None else _rig_of(samples, rig, mix=options.mix)
    if not 1 <= options.images <= len(samples.channels):
        lights = f"1 to {len(samples.channels)}, the number of lights in the sets"
        raise InputError(f"option 'images': expected a number from {lights}, found {options.images}")
    evidence = measure_evidence(samples, false_alarms=options.false_alarms, run=run)
    report = run.stage("choosing lights")
    choice = choose_lights(evidence, options.images, limit=options.limit, threads=run.threads)
    report(0.5)
    mixed = MixedImages(evidence)
    mixture = mix_lights(mixed, choice.lights, quick=not options.mix)
    report(1.0)
    weights = mixture.weights if options.mix else np.eye(evidence.lights)[list(choice.lights)]
    tops = [mixed.top(row)[0] if options.mix else float(row @ evidence.brightest) for row in weights]
    hardware = None if loaded is None else loaded.hardware
    levels = {} if hardware is None else {name: light.level for name, light in hardware.lights.items()}
    chosen = _samples.chosen_images(samples, tops, weights, evidence.room, levels)
    if options.mix:
        weights = _samples.weights_of(samples, chosen)
        gains, alone = mixed.gains(weights), [mixed.gains(row[None]) for row in weights]
    else:
        gains, alone = evidence.gains(choice.lights), [evidence.gains([i]) for i in choice.lights]
    if not (gains >= 1.0).any():
        run.warn("no choice of lights shows any of the defects: these come nearest, and show no more than noise may")
    taken = None if captured is None else files.read_image_set(captured)
    agreement = None if taken is None else _samples.compare_captured(samples, chosen, taken, evidence.sensor)
    return FromImagesResult(
        samples=samples,
        evidence=evidence,
        options=options,
        choice=choice,
        mixture=mixture,
        images=chosen,
        gains=gains,
        found_alone=tuple(int((one >= 1.0).sum()) for one in alone),
        rig=loaded,
        captured=taken,
        agreement=agreement,
        warnings=run.warnings,
    )


def write_from_images(
    result: FromImagesResult, folder: Path, *, force: bool = False, run: RunContext | None = None
) -> files.ResultFolder:
    """Write the programme, the synthesised images of all sets and, with a rig, its file with the programme.

    The result is complete when :func:`finish_from_images` has written its JSON file.

    Raises InputError: The folder has other results, or the rig cannot take the programme.
    """
    run = run or RunContext()
    output = files.ResultFolder(
        folder, _provenance(result), name=RESULT_NAME, format=_FORMAT, what="a choice of lights", force=force
    )
    programme = (
        {"name": image.name, "lights": image.weights, "exposures": [image.exposure]} for image in result.images
    )
    entries = [json.dumps(entry, ensure_ascii=False) for entry in programme]
    if result.rig is not None:
        # lights of a programme do not move
        moving = {
            ("lights", number, key): None
            for number, light in enumerate(result.rig.lights)
            for key in RANGE_KEYS
            if getattr(light, key) is not None
        }
        text = with_list(copied_text(result.rig, folder, moving), "programme", entries, comment=_COMMENT)
        path = output.write_text(RIG_NAME, text)
        try:
            load_rig(path)
        except InputError:
            path.unlink()
            raise
    output.write_text(PROGRAMME_NAME, "\n".join([f"# {_COMMENT}", "programme:", *(f"  - {e}" for e in entries), ""]))
    for previous in (output.folder / IMAGES_FOLDER).glob("*"):
        files.remove_image_set(previous)
        with suppress(OSError):  # something else is in it
            previous.rmdir()
    report = run.stage("synthesising images")
    for number, name in enumerate(result.samples.names):
        _write_images(result, number, output.folder / IMAGES_FOLDER / name)
        report((number + 1) / len(result.samples.names))
    return output


def finish_from_images(output: files.ResultFolder, result: FromImagesResult, page: str | None) -> list[Path]:
    """Write the report and result.json; returns what a person wants to open."""
    paths = [] if page is None else [output.write_text(REPORT_NAME, page)]
    output.finish(_document(result))
    rig = output.folder / RIG_NAME
    return [*paths, rig if rig.is_file() else output.folder / PROGRAMME_NAME, output.folder / IMAGES_FOLDER]


def _rig_of(samples: _samples.Samples, path: Path, *, mix: bool) -> RigConfig:
    rig = load_rig(path)
    if rig.programme is not None:
        raise InputError(f"{path}: has a programme; give the rig file without it, whose lights the sets show")
    names = [light.name for light in rig.lights]
    missing = [channel.light for channel in samples.channels if channel.light not in names]
    if missing:
        raise InputError(f"{path}: no light {', '.join(missing[:5])}, which the sets show; it has {', '.join(names)}")
    panels = [light.name for light in rig.lights if light.kind == "panel"] if mix and len(rig.lights) > 1 else []
    if panels:
        shown = f"option 'mix' shows several lights in an image, and {', '.join(panels[:5])} are panels"
        raise InputError(f"{path}: {shown}, which images show alone; write kind: bar in this file, or omit the option")
    return rig


def _write_images(result: FromImagesResult, number: int, folder: Path) -> None:
    # the chosen images of a set, as an image set with the masks of its defects
    samples = result.samples
    own = samples.sets[number]
    facts = {image.name: {"lights": image.weights, "exposure": image.exposure} for image in result.images}
    kept = ("bit_depth", "full_scale", "saturation_level", "black_level", "part")
    header = {name: getattr(own.manifest, name) for name in kept}
    # without a version: an inspection knows nothing of whether the sample is good
    made_from = {"synthesised_from": own.fingerprint, "images": facts}
    writer = files.ImageSetWriter(folder, files.Manifest(kind="simulated", **header, provenance=made_from))
    for p, posture in enumerate(samples.postures):
        for image in result.images:
            levels, _ = _samples.synthesise(samples, number, image, posture)
            main = max(image.weights, key=lambda light: image.weights[light])
            source = next(e for e in own.images if (e.light, e.posture) == (main, posture))
            angles = source.light_elevation_deg, source.light_azimuth_deg
            entry = files.ImageEntry(image.name, *angles, posture, image.exposure)
            writer.add_image(entry, png=_samples.quantised(samples, levels))
        if (labels := samples.labels[number, p]).max() >= 0:
            mask = np.where(labels >= 0, 255, 0).astype(np.uint8)
            writer.add_levels(
                f"masks/{files.posture_folder(posture)}.png", mask, metadata={"posture": posture.as_dict()}
            )


def _provenance(result: FromImagesResult) -> dict[str, Any]:
    samples = result.samples
    inputs: dict[str, Any] = {
        name: {**own.fingerprint, "labels_sha256": sha256(labels.tobytes()).hexdigest()}
        for name, own, labels in zip(samples.names, samples.sets, samples.labels, strict=True)
    }
    inputs["region_sha256"] = sha256(np.stack(samples.regions).tobytes()).hexdigest()
    if result.captured is not None:
        inputs["compared"] = result.captured.fingerprint
    if result.rig is not None:
        inputs["rig"] = {"file": result.rig.source.path.name, "sha256": result.rig.source.sha256}
    return provenance(inputs, vars(result.options))


def _document(result: FromImagesResult) -> dict[str, Any]:
    evidence, samples, gains = result.evidence, result.samples, result.gains
    return {
        "images": [
            {"name": image.name, "lights": image.weights, "exposure": image.exposure} for image in result.images
        ],
        "score": result.score,
        "bound": result.bound,
        "proven": result.proven,
        "found": int((gains >= 1.0).sum()),
        "defects": [
            {"set": where, "name": name, "evidence_over_threshold": float(f"{gain:.6g}"), "found": bool(gain >= 1.0)}
            for (where, name), gain in zip(evidence.defects, gains, strict=True)
        ],
        "single_lights": {
            "lights": [samples.channels[i].light for i in result.choice.lights],
            **{key: getattr(result.choice, key) for key in ("score", "bound", "proven", "scored", "total")},
        },
        "several_lights_per_image": {key: getattr(result.mixture, key) for key in ("score", "single_score", "bound")},
        "lights": [
            {
                "light": channel.light,
                "exposure": channel.exposure,
                "score_alone": score(evidence.gains([i])),
                "brightest_level": float(f"{evidence.brightest[i]:.6g}"),
                "noise_levels": float(f"{evidence.noise[i]:.6g}"),
            }
            for i, channel in enumerate(samples.channels)
        ],
        "statistic": {
            "false_alarms": result.options.false_alarms,
            "z": evidence.z,
            "shrinkage": evidence.shrinkage,
            "good_samples": evidence.good,
            "surface_contrast": evidence.surface_contrast,
        },
        "compared": None
        if result.agreement is None
        else {
            "set": result.agreement[0],
            "images": [{**vars(one), "posture": one.posture.as_dict()} for one in result.agreement[1]],
        },
        "warnings": list(result.warnings),
    }


def from_images_answer(result: FromImagesResult) -> tuple[str, str]:
    gains = result.gains
    found = int((gains >= 1.0).sum())
    kind = counted(len(result.images), "image")
    more = result.bound / max(result.score, 1e-12) - 1.0
    proof = (
        "no other choice scores more (proven)"
        if result.proven
        else f"no other choice exceeds its score by more than {percent(math.ceil(1000.0 * more) / 1000.0)}"
    )
    if result.evidence.surface_contrast is not None:
        return f"{percent(result.score)}", f"score of {kind} on the good surface; {proof}"
    return f"{found} of {counted(len(gains), 'defect')}", f"found in {kind}; {proof}"
