"""What the values of a calibrated rig file may still be off, in the parameters of faults."""

from dataclasses import replace

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.estimate.rig_calibration import displaced, read_covariance, square_root
from lightopt.estimate.verification._parameters import Parameters
from lightopt.scene import PinholeCamera, Scene, Stage, project


def calibrated_deviations(rig: RigConfig, scene: Scene, p: Parameters) -> Float64:
    """Independent deviations of one standard deviation each, as columns, shape (K, D); none for a rig as designed.

    Raises InputError: The covariance that the rig file names cannot be read
    """
    names, covariance = read_covariance(rig)
    at = {name: i for i, name in enumerate(names)}
    own = [i for name, i in at.items() if name.startswith(("camera.", "tilt_axis.", "rotary_axis."))]
    of_rig = [displaced(scene.camera, scene.stage, names, column) for column in _root_of(covariance, own).T]
    to_faults = np.zeros((p.size, len(names)))
    for light in scene.lights:
        axes = np.stack([light.across, light.along, light.outward])
        for k, axis in enumerate("xyz"):
            if (i := at.get(f"{light.name} centre {axis} [mm]")) is not None:
                to_faults[p.group("panel_shift", light.name).where, i] = axes[:, k]
        for k, axis in enumerate(("across", "along")):
            if (i := at.get(f"{light.name} rotation about {axis} [rad]")) is not None:
                to_faults[p.group("panel_turn", light.name).first + k, i] = 1.0
        if (i := at.get(f"{light.name} gain")) is not None:
            to_faults[p.group("gain", light.name).where, i] = 1.0 / light.gain
    columns = [_as_camera(scene, p, of_rig), square_root(to_faults @ covariance @ to_faults.T)]
    return np.concatenate(columns, axis=1) if names else np.zeros((p.size, 0))


def _root_of(covariance: Float64, some: list[int]) -> Float64:
    # deviations of some of the values, shape (n, D)
    found = np.zeros((len(covariance), len(some)))
    found[some] = square_root(covariance[np.ix_(some, some)])
    return found


def _as_camera(scene: Scene, p: Parameters, rigs: list[tuple[PinholeCamera, Stage]]) -> Float64:
    # The shift and turn of the camera that move the part's image as each rig does, shape (K, rigs). Lens and axes have
    # no faults of their own, and over a part they act as a camera that has moved.
    rows = [*range(p.size)[p.group("camera_shift").where], *range(p.size)[p.group("camera_turn").where]]
    points = scene.mesh.vertices[:: max(1, len(scene.mesh.vertices) // 200)]

    def image(world: Scene, theta: Float64) -> Float64:
        cameras = [p.view(world, posture, theta).camera for posture in scene.postures]
        return np.concatenate([np.ravel(project(camera, points)[:2]) for camera in cameras])

    still, unit = image(scene, np.zeros(p.size)), np.array([g.step for g in p.groups if g.kind.startswith("camera")])
    unit = np.repeat(unit, 3)
    moves = np.array([image(scene, step * np.eye(p.size)[row]) - still for row, step in zip(rows, unit, strict=True)])
    changes = [image(replace(scene, camera=camera, stage=stage), np.zeros(p.size)) - still for camera, stage in rigs]
    found = np.zeros((p.size, len(rigs)))
    if rigs:
        seen = np.isfinite(still)
        found[rows] = unit[:, None] * np.linalg.lstsq(moves[:, seen].T, np.array(changes)[:, seen].T, rcond=None)[0]
    return found
