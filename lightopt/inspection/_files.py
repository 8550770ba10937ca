"""The files of an inspection: defects as JSON, CSV and PLY, synthetic images (also as grey pictures) and scores."""

import json
import math
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.arrays import Bool, Float32, UInt8
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.estimate.registration import Placement
from lightopt.images import ImageSet, ResultFolder, csv_text, make_folder, posture_folder, write_exr, write_png
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._results import InspectedPosture, InspectionResult, Verdict
from lightopt.inspection.calibration._calibration import Calibration
from lightopt.inspection.detection._defects import KIND_COLOURS
from lightopt.inspection.detection._regions import region_pixels
from lightopt.inspection.prediction._registered_set import world_to_mesh_file

DEFECTS_NAME, BATCH_NAME = "defects.json", "batch.json"
TRUTH_NAME, REPORT_NAME = "truth.json", "report.html"
FORMAT = "lightopt-defects/1"
COLUMNS = (
    *("number", "kind", "counts", "x_mm", "y_mm", "z_mm", "length_mm", "width_mm", "area_mm2", "score"),
    *("greatest_contrast", "lights", "postures", "column_px", "row_px"),
)

# where the middle level of the part is less than this share of white, levels are raised to the power that takes it to
# the second share, but to no less than the third
DARK, LIFTED, LEAST_POWER = 0.1, 0.25, 0.2


def inspection_provenance(
    rig: RigConfig,
    part: PartConfig,
    sets: Sequence[ImageSet],
    options: InspectOptions,
    *,
    calibration: Calibration | None = None,
    before: Sequence[ImageSet] = (),
) -> dict[str, Any]:
    """What an inspection depends on, in the layout of :mod:`lightopt.core.provenance`.

    before: The sets of its batch that were inspected before: a part that lies near one of theirs reuses its prediction.
    """
    inputs: dict[str, Any] = {**input_hashes(rig, part), "image_sets": [image_set.fingerprint for image_set in sets]}
    if before and options.register:
        inputs["after"] = [image_set.fingerprint for image_set in before]
    if calibration is not None:
        inputs["calibration"] = {"file": calibration.name, "sha256": calibration.sha256}
    return provenance(inputs=inputs, options=asdict(options))


class InspectionFolder(ResultFolder):
    """A folder that an inspection is written to.

    force: whether files of an inspection of other inputs are replaced.
    Raises InputError: the folder holds an inspection of other inputs, and `force` is False.
    """

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        super().__init__(
            folder, made_from, name=DEFECTS_NAME, format=FORMAT, what="an inspection", also=(TRUTH_NAME,), force=force
        )

    @contextmanager
    def created(self) -> Generator[None]:
        """Create the folder before the work for it begins; a new one is removed where the work fails."""
        new = not self.folder.exists()
        make_folder(self.folder)
        try:
            yield
        except BaseException:
            if new:
                with suppress(OSError):
                    self.folder.rmdir()
            raise

    def clear(self) -> None:
        """Remove the files of a previous inspection, and the folder where nothing else is in it."""
        self._remove_previous()
        for folder in (*self.folder.glob("posture_*"), self.folder):
            with suppress(OSError):  # something else is in it
                folder.rmdir()

    def write_posture(self, posture: InspectedPosture) -> None:
        """Write the synthetic image of a posture as EXR and PNG, and its scores as EXR."""
        folder = posture_folder(posture.view.posture)
        facts = {"posture": posture.view.posture.as_dict()}
        regions = posture.labels.astype(np.float32)
        channels = {"score": posture.score, "region": regions}
        write_exr(self.place(f"{folder}/score.exr"), channels, metadata=facts)
        synthetic = posture.synthetic
        if synthetic is None:
            return
        flags = {"filled": synthetic.filled.astype(np.float32), "mask": synthetic.mask.astype(np.float32)}
        channels = {"Y": synthetic.level, "deviation.Y": synthetic.deviation, **flags}
        write_exr(self.place(f"{folder}/synthetic.exr"), channels, metadata=facts)
        shown = grey_picture(synthetic.level, synthetic.mask)
        write_png(self.place(f"{folder}/synthetic.png"), shown.grey, metadata={**facts, **shown.as_dict()})

    def write(self, result: InspectionResult, verdict: Verdict) -> list[Path]:
        """Write ``defects.csv``, ``defects.ply`` and at last ``defects.json``."""
        written = [
            self.write_text("defects.csv", _table(result, verdict)),
            self.write_text("defects.ply", _points(result)),
        ]
        return [self.finish({**result.as_dict(), **verdict.as_dict()}), *written]


