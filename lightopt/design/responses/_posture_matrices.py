"""The luminance matrices of a run's postures, computed or read from the cache; and the patches.

The arrays of a cached matrix are described in docs/how-to/optimization.md.
"""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import RANGE_KEYS
from lightopt.core.provenance import computed_by, file_sha256
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates, Place
from lightopt.design._problem import Problem, detection_model_of
from lightopt.design.responses._evidence import UNITS_OF_IMAGE, DetectionModel, spare_units
from lightopt.design.responses._image_evaluator import MOST_BYTES, ImageCache, ImageEvaluator
from lightopt.design.responses._luminance_matrix import LuminanceMatrix, Visibility
from lightopt.design.responses._pairs import PlannedDefect
from lightopt.images import make_folder, posture_folder, write_npz_atomic
from lightopt.rendering import PatchTable, patches_for_edge


def write_matrix(path: Path, matrix: LuminanceMatrix, places: Sequence[Sequence[Place]], *, key: str) -> str:
    """Write a matrix atomically, over one of other inputs if need be; returns the file's SHA-256."""
    arrays: dict[str, NDArray[Any]] = {"key": np.array(key), "areas_mm2": matrix.areas}
    arrays["grazing_mm2"] = np.array(matrix.grazing_mm2)
    for index, (layer, own) in enumerate(zip(matrix.levels, places, strict=True)):
        arrays[f"light_{index}"] = layer
        arrays[f"angles_{index}_deg"] = np.array(own, dtype=np.float64)
    seen = matrix.visibility
    if seen is not None:
        arrays |= {f"defects_{index}": words for index, words in enumerate(seen.words)}
        arrays |= {"patch": seen.patch, "grazing": seen.grazing}
    return write_npz_atomic(path, arrays)


