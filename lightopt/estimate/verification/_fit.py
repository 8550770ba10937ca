"""Fit faults to images: Gauss–Newton steps, each with the groups of parameters that the evidence is greatest for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import (
    Agreement,
    Observation,
    agreement,
    refuse_useless_images,
    register as register_part,
)
from lightopt.estimate.verification._coarse import (
    CoarseImage,
    CoarsePrediction,
    block_side,
    coarse_camera,
    coarse_images,
    predict_coarse,
)
from lightopt.estimate.verification._model import Model
from lightopt.estimate.verification._parameters import Group, Parameters
from lightopt.estimate.verification._selection import Evidence, choose, gather
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, project

MOST_STEPS = 6
SETTLED = 0.05  # a step is the last if it changes no parameter by more than this share of its limit

PANEL_MM = 10.0  # a panel that has moved by this is as bad as a part that has moved by a block
STALE_BLOCKS = 0.5  # blocks are chosen anew, and images rendered, where the part's image has moved by more than this
# rigs that differ by less have the same images: in place [block], reflectance and blur [px²]
SAME_BLOCKS, SAME_SHARE, SAME_BLUR = 0.02, 0.005, 0.2

LEAST_ROWS = 300  # fewer blocks of all images determine nothing

# an excess residual of more than this share of the level is not explained: the part may lie elsewhere
UNEXPLAINED_SHARE = 0.15
# the same where its image has moved by more than this, and the residual is still so many times the noise
FAR_BLOCKS, FAR_RESIDUAL = 4.0, 2.0


class Work:
    """What is the same for all sets of a scene."""

    def __init__(self, scene: Scene, parameters: Parameters, run: RunContext) -> None:
        self.scene, self.parameters, self.run = scene, parameters, run
        self.side = block_side(scene.camera)
        self.coarse = replace(scene, camera=coarse_camera(scene.camera, self.side))
        self.caster = cast_rays_at(scene)
        self._kept: list[tuple[Float64, dict[Posture, CoarsePrediction]]] = []

    def blocks(self, observations: Sequence[Observation]) -> tuple[CoarseImage, ...]:
        """Block means of images."""
        return coarse_images(self.scene, observations, self.side, threads=self.run.threads)

    def predict(self, theta: Float64, *, within: float = SAME_BLOCKS) -> dict[Posture, CoarsePrediction]:
        """Images of the rig with some faults; of one that was rendered before if it differs by less [block]."""
        for there, kept in self._kept:
            *lobe, blur = np.abs(theta - there)[self.parameters.nuisance]
            same = max(lobe) < SAME_SHARE and blur < SAME_BLUR
            if same and self.moved_blocks(theta, there) <= within:
                return kept
        found = {
            posture: predict_coarse(
                self.coarse, self.parameters, theta, posture, self.caster, side=self.side, threads=self.run.threads
            )
            for posture in self.scene.postures
        }
        self._kept.append((theta, found))
        return found

    def moved_blocks(self, a: Float64, b: Float64) -> float:
        """By how much the images of two rigs differ, at most [block]: of the part, or of what it mirrors."""
        p = self.parameters
        panels = [g for g in p.groups if g.kind == "panel_shift"]
        most = max(float(np.abs(a - b)[g.where].max()) / PANEL_MM for g in panels)
        vertices = self.scene.mesh.vertices
        some = vertices[:: max(1, len(vertices) // 500)]
        for posture in self.scene.postures:
            (x, y, _), (u, v, _) = (project(p.view(self.coarse, posture, t).camera, some) for t in (a, b))
            most = max(most, float(np.nanmax(np.hypot(x - u, y - v))))
        return most


@dataclass(frozen=True)
class Fit:
    """The faults that explain a set.

    theta: From the rig file, shape (K,); covariance: Of what differs from the baseline, or from the rig file, (K, K).
    predictions: Of the rig with these faults.
    left: What they leave.
    registered: Whether the part was searched for.
    """

    images: tuple[CoarseImage, ...]
    theta: Float64
    covariance: Float64
    chosen: tuple[Group, ...]
    evidence: Evidence
    predictions: dict[Posture, CoarsePrediction]
    left: Agreement
    registered: bool = False


def fit_faults(
    work: Work, images: tuple[CoarseImage, ...], good: Fit | None = None, *, where: str, register: bool
) -> Fit:
    """Find the faults that explain images, from those of a known good set or from the rig file.

    where: The set, for messages.
    register: Whether the part is searched for where it does not lie near its nominal placement.

    Raises InputError: images that show nothing, or that no faults explain.
    """
    observations = [image.source for image in images]
    refuse_useless_images(work.scene, observations, caster=work.caster, threads=work.run.threads)
    origin = np.zeros(work.parameters.size) if good is None else good.theta
    fit = _descend(work, images, good, origin, origin)
    far = work.moved_blocks(fit.theta, origin) > FAR_BLOCKS and fit.left.residual > FAR_RESIDUAL * fit.left.noise
    if register and (far or fit.left.share > UNEXPLAINED_SHARE):
        found = register_part(work.scene, observations, caster=work.caster, reduced=True, run=work.run)
        start = work.parameters.at_placement(work.scene, found.placement)
        other = replace(_descend(work, images, good, origin, start), registered=True)
        fit = min(fit, other, key=lambda one: one.left.residual)
    if (evaluable := int(np.count_nonzero(fit.evidence.weight))) < LEAST_ROWS:
        raise InputError(
            f"{where}: only {evaluable} places of all images are neither saturated nor at an edge, expected at least "
            f"{LEAST_ROWS}; capture them with a shorter exposure, or of a larger part"
        )
    if fit.left.mismatch:
        raise InputError(
            f"{where}: the images do not look like this part on this rig: measured minus predicted is "
            f"{fit.left.residual:.3g} sensor levels rms with the faults that explain most, where the prediction is "
            f"{fit.left.level:.3g}; check that rig, part and postures are those of the images"
        )
    return fit


def _descend(work: Work, images: tuple[CoarseImage, ...], good: Fit | None, origin: Float64, start: Float64) -> Fit:
    p = work.parameters
    limits = np.concatenate([np.full(g.size, g.limit) for g in p.groups])
    report = work.run.stage("comparing with the prediction")
    at, predictions = start, work.predict(start)
    model = _model(work, images, good, predictions)
    theta = model.with_black_level(start) if good is None else start
    step = 0
    while True:
        if report is not None:
            report(step / MOST_STEPS)
        if step and work.moved_blocks(theta, at) > STALE_BLOCKS:
            at, predictions = theta, work.predict(theta)
            model = _model(work, images, good, predictions)
        evidence = gather(p, model.linearise(theta), theta - origin, model.rows.cell)
        chosen = choose(evidence)
        _, found, covariance = evidence.solve(chosen)
        change = np.abs(origin + found - theta)[: len(limits)] / limits
        theta = origin + found
        step += 1
        if change.max() < SETTLED or step == MOST_STEPS:
            break
    mean, noise = model.predicted(theta)
    black = work.scene.sensor.black_level
    known = ~model.rows.background & np.isfinite(mean) & (evidence.weight > 0.0)
    left = agreement(model.rows.measured[known] - black, mean[known] - black, noise[known])
    return Fit(images, theta, covariance, chosen, evidence, work.predict(theta), left)


def _model(
    work: Work, images: Sequence[CoarseImage], good: Fit | None, predictions: Mapping[Posture, CoarsePrediction]
) -> Model:
    def make(some: Sequence[CoarseImage]) -> Model:
        return Model(
            work.coarse, work.parameters, some, predictions,
            caster=work.caster, side=work.side, threads=work.run.threads,
        )  # fmt: skip

    model = make(images)
    if good is not None:
        model.correct(make(good.images), good.theta)
    return model
