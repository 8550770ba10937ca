"""What good parts taught: the scores that they reach, and what they have in common; as a file for later inspections."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from lightopt.align import Observation
from lightopt.config import PartConfig, RigConfig
from lightopt.errors import InputError, counted
from lightopt.images import ResultFolder, file_sha256, posture_folder, read_exr, write_exr
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._rates import CONFIDENCE, held_threshold, least_rate, sets_needed
from lightopt.inspection._systematic import Systematic
from lightopt.transforms import Posture

__all__ = [
    "CALIBRATION_NAME",
    "CalibratedPosture",
    "Calibration",
    "CalibrationFolder",
    "made_for",
    "read_calibration",
    "shots_of",
]

CALIBRATION_NAME: Final = "calibration.json"
FORMAT: Final = "lightopt-calibration/1"
LEAST: Final = 3.0
"""No threshold is below this: of so many pixels, some have a chance of one in a thousand."""

Shots = dict[str, tuple[tuple[float, int], ...]]
"""By light the exposures and the numbers of frames of its images."""


@dataclass(frozen=True, kw_only=True)
class CalibratedPosture:
    """What good parts taught of one posture.

    Attributes
    ----------
    posture
        Of the part.
    shots
        Images that each light has.
    peaks
        Greatest score of each good set, judged by what the others have in common.
    systematic
        What they have in common; None for a detector that does not look at deviations.
    """

    posture: Posture
    shots: Shots
    peaks: tuple[float, ...]
    systematic: Systematic | None = field(repr=False)

    def threshold(self, rate: float) -> float:
        """Score that holds a rate of false alarms.

        Raises
        ------
        InputError
            So few good sets do not bear it.
        """
        peak = held_threshold(self.peaks, rate)
        if peak is None:
            raise InputError(too_few(len(self.peaks), rate, f"posture {self.posture}"))
        return float(np.nextafter(np.float32(max(peak, LEAST)), np.float32(np.inf)))


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What good parts taught.

    Attributes
    ----------
    rate
        False alarms that it was made for: share of the good sets of a posture.
    sets
        Names of the good sets' folders.
    postures
        In the sets' order.
    made_for
        From :func:`made_for`.
    name
        File name, and its hash: for the provenance of what is inspected with it.
    sha256
        Empty for one that no file has.
    """

    rate: float
    sets: tuple[str, ...]
    postures: tuple[CalibratedPosture, ...]
    made_for: Mapping[str, Any]
    name: str = CALIBRATION_NAME
    sha256: str = ""

    def refuse_others(self, rig: RigConfig, part: PartConfig, options: InspectOptions) -> None:
        """Refuse another rig, part or way to inspect, and a rate that the good sets do not bear.

        Raises
        ------
        InputError
            Names all that differs.
        """
        now = made_for(rig, part, options)
        words = {
            "rig": f"{rig.source.path}: camera, sensor, lights or stage",
            "part": f"{part.source.path}: placement, reflectance or how the mesh is read",
            "mesh_sha256": f"{part.source.resolve(part.mesh.file)}: the mesh",
        }
        problems = [
            f"{text} differ from those that {self.name} was made for; make it anew (--calibrate)"
            for key, text in words.items()
            if now[key] != self.made_for.get(key)
        ]
        before = self.made_for.get("options")
        before = before if isinstance(before, Mapping) else {}
        problems += [
            f"--{key.replace('_', '-')}: {self.name} was made with {_shown(before.get(key))}, found {_shown(value)}; "
            "make it anew (--calibrate), or inspect as it was made"
            for key, value in now["options"].items()
            if value != before.get(key)
        ]
        if options.false_alarms < least_rate(len(self.sets)):
            problems.append(too_few(len(self.sets), options.false_alarms, self.name))
        if problems:
            raise InputError(*problems)

    def of(self, posture: Posture, shots: Shots, *, where: str) -> CalibratedPosture:
        """What was learned of a posture that was taken in this way.

        Raises
        ------
        InputError
            Nothing: no such posture, other lights, exposures or numbers of frames.
        """
        found = next((one for one in self.postures if one.posture == posture), None)
        if found is None:
            there = ", ".join(str(one.posture) for one in self.postures)
            raise InputError(
                f"{where}: posture {posture} is none of those that {self.name} was made for ({there}); make it anew "
                "with good sets of this posture (--calibrate)"
            )
        if found.shots != shots:
            raise InputError(
                f"{where}, posture {posture}: expected the images that {self.name} was made for, "
                f"{_images(found.shots)}, found {_images(shots)}; take them as the good sets were taken, "
                "or make the calibration anew"
            )
        return found

    def as_dict(self) -> dict[str, Any]:
        """JSON form, maps apart."""
        return {
            "false_alarms": self.rate,
            "confidence": CONFIDENCE,
            "least_false_alarms": round(least_rate(len(self.sets)), 5),
            "good_sets": list(self.sets),
            "made_for": dict(self.made_for),
        }