def read_matrix(
    path: Path, *, key: str, lights: int, defects: Sequence[PlannedDefect] | None = None
) -> LuminanceMatrix | None:
    """A cached matrix; None where there is none, it is damaged, or it depends on other inputs."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            # reading an array leaves the check of its sum out where it stops before the end of its file
            if str(arrays["key"]) != key or arrays.zip.testzip() is not None:
                return None
            levels, seen = tuple(arrays[f"light_{i}"] for i in range(lights)), None
            if defects is not None:
                words = tuple(arrays[f"defects_{i}"] for i in range(lights))
                seen = Visibility(tuple(defects), words, arrays["patch"], arrays["grazing"])
            areas, grazing_mm2 = arrays["areas_mm2"], float(arrays["grazing_mm2"])
            return LuminanceMatrix(levels=levels, areas=areas, visibility=seen, grazing_mm2=grazing_mm2)
    except Exception:  # noqa: BLE001 - zip, zlib, NumPy's header and tokenizer each have errors of their own
        return None


COARSE_SHARE = 0.15  # edges longer than this share of the part's diagonal cause a warning

MATRIX_NAME = "matrix.npz"

# what of a part no level depends on; the catalogue's defects have a key of their own
_WHOLE_KEYS = ("name", "postures", "defects", "defect_catalogue", "inspection")
_NOT_OF_LEVELS: Any = {**dict.fromkeys(_WHOLE_KEYS, True), "mesh": {"file"}}


@dataclass(eq=False)
class PostureMatrices:
    """Computes the luminance matrices or reads cached ones; patches are made only when needed."""

    problem: Problem
    folder: Path
    run: RunContext
    table: PatchTable | None = None  # the patches; None as long as they were not needed
    images: ImageCache | None = None  # some of these patches, tested for the defects of the problem; None for none
    reused: int = 0  # how many matrices were read from the cache

    def __post_init__(self) -> None:
        problem, wanted = self.problem, self.problem.defects is not None
        self.detection = detection_model_of(problem.scene, problem.part, problem.options) if wanted else None
        self._facts = _matrix_facts(problem, self.detection)
        if self.table is not None:
            self._facts["patches"] = hashlib.sha256(self.table.patches.centroids.tobytes()).hexdigest()

    @property
    def coarse_warning(self) -> str | None:
        """A warning where patches are so large that variation within one matters; None where they are not."""
        if self.table is None:
            return None
        scene = self.problem.scene
        low, high = scene.mesh.bounds
        size = float(np.linalg.norm(high - low))
        longest = max(COARSE_SHARE * size, self.table.footprint)
        if self.table.max_edge <= longest:
            return None
        # refinement may end somewhat before the budget is used up
        needed = 1.02 * patches_for_edge(self.table, scene.mesh, 0.8 * longest)
        step = 10 ** max(0, math.floor(math.log10(needed)) - 1)
        return (
            f"patches have edges up to {self.table.max_edge:.3g} mm on a part of {size:.3g} mm: a patch is lit or dark "
            f"as its middle is, so scores may be off by whole patches. option 'patch_budget' "
            f"{step * math.ceil(needed / step)} cuts them to {longest:.2g} mm or less"
        )

    def patches(self) -> PatchTable:
        if self.table is None:
            self.table = self.problem.cut_patches(edges=self.detection is None, threads=self.run.threads)
        return self.table

    def matrix(self, posture: Posture, *, held: int) -> LuminanceMatrix:
        """The luminance matrix of a posture, one of `held` that are in memory together."""
        facts = {**self._facts, "posture": posture.as_dict()}
        key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
        path = self.folder / posture_folder(posture) / MATRIX_NAME
        defects = None if self.detection is None else self.detection.catalogue.defects
        if self.problem.options.keep_matrix:
            cached = read_matrix(path, key=key, lights=len(self.problem.candidates.names), defects=defects)
            if cached is not None:
                self.reused += 1
                return self.with_spare(cached)
        panels, stage = self.problem.candidates.panels, self.run.stage(f"casting rays, {posture}")
        most, evaluator = MOST_BYTES // held, self.evaluator(self.detection)
        (matrix,) = evaluator.matrices(posture, panels, most_bytes=most, progress=stage)
        if self.problem.options.keep_matrix:
            make_folder(path.parent)
            write_matrix(path, matrix, self.problem.candidates.places, key=key)
        return self.with_spare(matrix)

    def with_spare(self, matrix: LuminanceMatrix) -> LuminanceMatrix:
        """The matrix with the units of evidence that are not needed where few of its positions light a patch."""
        if self.detection is None or matrix.visibility is None:
            return matrix
        spare = spare_units(matrix.levels, self.detection.sensor, self.detection.min_images)
        return replace(matrix, visibility=replace(matrix.visibility, spare=spare))

    def fits_memory(self, candidates: Candidates) -> bool:
        """Whether memory suffices for the levels of other candidates, in all postures together."""
        dtype = 1 if self.problem.scene.sensor.bit_depth <= 8 else 2
        positions = sum(candidates.space.sizes)
        table = self.patches()
        patches = sum(len(table.inspectable(posture)) for posture in table.postures)
        return positions * patches * dtype <= MOST_BYTES

    def levels(self, posture: Posture, candidates: Candidates) -> LuminanceMatrix:
        """The levels of a posture under other candidates; check :meth:`fits_memory` first."""
        stage = self.run.stage(f"casting rays, {posture}")
        return self.evaluator(None).matrices(posture, candidates.panels, progress=stage)[0]

    def evaluator(self, detection: DetectionModel | None) -> ImageEvaluator:
        scene, caster, shadows = self.problem.scene, self.problem.caster, self.problem.options.shadows
        evaluator = ImageEvaluator(scene, self.patches(), caster, detection, shadows=shadows, threads=self.run.threads)
        return evaluator if detection is None else replace(evaluator, images=self.images)


def _matrix_facts(problem: Problem, detection: DetectionModel | None) -> dict[str, Any]:
    # all that a level depends on, and nothing else: not the names and ranges of the lights, nor the sensor's noise and
    # saturation, which thresholds are made of
    moving = {"name", "elevation_deg", "azimuth_deg", *RANGE_KEYS}
    rig, part, scene, options = problem.rig, problem.part, problem.scene, problem.options
    mesh = part.source.resolve(part.mesh.file)
    defects: dict[str, Any] = {}
    if detection is not None:
        # evidence depends on the sensor's noise and saturation, too
        defects = {name: getattr(detection, name) for name in ("full_scale", "false_alarms", "threshold", "min_images")}
        defects |= {"noise": asdict(detection.sensor), "units": UNITS_OF_IMAGE}
        defects["defects"] = [asdict(own.entry) for own in detection.catalogue.entries]
    return {
        **defects,
        "camera": rig.camera.model_dump(mode="json", exclude={"sensor"}),
        "sensor": {"bit_depth": scene.sensor.bit_depth, "black_level": scene.sensor.black_level},
        "light_source": None if rig.light_source is None else rig.light_source.model_dump(mode="json"),
        "lights": [light.model_dump(mode="json", exclude=moving) for light in rig.lights],
        "angles_deg": [list(map(list, places)) for places in problem.candidates.places],
        "stage": rig.stage.model_dump(mode="json", exclude={"elevation_range_deg", "rotation_range_deg"}),
        "part": part.model_dump(mode="json", exclude=_NOT_OF_LEVELS),
        # of the file's name only what says how it is read
        "mesh": {"sha256": file_sha256(mesh), "suffix": mesh.suffix.lower()},
        # the patches are refined for all postures together
        "postures": [posture.as_dict() for posture in scene.postures],
        **{name: getattr(options, name) for name in ("points", "shadows", "patch_budget")},
        "computed_by": computed_by(),
    }
