"""A calibration with good parts: what was learned, the inspections for which it is valid, and its false-alarm rate.

Rates follow from order statistics, whatever the law of the scores. Of `n` good sets let the k-th largest of their
greatest scores be the threshold. A further good set exceeds it with a probability that is distributed as
Beta(k, n − k + 1) over all ways to draw the sets (Wilks 1941, doi:10.1214/aoms/1177731788): a distribution-free
tolerance limit.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import special

from lightopt.config import RANGE_KEYS, PartConfig, RigConfig, referenced_files
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.provenance import computed_by, differences, file_sha256
from lightopt.core.transforms import Posture
from lightopt.images import ResultFolder, posture_folder, read_exr, write_exr
from lightopt.inspection._options import InspectOptions
from lightopt.inspection.calibration._systematic import SystematicDeviations
from lightopt.inspection.detection._registry import DETECTORS
from lightopt.inspection.prediction._registered_set import ExposuresByLight, exposures_text

CALIBRATION_NAME: Final = "calibration.json"
FORMAT: Final = "lightopt-calibration/1"
LEAST: Final = 3.0  # no threshold is below this: of so many pixels, some have a chance of one in a thousand
CONFIDENCE: Final = 0.95  # probability with which a threshold holds its rate


@dataclass(frozen=True)
class CalibratedPosture:
    """What was learned from good parts of one posture."""

    posture: Posture
    exposures: ExposuresByLight
    peaks: tuple[float, ...]  # greatest score of each good set, judged by what the others have in common
    # what they have in common; None for a detector that does not use deviations. Where good parts are the reference,
    # its spread is that of deviations from its mean without texture.
    systematic: SystematicDeviations | None = field(repr=False)

    def threshold(self, rate: float) -> float:
        """Threshold of the score for a false-alarm rate.

        Raises InputError: there are too few good sets for the rate.
        """
        peak = tolerance_limit(self.peaks, rate)
        if peak is None:
            raise InputError(too_few_good_sets(len(self.peaks), rate, f"posture {self.posture}"))
        return float(np.nextafter(np.float32(max(peak, LEAST)), np.float32(np.inf)))


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What was learned from good parts."""

    rate: float  # false alarms that it was made for: share of the good sets of a posture
    sets: tuple[str, ...]  # names of the good sets' folders
    postures: tuple[CalibratedPosture, ...]
    fingerprint: Mapping[str, Any]
    # from :func:`lightopt.core.provenance.computed_by`: scores of other code are other scores
    computed_by: Mapping[str, Any] = field(default_factory=computed_by)
    # of its file: for the provenance of what is inspected with it; the hash is empty where there is no file
    name: str = CALIBRATION_NAME
    sha256: str = ""

    def require_match(self, rig: RigConfig, part: PartConfig, options: InspectOptions) -> None:
        """Refuse another rig, part, version or options, and a rate that needs more good sets.

        Raises InputError: names all that differs.
        """
        now = calibration_fingerprint(rig, part, options)
        parts = {
            "rig": f"{rig.source.path}: camera, sensor, lights or stage",
            "part": f"{part.source.path}: placement, reflectance, regions, surface, bounces, how the mesh is read or "
            "the catalogue of defects",
            "mesh_sha256": f"{part.source.resolve(part.mesh.file)}: the mesh",
        }
        problems = [
            f"{text} differ from those that {self.name} was made for; calibrate again"
            for key, text in parts.items()
            if now[key] != self.fingerprint.get(key)
        ]
        if changed := differences(self.computed_by, computed_by()):
            problems.append(
                f"{self.name} was made by another lightopt, whose scores may be others ({changed}); calibrate again"
            )
        before = self.fingerprint.get("options")
        before = before if isinstance(before, Mapping) else {}
        problems += [
            f"option '{key}': {self.name} was made with {_shown(before.get(key))}, found {_shown(value)}; calibrate "
            "anew, or inspect as it was made"
            for key, value in now["options"].items()
            if value != before.get(key)
        ]
        if options.false_alarms < least_rate(len(self.sets)):
            problems.append(too_few_good_sets(len(self.sets), options.false_alarms, self.name))
        refuse(problems)

    def of(self, posture: Posture, exposures: ExposuresByLight, *, where: str) -> CalibratedPosture:
        """What was learned of a posture that was taken in this way.

        Raises InputError: no such posture, or other lights, exposures or numbers of frames.
        """
        found = next((one for one in self.postures if one.posture == posture), None)
        if found is None:
            there = ", ".join(str(one.posture) for one in self.postures)
            raise InputError(
                f"{where}: posture {posture} is none of those that {self.name} was made for ({there}); "
                "calibrate again with good sets of this posture"
            )
        if found.exposures != exposures:
            raise InputError(
                f"{where}, posture {posture}: expected the images that {self.name} was made for, "
                f"{exposures_text(found.exposures)}, found {exposures_text(exposures)}; take them as the good sets "
                "were taken, or calibrate again"
            )
        return found

    def as_dict(self) -> dict[str, Any]:
        return {
            "false_alarms": self.rate,
            "confidence": CONFIDENCE,
            "least_false_alarms": round(least_rate(len(self.sets)), 5),
            "good_sets": list(self.sets),
            "made_for": dict(self.fingerprint),
        }