class CalibrationFolder(ResultFolder):
    """A folder that a calibration is written to; takes what :class:`lightopt.images.ResultFolder` takes."""

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        super().__init__(
            folder, made_from, name=CALIBRATION_NAME, format=FORMAT, what="a calibration", force=force
        )

    def write(self, calibration: Calibration) -> Path:
        """Write the maps of each posture, and at last ``calibration.json``."""
        postures = [
            {
                "posture": one.posture.as_dict(),
                "shots": {light: [list(shot) for shot in shots] for light, shots in one.shots.items()},
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
            for light, image in zip(one.shots, images, strict=True)
        }
        path = self.place(name)
        sha256 = write_exr(path, channels, metadata={"posture": one.posture.as_dict()})
        return {"maps": {"exr": name, "sha256": sha256}}


def made_for(rig: RigConfig, part: PartConfig, options: InspectOptions) -> dict[str, Any]:
    """All that scores depend on, as hashes, and the options: not names, limits of the verdict, or lists of defects."""
    of_part = {
        "name": True,
        "postures": True,
        "mesh": {"file"},
        "inspection": True,
        "defects": True,
        "defect_catalogue": True,
    }
    ranges = {"elevation_range_deg", "azimuth_range_deg"}
    chosen: dict[str, Any] = {
        "detector": options.detector,
        "no_shift": not options.shift,
    }
    chosen |= {"fusion": options.fusion} if options.detector == "template" else {"seen_by": options.seen_by}
    return {
        "rig": _hash(
            {
                "camera": rig.camera.model_dump(mode="json"),
                "light_source": rig.light_source.model_dump(mode="json"),
                "lights": [light.model_dump(mode="json", exclude=ranges) for light in rig.lights],
                "pivot_mm": list(rig.stage.pivot_mm),
            }
        ),
        "part": _hash(part.model_dump(mode="json", exclude=of_part)),
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "options": chosen,
    }


def shots_of(observations: Sequence[Observation], lights: Sequence[str]) -> Shots:
    """Exposures and numbers of frames of the images of a posture, by light in the order given."""
    return {
        light: tuple(sorted((o.exposure, o.frames) for o in observations if o.light == light))
        for light in lights
    }


def too_few(sets: int, rate: float, where: str) -> str:
    """What to say of a rate that so many good sets do not bear."""
    return (
        f"{where}: {counted(sets, 'good set')} bear a rate of false alarms of {least_rate(sets):.3g} per posture or "
        f"more with {100.0 * CONFIDENCE:.0f} % confidence; {rate:g} takes {sets_needed(rate)}: give more good sets, "
        f"or ask for --false-alarms {_rounded_up(least_rate(sets)):g}"
    )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.

    Parameters
    ----------
    path
        ``calibration.json``, or its folder.

    Raises
    ------
    InputError
        No such file, no calibration, or maps that are not those it names.
    """
    if path.is_dir():
        path = path / CALIBRATION_NAME
    try:
        data = path.read_bytes()
        content = json.loads(data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}; give the calibration.json that --calibrate wrote"
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: expected the JSON that --calibrate wrote: {error}") from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise InputError(
            f'{path}: expected a file of format {FORMAT}, found "{found}"; make one with --calibrate'
        )
    try:
        sets = tuple(str(name) for name in content["good_sets"])
        calibration = Calibration(
            rate=float(content["false_alarms"]),
            sets=sets,
            postures=tuple(_posture(path, one, len(sets)) for one in content["postures"]),
            made_for=dict(content["made_for"]),
            name=path.name,
            sha256=hashlib.sha256(data).hexdigest(),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{path}: not as --calibrate wrote it: {type(error).__name__} at {error}; make it anew"
        ) from error
    return calibration


def _posture(path: Path, one: Mapping[str, Any], sets: int) -> CalibratedPosture:
    shots = {
        str(light): tuple((float(exposure), int(frames)) for exposure, frames in own)
        for light, own in one["shots"].items()
    }
    systematic = None
    if "maps" in one:
        maps = path.parent / str(one["maps"]["exr"])
        try:
            sha256 = file_sha256(maps)
        except OSError as error:
            raise InputError(
                f"{maps}: cannot be read: {error.strerror or error}; {path.name} needs the maps beside it"
            ) from error
        if sha256 != one["maps"]["sha256"]:
            raise InputError(f"{maps}: not the maps that {path} was written with; make the calibration anew")
        channels = read_exr(maps)
        mean, spread = (
            np.stack([channels[f"{kind}.{light}"] for light in shots]) for kind in ("mean", "spread")
        )
        systematic = Systematic(mean=mean, spread=spread)
    peaks = tuple(float(peak) for peak in one["peaks"])
    if len(peaks) != sets:
        raise ValueError(f"peaks: {len(peaks)} of {sets} good sets")
    return CalibratedPosture(
        posture=Posture(
            elevation_deg=float(one["posture"]["elevation_deg"]),
            rotation_deg=float(one["posture"]["rotation_deg"]),
        ),
        shots=shots,
        peaks=peaks,
        systematic=systematic,
    )


def _hash(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _shown(value: object) -> str:
    return "none" if value is None else str(value)


def _images(shots: Shots) -> str:
    def one(exposure: float, frames: int) -> str:
        return f"×{exposure:g}" + (f" of {frames} frames" if frames > 1 else "")

    return "; ".join(f"{light} {', '.join(one(*shot) for shot in own)}" for light, own in shots.items())


def _rounded_up(rate: float) -> float:
    return float(np.ceil(rate * 1000.0) / 1000.0)
