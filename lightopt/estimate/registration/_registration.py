"""Registration: find the placement of a part on the stage from its images.

A shifted and rotated part is not a shifted and rotated image: its normals turn under lights that stay. So the part is
moved, and its pixels are traced anew.

Input: a scene with the part at its file placement, and observations of it. Output: a :class:`Registration`. Steps:

1. `_image_checks`: refuse images that cannot show where the part is.
2. Search by outline and diffuse light, whatever the reflectance.
3. Find out whether the visible surface is a body of revolution, whose rotation is unobservable. The facets of a mesh
   rotate with the model, the real part has none: where nothing but facets determines a rotation, it is undetermined.
4. `_refinement`: robust least squares over the part's inner pixels, and over its outline where those do not determine
   the placement.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.least_squares import Solution, solve
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration import _placement, _refinement
from lightopt.estimate.registration._image_checks import refuse_useless_images, shows_diffuse_light
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._placement import PixelSet, Placement, PoseFrame
from lightopt.geometry import RayCaster
from lightopt.optics import Reflectance
from lightopt.rendering import trace_samples
from lightopt.scene import Scene

# rotations to compare [rad]: within the reach of a registration, and all round, by the golden angle
ROTATIONS = np.concatenate([np.radians([1.9, 3.7, 6.0, 11.0]), np.radians(137.50776) * np.arange(5, 17)])
# facets of a body of revolution are off it by up to one chord error, two of them by up to 1.7 (measured, 24 to 720
# sections); those of spheres of even triangles by up to 2.6
DEPTH_FACTOR = 3.0
# interpolated normals are off by up to a third of the angle that a facet spans about the axis (measured likewise)
NORMAL_FACTOR = 0.5
# and, where facets are of unequal shapes, by up to a tenth of the angle between the normals of their corners (measured
# on a torus and on fillets of a knob as they are found in the wild)
CURVED_FACTOR = 0.15
# differences of depth [px] and of normals [rad] up to these are none: light depends on normals, on depth by parallax
# alone
LEAST_DEPTH_PX, LEAST_ANGLE = 0.1, math.radians(0.05)
AXIS_PRIOR = 1e-4  # weight of the part's middle for the axis, against normals: flat surface has no axis of its own


def unobservable_rotation(
    scene: Scene, frame: PoseFrame, sets: Sequence[PixelSet], pose: Float64, *, caster: RayCaster
) -> Float64:
    """Directions of poses, shape (u, 3), u = 0 or 1, in which a rotation changes only facets at the given pixels.

    The part is rotated about its middle, and about the axis to which its normals point. A pixel sees the same surface
    where its depth along the normal and its normal differ by no more than two facets may be off a common body of
    revolution: r (1 − cos Δφ/2) of their azimuthal extent Δφ; Δφ/2, or a share of the angle between the normals of
    their corners. One pixel that sees more, such as a flat, a key, a hole, or nothing, makes the rotation observable.
    """
    if not sets or scene.mesh.normals is None:
        return np.zeros((0, 3))
    nominal = [_trace(scene, frame, pixels, pose, caster) for pixels in sets]
    fitted = _axis(np.concatenate([n.points for n in nominal]), np.concatenate([n.normals for n in nominal]))

    def is_observable(axis: Float64, rotation: float) -> bool:
        # whether a rotation about an axis of the part, x and y from its middle, changes more than facets
        about, foot = rotation_z(rotation), np.array([*axis, 0.0])
        # the axis stays where the pose has it
        shift = rotation_z(float(pose[2])) @ (foot - about @ foot)
        rotated = pose.copy()
        rotated[:3] += np.array([shift[0], shift[1], rotation])
        return any(
            _differs(before, _trace(scene, frame, pixels, rotated, caster).rotated(about, foot), frame.pixel)
            for pixels, before in zip(sets, nominal, strict=True)
        )

    # normals of coarse facets are less exact than the bounding box, unless that is of an odd number of sections
    for axis in (np.zeros(2), fitted):
        if not any(is_observable(axis, float(rotation)) for rotation in ROTATIONS):
            return np.array([[axis[1], -axis[0], 1.0]])
    return np.zeros((0, 3))


@dataclass(frozen=True)
class _Surface:
    """What n pixels see: points from the part's middle and normals, in the part's axes; how far off facets may be."""

    points: Float64
    normals: Float64
    depth: Float64  # chord error of the facets [mm], shape (n,)
    angle: Float64  # their azimuthal extent [rad], shape (n,)
    bend: Float64  # greatest difference of their corners' normals [rad], shape (n,)

    def rotated(self, about: Float64, foot: Float64) -> "_Surface":
        return replace(self, points=(self.points - foot) @ about.T + foot, normals=self.normals @ about.T)


def _differs(before: _Surface, after: _Surface, pixel: float) -> bool:
    # whether any pixel sees more than other facets of the same body of revolution
    if len(after.points) != len(before.points):
        return True
    slope = np.hypot(before.normals[:, 0], before.normals[:, 1])
    depth = DEPTH_FACTOR * slope * np.minimum(before.depth, after.depth)
    angle = NORMAL_FACTOR * slope * np.minimum(before.angle, after.angle)
    angle += CURVED_FACTOR * np.minimum(before.bend, after.bend)
    off = np.abs(np.einsum("ij,ij->i", after.points - before.points, before.normals))
    differ = np.linalg.norm(after.normals - before.normals, axis=1)
    return bool(np.any((off > depth + LEAST_DEPTH_PX * pixel) | (differ > angle + LEAST_ANGLE)))


def _trace(scene: Scene, frame: PoseFrame, pixels: PixelSet, pose: Float64, caster: RayCaster) -> _Surface:
    # what is seen in a pose by those of the pixels that see the part
    place, middle = frame.placement(pose), np.array([*(scene.pivot + frame.middle)[:2], 0.0])
    view = _placement.view_of_placed(scene, pixels.posture, place)
    hits, surface = trace_samples(caster, scene.mesh, view.camera, *pixels.positions)
    vertices, normals = scene.mesh.vertices, scene.mesh.normals
    assert normals is not None
    faces = scene.mesh.faces[hits.face]
    facets = _facets((vertices[faces] - middle)[:, :, :2], normals[faces], 1e-6 * frame.radius)
    return _Surface(surface.points - middle, surface.normals, *facets)


def _facets(corners: Float64, normals: Float64, least: float) -> tuple[Float64, Float64, Float64]:
    # of facets: chord error r (1 − cos Δφ/2) [mm], azimuthal extent Δφ [rad], and how far their normals bend [rad]
    radius = np.linalg.norm(corners, axis=2)
    # a corner on the axis has no azimuth
    off = radius > least
    unit = corners / np.where(off, radius, 1.0)[:, :, None]
    angle, bend = np.zeros(len(corners)), np.zeros(len(corners))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        cosine = np.clip(np.einsum("ij,ij->i", unit[:, a], unit[:, b]), -1.0, 1.0)
        angle = np.maximum(angle, np.where(off[:, a] & off[:, b], np.arccos(cosine), 0.0))
        bend = np.maximum(bend, np.linalg.norm(normals[:, a] - normals[:, b], axis=1))
    return radius.max(axis=1, initial=0.0) * (1.0 - np.cos(0.5 * angle)), angle, bend


def _axis(points: Float64, normals: Float64) -> Float64:
    # least squares: the vertical axis next to the lines along the normals [mm]
    across = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
    moment = np.einsum("ij,ij->i", across, points[:, :2])
    prior = AXIS_PRIOR * max(len(points), 1) * np.eye(2)
    return np.linalg.solve(across.T @ across + prior, across.T @ moment)


_log = logging.getLogger("lightopt.estimate")
FIRST_SHIFT_MM = 2.5  # the search begins at the best of the nominal place and of eight this far around it
# residuals beyond this share of a typical lit level count alike: highlights are not modelled while searching
TRUNCATED = 0.4
LEAST_DIFFUSE, LEAST_LIT = 0.2, 50
FIRST_STEP_MM, FIRST_STEP_RAD = 1.0, math.radians(1.0)
SEARCH_STEPS = 80
# of all postures together, and of each; fewer are enough under lights that are no panels, of which each takes longer
SEARCH_PIXELS, LEAST_SEARCH_PIXELS, FEW_SEARCH_PIXELS = 8000, 1000, 2000
# penalty of a rotation by this much: it decides where the images do not, for a body of revolution
LIKELY_TURN_RAD, TURN_PULL = math.radians(2.0), 1e-4
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
        scene = replace(scene, reflectance=reflectance_at(_placement.place_part(scene, start)))
    return refine_placement(scene, observations, start, caster=caster, reduced=reduced, run=run)


def _search_placement(scene: Scene, sets: Sequence[PixelSet], caster: RayCaster, run: RunContext) -> Placement:
    # by its outline and its diffuse light, to about a pixel, without knowing its reflectance: a simplex search (Nelder
    # and Mead 1965, doi:10.1093/comjnl/7.4.308) within the greatest shift and turn
    from scipy import optimize  # takes long to load, and a capture seldom needs it

    # height and tilt are left to the refinement
    frame, progress = replace(PoseFrame.of(scene), freedoms=3), run.stage("registering the part")
    most = SEARCH_PIXELS if scene.panels_only else FEW_SEARCH_PIXELS
    sets = [pixels.some(max(LEAST_SEARCH_PIXELS, most // len(sets))) for pixels in sets]
    if not shows_diffuse_light(scene, sets, caster=caster, threads=run.threads):
        # polished: highlights would be taken for diffuse light, and the part for lying elsewhere
        return Placement()
    done = 0

    def misfit(pose: Float64) -> float:
        nonlocal done
        done += 1
        progress(min(1.0, done / SEARCH_STEPS))
        place = frame.placement(pose)
        lit: list[Float64] = []
        seen: list[Float64] = []
        for pixels in sets:
            view = _placement.view_of_placed(scene, pixels.posture, place)
            diffuse, _ = _placement.light_at(scene, pixels, view, caster, threads=run.threads)
            scales = np.array([[_placement.sensor_scale(scene, image)] for image in pixels.images])
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
    start, bounds = best / size, list(zip(-reach, reach, strict=True))
    simplex = [start, *(start + step for step in np.eye(3))]
    options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": np.inf, "maxfev": SEARCH_STEPS - len(values)}
    found = optimize.minimize(lambda u: misfit(u * size), start, method="Nelder-Mead", bounds=bounds, options=options)
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
    x, own = _refinement.start_parameters(scene, frame, start), slice(0, frame.freedoms)
    limits = _refinement.parameter_limits(scene, frame, x)
    solution: Solution | None = None
    outline = False
    iterations, moved = 0, math.inf
    number, stages = 0, STAGES
    while number < stages:
        # each pixel takes longer under lights that are no panels, of which there are channels, too
        place, few = frame.placement(x[own]), reduced or number == 0 or not scene.panels_only
        inner, edges = _refinement.choose_pixels(
            scene, observations, place, outline=outline, reduced=few, threads=run.threads
        )
        if number == 0:
            hidden = unobservable_rotation(scene, frame, inner, x[own], caster=caster)
            limits = replace(limits, undetermined=np.pad(hidden, ((0, 0), (0, len(x) - 3))))
        problem = _refinement.RefinementProblem(scene, frame, inner, edges, x, caster=caster, threads=run.threads)
        solution = solve(problem, x, limits, most_iterations=STAGE_ITERATIONS)
        iterations += solution.iterations
        moved = frame.distance_px(place, frame.placement(solution.x[own]))
        progress((number + 1) / (STAGES + OUTLINE_STAGES))
        if not outline and np.any(solution.errors[own] > _refinement.OUTLINE_PX * frame.pixel_steps):
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
        _convergence_warnings(solution, frame, iterations, moved) if len(directions) < frame.freedoms else ()
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
        reach = f"{frame.reach[0]:g} mm and {math.degrees(frame.reach[2]):g}°"
        further = f"the part was searched up to {reach} from its nominal placement, and seems to be further away"
        return (f"{further}; correct its placement in the part file",)
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