class BatchFolder(ResultFolder):
    """The folder above those of several parts; takes what :class:`lightopt.images.ResultFolder` takes."""

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, force: bool) -> None:
        names = {"name": BATCH_NAME, "format": "lightopt-inspections/1", "what": "inspections"}
        super().__init__(folder, made_from, **names, also=(TRUTH_NAME,), force=force)


def set_names(sets: Sequence[ImageSet], out: Path) -> list[str]:
    """Names of the folders below `out` for the results of several sets: those of the sets.

    Raises InputError: sets of the same name.
    """
    names = [image_set.folder.resolve().name for image_set in sets]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(
            f"image sets of the same folder name ({', '.join(twice)}): results go to folders of these names in {out}; "
            "rename one, or inspect them one by one"
        )
    return names


def truth_text(summary: Mapping[str, Any]) -> str:
    """``truth.json`` with a summary from :func:`lightopt.inspection.summarise`."""
    return json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _table(result: InspectionResult, verdict: Verdict) -> str:
    rows: list[list[object]] = [[*COLUMNS]]
    for defect in result.defects:
        best = defect.best
        rows.append(
            [
                defect.number,
                best.kind,
                "yes" if defect.number in verdict.counting else "no",
                *(f"{x:.4f}" for x in (*best.position, *defect.size)),
                f"{defect.area:.5f}",
                f"{best.score:.2f}",
                f"{defect.greatest_contrast:.4f}",
                " ".join(defect.lights),
                " ".join(f"{s.posture.elevation_deg:g}/{s.posture.rotation_deg:g}" for s in defect.detections),
                *(f"{x:.2f}" for x in best.centre_px),
            ]
        )
    return csv_text(rows)


def _points(result: InspectionResult) -> str:
    # surface points of all detections in the mesh file's coordinates, coloured by kind
    placement = result.placement or Placement()
    regions = {p.view.posture: region_pixels(p.labels, len(p.detections)) for p in result.postures}
    lines: list[str] = []
    for defect in result.defects:
        red, green, blue = KIND_COLOURS[defect.best.kind]
        for detection in defect.detections:
            posture = next(p for p in result.postures if p.view.posture == detection.posture)
            row, column = regions[posture.view.posture][posture.detections.index(detection)]
            world = posture.view.prediction.images.geometry.points[row, column].astype(np.float64)
            for x, y, z in world_to_mesh_file(world, result.nominal, placement, detection.posture):
                lines.append(f"{x:.4f} {y:.4f} {z:.4f} {red} {green} {blue} {defect.number}")
    head = [
        "ply",
        "format ascii 1.0",
        "comment defects as points in the coordinates of the mesh file, mm",
        f"element vertex {len(lines)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
        "property int defect",
        "end_header",
    ]
    return "\n".join([*head, *lines]) + "\n"


@dataclass(frozen=True, eq=False)
class GreyPicture:
    """An image as grey: 255 · ((level − black) / (white − black)) ^ power."""

    grey: UInt8
    # the levels that are shown black and white [grey level]
    black: float
    white: float
    power: float

    @property
    def legend(self) -> str:
        black = f"black: {self.black:.3g}, " if self.black < 0.0 else ""
        stretched = "" if self.power == 1.0 else f"; stretched by a power of {self.power:g}, so that dark places show"
        return f"{black}white: {self.white:.3g} grey levels{stretched}"

    def as_dict(self) -> dict[str, Any]:
        return {"black_level": round(self.black, 4), "white_level": round(self.white, 4), "power": self.power}


def grey_picture(level: Float32, mask: Bool, *, like: GreyPicture | None = None) -> GreyPicture:
    """Show an image: white is the level that one in a thousand pixels exceeds, and dark images are stretched.

    level: Shape (H, W) [grey level].
    mask: Pixels that show the part; the others are black, shape (H, W).
    like: Another image, whose black, white and power are taken.
    """
    inside = level[mask]
    if like is not None:
        black, white, power = like.black, like.white, like.power
    else:
        white = max(float(np.percentile(inside, 99.9)), 1e-6) if inside.size else 1.0
        # gradients do not determine the level of a dark field: integrated, it may be below black
        black = min(0.0, float(np.percentile(inside, 1.0))) if inside.size else 0.0
        power = 1.0
    share = np.where(mask, np.clip((level - black) / (white - black), 0.0, 1.0), 0.0)
    if like is None and inside.size and (middle := float(np.median(share[mask]))) < DARK:
        power = max(LEAST_POWER, round(math.log(LIFTED) / math.log(max(middle, 1e-6)), 2))
    return GreyPicture((255.0 * share**power + 0.5).astype(np.uint8), black, white, power)