def _shown(value: object) -> str:
    return "none" if value is None else str(value)


def calibration_fingerprint(rig: RigConfig, part: PartConfig, options: InspectOptions) -> dict[str, Any]:
    """All that scores depend on, as hashes, and the options: not names, limits of the verdict, or lists of defects."""
    names = ("name", "postures", "defects", "defect_catalogue")
    of_part: dict[str, Any] = {**dict.fromkeys(names, True), "mesh": {"file"}}
    # predictions depend on the bounces, and on masks and tables, whatever these are called
    of_part["inspection"] = set(type(part.inspection).model_fields) - {"bounces"}
    of_part["reflectance"] = {"table"}
    of_part["regions"] = {"__all__": {"name": True, "mask": {"file"}, "reflectance": {"table"}}}
    masks = [file_sha256(part.source.resolve(name)) for _, name in referenced_files(part)]
    if DETECTORS[options.scored_by].uses_catalogue or options.reference == "self":
        del of_part["defect_catalogue"]
    by_synthetic = DETECTORS[options.detector].uses_synthetic
    names = ("reference", "detector", "register", "fusion" if by_synthetic else "min_images")
    chosen = {name: getattr(options, name) for name in names}
    of_rig: dict[str, Any] = {
        "camera": rig.camera.model_dump(mode="json"),
        "light_source": None if rig.light_source is None else rig.light_source.model_dump(mode="json"),
        "lights": [light.model_dump(mode="json", exclude={*RANGE_KEYS}) for light in rig.lights],
        "stage": rig.stage.model_dump(mode="json", exclude={"elevation_range_deg", "rotation_range_deg"}),
    }
    if rig.calibration is not None:
        covariance = rig.source.resolve(rig.calibration.covariance)
        of_rig["covariance"] = file_sha256(covariance) if covariance.is_file() else None
    return {
        "rig": _hash(of_rig),
        "part": _hash({**part.model_dump(mode="json", exclude=of_part), "masks": masks}),
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "options": chosen,
    }


