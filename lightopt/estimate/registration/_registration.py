"""Registration: find the placement of a part on the stage from its images.

A shifted and rotated part is not a shifted and rotated image: its normals turn under lights that stay. So the part is
moved, and its pixels are traced anew.

Input: a scene with the part at its file placement, and observations of it. Output: a :class:`Registration`. Steps:

1. `_image_checks`: refuse images that cannot show where the part is.
2. Search by outline and diffuse light, whatever the reflectance.
3. `_refinement`: robust least squares over the part's inner pixels, and over its outline where those do not determine
   the placement. `_revolution` finds out beforehand whether a rotation is observable at all.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.least_squares import Solution, solve
from lightopt.core.run_context import RunContext
from lightopt.estimate.registration._image_checks import refuse_useless_images
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._pixels import PixelSet, light_at, sensor_scale, view_of_placed
from lightopt.estimate.registration._placement import Placement, PoseFrame, place_part
from lightopt.estimate.registration._refinement import (
    OUTLINE_PX,
    RefinementProblem,
    choose_pixels,
    parameter_limits,
    start_parameters,
)
from lightopt.estimate.registration._revolution import unobservable_rotation
from lightopt.geometry import RayCaster
from lightopt.optics import Reflectance
from lightopt.scene import Scene

_log = logging.getLogger("lightopt.estimate")

FIRST_SHIFT_MM = 2.5  # the search begins at the best of the nominal place and of eight this far around it

# residuals beyond this share of a typical lit level count alike: highlights are not modelled while searching
TRUNCATED = 0.4

LEAST_DIFFUSE = 0.2
LEAST_LIT = 50
FIRST_STEP_MM, FIRST_STEP_RAD = 1.0, math.radians(1.0)
SEARCH_STEPS = 80
LIKELY_TURN_RAD = math.radians(2.0)
TURN_PULL = 1e-4  # penalty of a rotation by this much: it decides where the images do not, for a body of revolution

STAGES = 4  # pixels are chosen anew where the part moved, so many times at most

# of the stages, so many use the outline at least, once it is used: more than `STAGES` where it is late
OUTLINE_STAGES = 2

STAGE_ITERATIONS = 15  # steps of each: images that show this part take about ten, others never settle
SETTLED_PX = 0.5  # a part that moved by less than this keeps its pixels
ALONG_AXIS = 0.9  # a direction is named by a parameter that has this share of it


@dataclass(frozen=True, kw_only=True)
class Registration:
    """A placement and how well the images determine it."""

    placement: Placement
    # standard errors of the shift of the part's middle in x and y [mm], of the turn about it [rad], and of height [mm]
    # and tilts [rad] where these are searched; those of the placement are larger off the stage's axis
    pose_errors: tuple[float, ...]
    # whether a further step would change nothing, the part kept its place in the last stage, and the place is none of
    # the furthest allowed
    converged: bool = True
    iterations: int = 0
    # robust cost per pixel where the last stage began and where it ended
    cost_before: float = 0.0
    cost_after: float = 0.0
    outline: bool = False
    warnings: tuple[str, ...] = ()  # directions that the images do not determine, or a search that did not converge

    def as_dict(self) -> dict[str, bool | int | float]:
        """JSON form, without the placement."""
        return {
            "converged": self.converged,
            "iterations": self.iterations,
            "cost_per_pixel_before": float(f"{self.cost_before:.6g}"),
            "cost_per_pixel_after": float(f"{self.cost_after:.6g}"),
            "by_outline": self.outline,
        }


def register(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    reflectance_at: Callable[[Scene], Reflectance] | None = None,
    reduced: bool = False,
    run: RunContext | None = None,
) -> Registration:
    """Find the part's placement on the stage.

    scene: The part at its file placement, with the lights and postures of the observations.
    reflectance_at: A reflectance for the refinement, given the scene with the part placed by the coarse search; that of
        the scene by default.
    reduced: Whether fewer pixels are enough, for a placement that is only reported.
    Raises InputError: no pixel to use: the part is outside the view, or all images are saturated or black.
    """
    run = run or RunContext()
    sets = refuse_useless_images(scene, observations, caster=caster, threads=run.threads)
    start = _search_placement(scene, sets, caster, run)
    if reflectance_at is not None:
        scene = replace(scene, reflectance=reflectance_at(place_part(scene, start)))
    return refine_placement(scene, observations, start, caster=caster, reduced=reduced, run=run)


def _search_placement(scene: Scene, sets: Sequence[PixelSet], caster: RayCaster, run: RunContext) -> Placement:
    # by its outline and its diffuse light, to about a pixel, without knowing its reflectance: a simplex search (Nelder
    # and Mead 1965, doi:10.1093/comjnl/7.4.308) within the greatest shift and turn
    from scipy import optimize  # takes long to load, and a capture seldom needs it

    # height and tilt are left to the refinement
    frame, progress = replace(PoseFrame.of(scene), freedoms=3), run.stage("registering the part")
    done = 0

    def misfit(pose: Float64) -> float:
        nonlocal done
        done += 1
        progress(min(1.0, done / SEARCH_STEPS))
        place = frame.placement(pose)
        lit: list[Float64] = []
        seen: list[Float64] = []
        for pixels in sets:
            view = view_of_placed(scene, pixels.posture, place)
            diffuse, _ = light_at(scene, pixels, view, caster, threads=run.threads)
            scales = np.array([[sensor_scale(scene, image)] for image in pixels.images])
            known = np.isfinite(diffuse)
            lit.append((diffuse * scales)[known])
            seen.append(pixels.levels[known])
        light, level = np.concatenate(lit), np.concatenate(seen)
        bright = light > LEAST_DIFFUSE * max(float(light.max(initial=0.0)), 1e-9)
        if np.count_nonzero(bright) < LEAST_LIT:
            return 1e3
        r_d = float(np.median(level[bright] / light[bright]))
        typical = max(r_d * float(np.median(light[bright])), 1.0)
        off = float(np.mean(np.minimum(np.abs(level - r_d * light), TRUNCATED * typical))) / typical
        return off + TURN_PULL * float(pose[2] / LIKELY_TURN_RAD) ** 2

    around = [FIRST_SHIFT_MM * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(8) * (math.pi / 4.0)]
    poses = [np.zeros(3), *around]
    values = [misfit(pose) for pose in poses]
    best = poses[int(np.argmin(values))]
    size = np.array([FIRST_STEP_MM, FIRST_STEP_MM, FIRST_STEP_RAD])
    reach = frame.reach / size
    # in units of the first steps, so that one tolerance serves shifts and turn
    found = optimize.minimize(
        lambda u: misfit(u * size),
        best / size,
        method="Nelder-Mead",
        bounds=list(zip(-reach, reach, strict=True)),
        options={
            "initial_simplex": [best / size, *(best / size + step for step in np.eye(3))],
            "xatol": 0.02,
            "fatol": np.inf,
            "maxfev": SEARCH_STEPS - len(values),
        },
    )
    pose = np.asarray(found.x, np.float64) * size if float(found.fun) < values[0] else np.zeros(3)
    return frame.placement(pose)


def refine_placement(
    scene: Scene,
    observations: Sequence[Observation],
    start: Placement,
    *,
    caster: RayCaster,
    reduced: bool = False,  # whether all stages have as few pixels as the first
    run: RunContext | None = None,
) -> Registration:
    """Refine a placement that is good to about a pixel, highlights included, to a small part of a pixel.

    R_d, R_s, σ, the lights' gains and the dark level are adjusted as well, since those of a misplaced part are never
    quite right. A pixel counts by the sensor's variance of its level. The model decides which pixels count at all, not
    the noisy level: those just below saturation that are not saturated are the darker ones.
    """
    run = run or RunContext()
    progress = run.stage("refining the registration")
    frame = PoseFrame.of(scene)
    x, own = start_parameters(scene, frame, start), slice(0, frame.freedoms)
    limits = parameter_limits(scene, frame, x)
    solution: Solution | None = None
    outline = False
    iterations, moved = 0, math.inf
    number, stages = 0, STAGES
    while number < stages:
        inner, edges = choose_pixels(
            scene,
            observations,
            frame.placement(x[own]),
            outline=outline,
            reduced=reduced or number == 0,
            threads=run.threads,
        )
        if number == 0:
            hidden = unobservable_rotation(scene, frame, inner, x[own], caster=caster)
            limits = replace(limits, undetermined=np.pad(hidden, ((0, 0), (0, len(x) - 3))))
        problem = RefinementProblem(scene, frame, inner, edges, x, caster=caster, threads=run.threads)
        solution = solve(problem, x, limits, most_iterations=STAGE_ITERATIONS)
        iterations += solution.iterations
        moved = frame.distance_px(frame.placement(x[own]), frame.placement(solution.x[own]))
        progress((number + 1) / (STAGES + OUTLINE_STAGES))
        if not outline and np.any(solution.errors[own] > OUTLINE_PX * frame.pixel_steps):
            # the inner pixels do not determine the place well enough: begin again, with the outline
            outline = True
            x = np.concatenate([frame.pose(start), solution.x[frame.freedoms :]])
            stages = max(stages, number + 1 + OUTLINE_STAGES)
        else:
            x = solution.x
            if number > 0 and moved < SETTLED_PX:
                break
        number += 1
    assert solution is not None
    _log.info("registration: %d iterations, %.3f px in the last stage", iterations, moved)
    return _result(solution, frame, iterations, moved, outline=outline)


def _result(solution: Solution, frame: PoseFrame, iterations: int, moved: float, *, outline: bool) -> Registration:
    # `moved` by so much in the last stage [px]
    own = slice(0, frame.freedoms)
    directions = solution.undetermined[:, own]
    share = np.sum(np.square(directions), axis=0)
    # exactly as in the part file, not but for rounding
    pose = np.where(share > 1.0 - 1e-6, 0.0, solution.x[own])
    not_converged = (
        () if len(directions) == frame.freedoms else _convergence_warnings(solution, frame, iterations, moved)
    )
    known, errors = share <= ALONG_AXIS, solution.errors[own]
    return Registration(
        placement=replace(frame.placement(pose, solution.covariance[own, own]), observable=tuple(map(bool, known))),
        pose_errors=tuple(errors.tolist()),
        converged=not not_converged,
        iterations=iterations,
        cost_before=solution.cost_before,
        cost_after=solution.cost_after,
        outline=outline,
        warnings=(*_undetermined_warnings(directions, share), *not_converged),
    )


def _convergence_warnings(solution: Solution, frame: PoseFrame, iterations: int, moved: float) -> tuple[str, ...]:
    # at most one
    if solution.at_limit[: frame.freedoms].any():
        return (
            f"the part was searched up to {frame.reach[0]:g} mm and {math.degrees(frame.reach[2]):g}° from its nominal "
            "placement, and seems to be further away; correct its placement in the part file",
        )
    if solution.converged and moved < SETTLED_PX:
        return ()
    why = f": its last stage moved the part by {moved:.1f} px"
    if not solution.converged:
        why = f"; the placement is the best of {iterations} steps"
    return (f"the registration did not converge{why}. Its errors may be larger than stated",)


def _undetermined_warnings(directions: Float64, share: Float64) -> tuple[str, ...]:
    # one for each direction in which the images do not determine the placement
    end = "cannot be determined from these images; assumed as in the part file"
    if len(directions) == len(share):
        return (f"the placement of the part {end}",)
    shifts = ("the shift along x", "the shift along y", "the rotation about the rotary axis")
    names = (*shifts, "the height", "the tilt about x", "the tilt about y")[: len(share)]
    named = [name for name, s in zip(names, share, strict=True) if s > ALONG_AXIS]
    if len(named) < len(directions):
        named = []
        for direction in directions:
            mixed = [name for name, part in zip(names, direction, strict=True) if part**2 > 1.0 - ALONG_AXIS]
            named.append(f"a direction between {', '.join(mixed)}")
    return tuple(f"{name} {end}" for name in named)
