"""A calibration as files: numbers as JSON, and beside them the maps of each posture."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from lightopt.core.errors import InputError
from lightopt.core.provenance import computed_by, file_sha256
from lightopt.core.transforms import Posture
from lightopt.images import ResultFolder, posture_folder, read_exr, write_exr
from lightopt.inspection.calibration._calibration import CALIBRATION_NAME, CalibratedPosture, Calibration
from lightopt.inspection.calibration._systematic import SystematicDeviations

FORMAT: Final = "lightopt-calibration/1"


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
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}; give a calibration.json that lightopt wrote"
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: expected the JSON of a calibration: {error}") from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise InputError(f'{path}: expected a file of format {FORMAT}, found "{found}"; calibrate anew')
    try:
        sets = tuple(str(name) for name in content["good_sets"])
        calibration = Calibration(
            rate=float(content["false_alarms"]),
            sets=sets,
            postures=tuple(_posture(path, one, len(sets)) for one in content["postures"]),
            fingerprint=dict(content["made_for"]),
            computed_by={key: content["provenance"][key] for key in computed_by()},
            name=path.name,
            sha256=hashlib.sha256(data).hexdigest(),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{path}: not a calibration that lightopt wrote: {type(error).__name__} at {error}; calibrate anew"
        ) from error
    return calibration


def _posture(path: Path, one: Mapping[str, Any], sets: int) -> CalibratedPosture:
    exposures = {
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
            raise InputError(f"{maps}: not the maps that {path} was written with; calibrate anew")
        channels = read_exr(maps)
        mean, spread = (np.stack([channels[f"{kind}.{light}"] for light in exposures]) for kind in ("mean", "spread"))
        systematic = SystematicDeviations(mean=mean, spread=spread)
    peaks = tuple(float(peak) for peak in one["peaks"])
    if len(peaks) != sets:
        raise ValueError(f"peaks: {len(peaks)} of {sets} good sets")
    return CalibratedPosture(
        posture=Posture(
            elevation_deg=float(one["posture"]["elevation_deg"]), rotation_deg=float(one["posture"]["rotation_deg"])
        ),
        exposures=exposures,
        peaks=peaks,
        systematic=systematic,
    )
