"""From two YAML files to the best light positions, on disk."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lightopt import __version__
from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.errors import InputError, counted
from lightopt.images import file_sha256, make_folder, posture_folder
from lightopt.optimize._angles import can_move
from lightopt.optimize._answer import answer_set
from lightopt.optimize._appendix import Appendix, Appraise, Outcome
from lightopt.optimize._blind_files import blind_files, blind_pictures
from lightopt.optimize._blind_report import BlindReport, Looked, look_for_blind_spots
from lightopt.optimize._candidates import Candidates, find_candidates
from lightopt.optimize._contrast import Contrast
from lightopt.optimize._detectability import Detectability
from lightopt.optimize._draft import Draft
from lightopt.optimize._earlier import refuse_other_result
from lightopt.optimize._inspection import Inspection
from lightopt.optimize._kept import keep_matrix, matrix_key, read_matrix
from lightopt.optimize._luminance import MOST_BYTES, luminance_matrix
from lightopt.optimize._matrix import LuminanceMatrix, Thresholds
from lightopt.optimize._objective import Objective
from lightopt.optimize._objectives import objectives_named
from lightopt.optimize._options import OptimizeOptions, check_options
from lightopt.optimize._outputs import Written, write_outputs
from lightopt.optimize._result import Answer, SetResult
from lightopt.optimize._rig_text import check_editable
from lightopt.optimize._trials import unroll
from lightopt.overlap import Overlap
from lightopt.raycast import RayCaster
from lightopt.rendering import PatchTable, Report, build_patches, cast_rays_at, refuse_hopeless
from lightopt.scene import Scene, build_catalogue, build_scene, coarse_warnings
from lightopt.transforms import Posture

__all__ = ["Optimum", "cut_off", "optimize"]

COARSE_SHARE = 0.15
"""Edges longer than this share of the part's diagonal are worth a warning."""

MATRIX_NAME = "matrix.npz"