def _hash(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def sets_needed(rate: float) -> int:
    """Number of good sets that a rate needs: the least n with 1 − (1 − rate)ⁿ ≥ 95 %."""
    return math.ceil(math.log1p(-CONFIDENCE) / math.log1p(-min(rate, 1.0 - 1e-12)))


def least_rate(sets: int) -> float:
    """The lowest rate that this number of good sets supports."""
    return 1.0 - (1.0 - CONFIDENCE) ** (1.0 / sets)


def tolerance_limit(peaks: Sequence[float], rate: float) -> float | None:
    """Lowest threshold that at most this share of good sets exceeds, with 95 % confidence; None if there is none."""
    ordered = sorted(peaks, reverse=True)
    limit = None
    for k, peak in enumerate(ordered, start=1):
        if float(special.betainc(k, len(ordered) - k + 1, min(rate, 1.0))) < CONFIDENCE - 1e-9:
            break
        limit = peak
    return limit


def too_few_good_sets(sets: int, rate: float, where: str) -> str:
    """Message that this number of good sets does not support a rate; `where` names the sets."""
    least = least_rate(sets)
    return (
        f"{where}: {counted(sets, 'good set')} support a false-alarm rate of {least:.3g} per posture or "
        f"more with {100.0 * CONFIDENCE:.0f} % confidence; {rate:g} needs {sets_needed(rate)}: give more good sets, "
        f"or accept a rate of {math.ceil(least * 1000.0) / 1000.0:g}"
    )


class CalibrationFolder(ResultFolder):
    """A folder that a calibration is written to; takes what :class:`lightopt.images.ResultFolder` takes."""

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        super().__init__(folder, made_from, name=CALIBRATION_NAME, format=FORMAT, what="a calibration", force=force)

    def write(self, calibration: Calibration) -> Path:
        """Write the maps of each posture, and at last ``calibration.json``."""
        postures = [
            {
                "posture": one.posture.as_dict(),
                "shots": {light: [list(shot) for shot in shots] for light, shots in one.exposures.items()},
                "threshold": round(one.threshold(calibration.rate), 4),
                "peaks": list(one.peaks),
                **self._maps(one),
            }
            for one in calibration.postures
        ]
        return self.finish({**calibration.as_dict(), "postures": postures})

    def _maps(self, one: CalibratedPosture) -> dict[str, Any]:
        if one.systematic is None:
            return {}
        name = f"{posture_folder(one.posture)}/calibration.exr"
        channels = {
            f"{kind}.{light}": image
            for kind, images in (("mean", one.systematic.mean), ("spread", one.systematic.spread))
            for light, image in zip(one.exposures, images, strict=True)
        }
        path = self.place(name)
        sha256 = write_exr(path, channels, metadata={"posture": one.posture.as_dict()})
        return {"maps": {"exr": name, "sha256": sha256}}


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.

    path: ``calibration.json``, or its folder.
    Raises InputError: no such file, no calibration, or maps that are not those it names.
    """
    if path.is_dir():
        path = path / CALIBRATION_NAME
    try:
        data = path.read_bytes()
        content = json.loads(data)
        if content["format"] != FORMAT:
            raise ValueError(f'format "{content["format"]}", expected {FORMAT}')
        sets = tuple(str(name) for name in content["good_sets"])
        return Calibration(
            rate=float(content["false_alarms"]),
            sets=sets,
            postures=tuple(_posture(path, one, len(sets)) for one in content["postures"]),
            fingerprint=dict(content["made_for"]),
            computed_by={key: content["provenance"][key] for key in computed_by()},
            name=path.name,
            sha256=hashlib.sha256(data).hexdigest(),
        )
    except OSError as error:
        raise InputError(
            f"{error.filename or path}: cannot be read: {error.strerror or error}; give a calibration.json that "
            "lightopt wrote, with its maps beside it"
        ) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        found = f"{error} is missing" if isinstance(error, KeyError) else error
        raise InputError(f"{path}: not a calibration that lightopt wrote: {found}; calibrate again") from error


def _posture(path: Path, one: Mapping[str, Any], sets: int) -> CalibratedPosture:
    exposures = {
        str(light): tuple((float(exposure), int(frames)) for exposure, frames in own)
        for light, own in one["shots"].items()
    }
    systematic = None
    if "maps" in one:
        maps = path.parent / str(one["maps"]["exr"])
        if file_sha256(maps) != one["maps"]["sha256"]:
            raise InputError(f"{maps}: not the maps that {path} was written with; calibrate again")
        channels = read_exr(maps)
        mean, spread = (np.stack([channels[f"{kind}.{light}"] for light in exposures]) for kind in ("mean", "spread"))
        systematic = SystematicDeviations(mean=mean, spread=spread)
    peaks = tuple(float(peak) for peak in one["peaks"])
    if len(peaks) != sets:
        raise ValueError(f"peaks: {len(peaks)} of {sets} good sets")
    posture = Posture(*(float(one["posture"][axis]) for axis in ("elevation_deg", "rotation_deg")))
    return CalibratedPosture(posture=posture, exposures=exposures, peaks=peaks, systematic=systematic)