@dataclass(frozen=True, kw_only=True)
class Optimum:
    """What :func:`optimize` found and left on disk.

    Attributes
    ----------
    candidates
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
    thresholds: Thresholds
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
    scene = build_scene(rig, part, postures=options.postures, points=options.points)
    thresholds = Thresholds.of_sensor(
        shade_share=options.shade_below,
        max_level=scene.sensor.max_level,
        saturated_from=scene.sensor.saturated_from,
        black_level=scene.sensor.black_level,
    )
    provenance = _provenance(rig, part, scene, options, objectives, report=page is not None)
    if not force:
        refuse_other_result(Path(folder), provenance)
    caster = cast_rays_at(scene)
    # a light that moves may find its way out of the part: only its candidates count
    still = tuple(panel for panel, light in zip(scene.lights, rig.lights, strict=True) if not can_move(light))
    refuse_hopeless(replace(scene, lights=still), rig, part, caster)
    candidates = find(scene=scene, caster=caster)
    for text in (*scene.warnings, *coarse_warnings(scene.lights, scene.reflectance.sigma)):
        say(text)
    defects = next((objective for objective in objectives if isinstance(objective, Detectability)), None)
    inspection = defects and Inspection(
        trials=defects.trials,
        contrast=Contrast(
            sensor=scene.sensor, full_scale=scene.reflectance.full_scale, threshold=options.contrast
        ),
    )
    makers = _Matrices(rig, part, scene, candidates, options, Path(folder), caster, inspection)
    # the matrices of postures that do not share their lights are never held together
    shared = [scene.postures] if options.common_lights else [(posture,) for posture in scene.postures]
    if tell is not None:
        tell(_combinations(candidates))
    results: list[SetResult] = []
    looked: list[Looked] = []
    for postures in shared:
        matrices = [makers.matrix(posture, report, held=len(postures)) for posture in postures]
        results.append(
            answer_set(
                matrices,
                postures,
                candidates,
                objectives,
                thresholds,
                rows=options.rows,
                limit=options.limit,
                threads=options.threads,
                progress=searching,
            )
        )
        if defects is not None:
            best = results[-1].answers[0].found.best.candidates
            looked += [
                look_for_blind_spots(matrix, posture, thresholds, seen_in=defects.seen_in, candidates=best)
                for matrix, posture in zip(matrices, postures, strict=True)
            ]
        del matrices
        for answer in results[-1].answers:
            if not answer.found.complete and answer.nothing is None:
                say(cut_off(answer, postures))
    if page is not None:
        makers.patches()
    if makers.coarse is not None:
        say(makers.coarse)
    appendix = Appendix()
    if appraise is not None:
        appendix = appraise(
            Outcome(
                scene=scene,
                caster=caster,
                candidates=candidates,
                thresholds=thresholds,
                results=tuple(results),
                table=makers.patches,
            )
        )
    blind = None
    if defects is not None:
        patches = makers.patches().patches
        blind = BlindReport.of(appendix.looked or looked, patches.areas, defects, candidates.names)
        appendix = Appendix(
            sections={"blind_spots": blind.as_dict(), **appendix.sections},
            files={
                **blind_files(blind, patches, scene.placement),
                **blind_pictures(blind, patches, scene, caster),
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
                thresholds=thresholds,
                results=tuple(results),
                overlaps=overlaps,
                warnings=tuple(warnings),
                blind=blind,
            )
        )

    written = write_outputs(
        Path(folder),
        rig,
        part,
        tuple(results),
        candidates,
        thresholds,
        provenance=provenance,
        options=options,
        appendix=appendix,
        force=force,
        warn=say,
        page=None if page is None else draw,
    )
    return Optimum(
        candidates=candidates,
        thresholds=thresholds,
        results=tuple(results),
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
        options.objectives, lambda: Detectability(unroll(build_catalogue(part)), options.seen_in)
    )
    refusals = {objective.name: objective.refusal(len(rig.lights)) for objective in chosen}
    problems = [text for text in refusals.values() if text is not None]
    possible = tuple(objective for objective in chosen if refusals[objective.name] is None)
    if problems and (options.objectives or not possible):
        raise InputError(*problems)
    for text in problems:
        say(text)
    return possible


def cut_off(answer: Answer, postures: Sequence[Posture]) -> str:
    """What to say of a search that left combinations."""
    found, name = answer.found, answer.objective.name
    proof = (
        "none scores more, but one of those left may score the same and win the tie"
        if found.proven
        else f"none scores more than {found.bound:,}"
    )
    return (
        f"objective {name}, {', '.join(map(str, postures))}: the search stopped after {found.scored:,} combinations "
        f"with {found.left:,} left; the best found scores {found.best.score:,}, {proof}. Ties and runner-up are of "
        "what was looked at. Raise --max-combinations or take a larger --step"
    )


def _combinations(candidates: Candidates) -> str:
    sizes = candidates.space.sizes
    positions = " × ".join(map(str, sizes))
    return f"{positions} positions of {', '.join(candidates.names)}: {counted(math.prod(sizes), 'combination')} at most"


class _Matrices:
    """Makes the luminance matrices, or takes those that were kept; patches are cut only when needed."""

    def __init__(
        self,
        rig: RigConfig,
        part: PartConfig,
        scene: Scene,
        candidates: Candidates,
        options: OptimizeOptions,
        folder: Path,
        caster: RayCaster,
        inspection: Inspection | None,
    ) -> None:
        self.scene = scene
        self.candidates = candidates
        self.options = options
        self.folder = folder
        self.caster = caster
        self.reused = 0
        self.table: PatchTable | None = None
        self.inspection = inspection
        self._facts = _matrix_facts(rig, part, scene, candidates, options, inspection)

    @property
    def coarse(self) -> str | None:
        """A warning where patches are so large that what happens within one matters; None where they are not."""
        if self.table is None:
            return None
        low, high = self.scene.mesh.bounds
        size = float(np.linalg.norm(high - low))
        if self.table.max_edge <= max(COARSE_SHARE * size, self.table.footprint):
            return None
        return (
            f"patches have edges up to {self.table.max_edge:.3g} mm on a part of {size:.3g} mm: a patch is lit or dark "
            "as its middle is, so scores may be off by whole patches. Raise --patches, or give a mesh with fewer "
            "triangles"
        )

    @property
    def message(self) -> str | None:
        """What the patch refinement reached."""
        return None if self.table is None else self.table.message

    def patches(self) -> PatchTable:
        """The patches, cut when first needed."""
        if self.table is None:
            self.table = build_patches(self.scene, caster=self.caster, budget=self.options.patch_budget)
        return self.table

    def matrix(self, posture: Posture, report: Report | None, *, held: int) -> LuminanceMatrix:
        """The luminance matrix of a posture, one of so many that are held together."""
        key = matrix_key({**self._facts, "posture": posture.as_dict()})
        path = self.folder / posture_folder(posture) / MATRIX_NAME
        trials = None if self.inspection is None else self.inspection.trials
        kept = read_matrix(path, key=key, lights=len(self.candidates.names), trials=trials)
        if kept is not None:
            self.reused += 1
            return kept
        made = luminance_matrix(
            self.scene,
            self.patches(),
            posture,
            self.candidates.panels,
            caster=self.caster,
            inspection=self.inspection,
            shadows=self.options.shadows,
            threads=self.options.threads,
            most_bytes=MOST_BYTES // held,
            progress=None if report is None else lambda share, rays: report(posture, share, rays),
        )
        if self.options.keep_matrix:
            make_folder(path.parent)
            keep_matrix(path, made, self.candidates.angles, key=key)
        return made


def _matrix_facts(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    candidates: Candidates,
    options: OptimizeOptions,
    inspection: Inspection | None,
) -> dict[str, Any]:
    # all that a level depends on, and nothing else: not the names and ranges of the lights, nor the sensor's noise and
    # saturation, which thresholds are made of
    moving = {"name", "elevation_deg", "azimuth_deg", "elevation_range_deg", "azimuth_range_deg"}
    mesh = part.source.resolve(part.mesh.file)
    looked_for: dict[str, Any] = {}
    if inspection is not None:
        # what is visible depends on the sensor's noise and saturation, too
        looked_for = {
            "defects": [asdict(trial) for trial in inspection.trials],
            "noise": asdict(inspection.contrast),
            "defects narrower than a pixel": "F (D - M) + A M in two pixels",
        }
    return {
        **looked_for,
        "camera": rig.camera.model_dump(mode="json", exclude={"sensor"}),
        "sensor": {"bit_depth": scene.sensor.bit_depth, "black_level": scene.sensor.black_level},
        "light_source": rig.light_source.model_dump(mode="json"),
        "lights": [light.model_dump(mode="json", exclude=moving) for light in rig.lights],
        "angles_deg": [list(map(list, angles)) for angles in candidates.angles],
        "pivot_mm": list(rig.stage.pivot_mm),
        "part": part.model_dump(mode="json", exclude={"name": True, "postures": True, "mesh": {"file"}}),
        # of the file's name only what says how it is read
        "mesh": {"sha256": file_sha256(mesh), "suffix": mesh.suffix.lower()},
        # the patches are refined for all postures together
        "postures": [posture.as_dict() for posture in scene.postures],
        "points": options.points,
        "shadows": options.shadows,
        "patch_budget": options.patch_budget,
        "versions": _versions(),
    }


def _provenance(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    options: OptimizeOptions,
    objectives: tuple[Objective, ...],
    *,
    report: bool,
) -> Mapping[str, Any]:
    return {
        "versions": _versions(),
        # names only, so that the same files give the same result wherever they lie
        "rig": {"file": rig.source.path.name, "sha256": rig.source.sha256},
        "part": {"file": part.source.path.name, "sha256": part.source.sha256},
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "options": {
            "objectives": [objective.name for objective in objectives],
            "step_deg": options.step_deg,
            "common_elevation": options.common_elevation,
            "common_lights": options.common_lights,
            "shade_below": options.shade_below,
            "postures": [posture.as_dict() for posture in scene.postures],
            "points": options.points,
            "shadows": options.shadows,
            "patch_budget": options.patch_budget,
            "max_combinations": options.limit,
            "ranking_rows": options.rows,
            "images": options.images,
            **_defect_options(options, objectives),
            "report": report,
            **options.plan,
        },
    }


def _defect_options(options: OptimizeOptions, objectives: tuple[Objective, ...]) -> dict[str, Any]:
    # they matter to one objective only
    if not any(isinstance(objective, Detectability) for objective in objectives):
        return {}
    return {"seen_in": options.seen_in, "threshold": options.contrast}


def _versions() -> dict[str, str]:
    packages = ("cascadio", "embreex", "numba", "numpy", "trimesh")
    return {"lightopt": __version__, **{name: version(name) for name in packages}}
