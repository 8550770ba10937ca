"""``points: auto``: the panel as the continuous surface it is.

Per pixel and light five rays, to the panel's corners and centre, distinguish lit from shaded. Where they agree among
themselves and with those of the neighbouring pixels, the panel is wholly visible or wholly hidden. The penumbrae that
remain are worked out by :mod:`lightopt.rendering._penumbra` at some pixels and, where they are smooth, interpolated
between these by :mod:`lightopt.rendering._penumbra_squares`.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.core.vectors import vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, SurfaceLight, panel_grid, panel_numbers
from lightopt.optics import LAMBERT, Reflectance
from lightopt.rendering._panel_quadrature import WHOLE_PANEL, rectangle_diffuse
from lightopt.rendering._penumbra import ConvergedLight, shade_penumbra
from lightopt.rendering._penumbra_squares import SIDES, interpolate, nodes_of, points_in, smooth_squares, squares_with
from lightopt.rendering._point_lights import clear_in_turn, clear_targets, facing_targets, shade_points
from lightopt.rendering._surface import SurfacePoint, SurfacePoints
from lightopt.rendering._surface_light import shade_surface_lights
from lightopt.rendering._whole_panel import add_spread_points, whole_panel
from lightopt.scene import Scene

DIFFUSE_TOLERANCE = 1e-4  # error of the diffuse quadrature per unit of R_d: 0.025 level of 255
PROBE_INSET = 0.98  # the rays to the corners go this far from the panel's centre towards them
PENUMBRA_BATCH = 2048  # penumbra pixels that are shaded at once: some 10 MiB of rays
LEAST_POINTS, MOST_POINTS = 4, 6  # points a side that stand for the panel on variants of a surface

MOST_TOGETHER = 16  # channels of a light that are shaded at once
_TURNS = 18  # ways that a surface may be brushed, of which the brightest is sought
# what the coarse rays of a pixel to a light show: all of the panel below its horizon; nothing in the way but perhaps
# its own face; all of it hidden; a part of it hidden; all of it below the face's own plane
_DARK, _CLEAR, _HIDDEN, _MIXED, _TURNED = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class ConvergedPanel:
    """A panel with the quadrature that it needs for a part."""

    light: PanelLight
    nodes: int  # Gauss–Legendre nodes a side for light that varies as its direction, fall-off and emission do
    least_distance: float  # from the panel's centre to the sphere around the part [mm]; 0 inside it
    # a side, of which each has a place that stands for it under light that rays gather, another one for each point; 0
    # where these take the whole panel, too
    cells: int = 0

    def points_for(self, sigma: float) -> int | None:
        """Points k² that stand for the panel to a few per cent of the lobe's change; None where that takes too many.

        Midpoints of cells integrate a Gaussian lobe to 1e-4 where the half vectors of neighbours, which turn by half
        of what the directions to them do, are no further apart than σ; what remains is of cells at the panel's sides.

        sigma: Of the narrowest lobe [rad]
        """
        if self.least_distance <= 0.0:
            return None
        k = max(LEAST_POINTS, math.ceil(0.5 * max(self.light.size) / (self.least_distance * sigma)))
        return k * k if k <= MOST_POINTS else None


@dataclass(frozen=True, eq=False)
class PanelVisibility:
    """What k surface points see of a panel."""

    coarse: UInt8  # by the coarse rays: _DARK, _CLEAR, _HIDDEN or _MIXED, shape (k,)
    penumbra: Bool  # whether the point was shaded as one in a penumbra, shape (k,)


Shaded = tuple[Float64, Float64, PanelVisibility | None]


def panel_to_shade(panel: PanelLight, caster: RayCaster) -> PanelLight | ConvergedPanel:
    """A panel with the points that its file has, or converged where these are ``auto``; other lights as they are.

    panel: Part frame
    caster: Of the part, whose bounding sphere the diffuse quadrature is chosen for
    """
    if panel.points != "auto" or isinstance(panel, SurfaceLight):
        return panel
    return converged_panel(panel, centre=caster.centre, radius=caster.radius)


def shade_light(
    surface: SurfacePoints, light: PanelLight, *, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a panel of points or of another light, per unit of R_d and R_s, shapes (k,).

    light: Part frame, as from :func:`panel_to_shade`
    """
    if isinstance(light, SurfaceLight):
        diffuse, specular = shade_surface_lights(surface, (light,), reflectance=reflectance, caster=caster)
        return diffuse[0], specular[0]
    assert light.points != "auto"
    return shade_points(surface, light, points=light.points, reflectance=reflectance, caster=caster)


def converged_panel(light: PanelLight, *, centre: Float64, radius: float) -> ConvergedPanel:
    """Choose the diffuse quadrature of a panel by trying it on surface points all over a part.

    light: Part frame
    centre, radius: Sphere around the part, part frame [mm]
    """
    towards = light.centre - centre
    towards = towards / np.linalg.norm(towards)
    positions = centre + radius * np.array([*itertools.product((-0.57, 0.57), repeat=3)])
    # facing the panel, leaning, and so steep that the panel reaches below the horizon
    leanings = [a * side for side in (light.across, light.along) for a in (1.5, 5.0, -5.0)]
    normals = np.array([towards, *(towards + leaning for leaning in leanings)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    panel, count = panel_numbers(light), 0
    exact = _diffuse_all_over(positions, normals, panel, 24)
    for count in (2, 3, 4, 6, 8, 12, 16, 20):
        if np.abs(_diffuse_all_over(positions, normals, panel, count) - exact).max() <= DIFFUSE_TOLERANCE:
            break
    distance = float(np.linalg.norm(light.centre - centre))
    return ConvergedPanel(light, count, max(0.0, distance - radius))


@kernel
def _diffuse_all_over(positions: Float64, normals: Float64, panel: PanelNumbers, count: int) -> Float64:
    # at all positions with each of the normals, by so many nodes a side
    found = np.empty((len(positions), len(normals)))
    for i in range(len(positions)):
        for j in range(len(normals)):
            p, n = vector_at(positions, i), vector_at(normals, j)
            found[i, j] = rectangle_diffuse(SurfacePoint(p, n, n, 1.0, n), panel, WHOLE_PANEL, LAMBERT, count)
    return found


def shade_converged(
    surface: SurfacePoints,
    converged: ConvergedPanel,
    *,
    sample: Index,
    shape: tuple[int, int],
    reflectance: Reflectance,
    caster: RayCaster | None,
) -> tuple[Float64, Float64, PanelVisibility]:
    """Diffuse and specular light of a whole panel, per unit of R_d and R_s, shape (k,), and what the points see of it.

    sample: Index of each point in the raveled grid of image samples that was traced, shape (k,): shadows are refined
        where neighbours in this grid disagree
    shape: Rows and columns of that grid; the grid's own border has no neighbours beyond it
    reflectance: Its σ shapes the lobe; how finely penumbrae are worked out depends on R_d and R_s, too
    """
    if caster is None:
        coarse = np.where(surface.front, _CLEAR, _DARK).astype(np.uint8)
        uncertain = np.zeros(len(surface), np.bool_)
    else:
        coarse = _classify(surface, converged.light, caster)
        uncertain = _disagreeing(coarse, sample, shape)
    light = _converged_light(converged, reflectance)
    terms = np.zeros((len(surface), 2))
    _add_whole_panel(surface, _unhidden(coarse), light, terms, shadows=caster is not None)
    shaded = np.zeros(len(surface), np.bool_)
    if caster is not None and uncertain.any():
        shaded = _shade_penumbrae(surface, uncertain, light, caster, coarse, sample, shape, terms)
    terms *= converged.light.total_weight
    return terms[:, 0], terms[:, 1], PanelVisibility(coarse, shaded)


def shade_together(
    surface: SurfacePoints,
    lights: Sequence[PanelLight | ConvergedPanel],
    reflectance: Reflectance,
    caster: RayCaster | None,
    *,
    sample: Index,
    shape: tuple[int, int],
    threads: int = 1,
) -> list[Shaded]:
    """Diffuse and specular levels of lights that are one of :func:`channel_groups`, and what the points see of a panel.

    sample, shape: As :func:`shade_converged` takes them
    threads: That work on the points of lights that are no panels
    """
    channels = [light for light in lights if isinstance(light, SurfaceLight)]
    if channels:
        both = shade_surface_lights(surface, channels, reflectance=reflectance, caster=caster, threads=threads)
        return [(reflectance.R_d * d, reflectance.R_s * s, None) for d, s in zip(*both, strict=True)]
    (light,) = lights
    if isinstance(light, ConvergedPanel):
        how: dict[str, Any] = {"sample": sample, "shape": shape, "reflectance": reflectance, "caster": caster}
        diffuse, specular, seen = shade_converged(surface, light, **how)
    else:
        (diffuse, specular), seen = shade_light(surface, light, reflectance=reflectance, caster=caster), None
    return [(reflectance.R_d * diffuse, reflectance.R_s * specular, seen)]


def shade_isolated(
    surface: SurfacePoints,
    panels: Sequence[PanelLight],
    *,
    reflectances: Sequence[Reflectance],
    caster: RayCaster,
    shadows: bool,
    threads: int = 1,
) -> Float64:
    """Level under each light of points that are not neighbours, as images have it [grey level], shape (lights, k).

    panels: Part frame; channels of one light are worked out together
    reflectances: By the points' materials
    threads: That work on the points of such a light
    """
    shaded = [panel_to_shade(panel, caster) for panel in panels]
    return isolated_levels(surface, shaded, reflectances, caster if shadows else None, threads=threads)


def isolated_levels(
    surface: SurfacePoints,
    shaded: Sequence[PanelLight | ConvergedPanel],
    reflectances: Sequence[Reflectance],
    blocker: RayCaster | None,
    *,
    penumbrae: bool = True,
    threads: int = 1,
) -> Float64:
    """As :func:`shade_isolated`, of lights from :func:`panel_to_shade`; without a caster, without shadows.

    penumbrae: Whether panels may be seen in part; otherwise a ray to one of their places, in turn, decides for all
    """
    levels = np.empty((len(shaded), len(surface)))
    for index, some, own in surface.by_material(reflectances):
        # every second place of a row
        sample, shape = 2 * np.arange(len(some)), (1, 2 * len(some))
        for group in channel_groups(shaded):
            lights = [shaded[i] for i in group]
            if penumbrae or isinstance(lights[0], SurfaceLight):
                found = shade_together(some, lights, own, blocker, sample=sample, shape=shape, threads=threads)
                for i, (diffuse, specular, _) in zip(group, found, strict=True):
                    levels[i, index] = diffuse + specular
            else:
                diffuse, specular = _shade_by_one_ray(some, lights[0], own, blocker)
                levels[group[0], index] = own.R_d * diffuse + own.R_s * specular
    return levels


def _shade_by_one_ray(
    surface: SurfacePoints, light: PanelLight | ConvergedPanel, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    # each point sees all of a panel or nothing, by a ray to one of its places in turn
    seen: Bool = surface.front
    if caster is not None:
        seen = clear_in_turn(surface, ray_targets(light), caster)
    terms = np.zeros((len(surface), 2))
    if not isinstance(light, ConvergedPanel):
        index = np.flatnonzero(seen)
        found = shade_light(surface.take(index), light, reflectance=reflectance, caster=None)
        terms[index] = np.stack(found, axis=1)
        return terms[:, 0], terms[:, 1]
    if light.cells:
        add_spread_points(surface.rows, seen, light.cells, _converged_light(light, reflectance), terms)
    else:
        _add_whole_panel(surface, seen, _converged_light(light, reflectance), terms, shadows=caster is not None)
    terms *= light.light.total_weight
    return terms[:, 0], terms[:, 1]


def ray_targets(light: PanelLight | ConvergedPanel) -> Float64:
    """Where shadow rays of points that see all of a light or nothing go to, shape (t, 3)."""
    if isinstance(light, ConvergedPanel):
        return panel_grid(light.light, light.cells**2) if light.cells else probe_targets(light.light)
    return shadow_targets(light)


def shade_changed(
    surface: SurfacePoints,
    light: PanelLight | ConvergedPanel,
    reflectance: Reflectance,
    caster: RayCaster | None,
    *,
    index: Index,
    seen: PanelVisibility | None,
    sample: Index,
    shape: tuple[int, int],
) -> tuple[Float64, Float64]:
    """Diffuse and specular levels of some points of a surface with other normals or another reflectance, shape (j,).

    Where the points as they were are in a penumbra of a converged panel, these are, too; so are those whose own
    horizon, the turned one, makes them differ from their neighbours.

    surface: The j points with their own normals, part frame
    reflectance: Of the j points
    index: Of each among the k points of the surface, shape (j,)
    seen: What the surface sees of the light, from :func:`shade_together`
    sample, shape: Of the k points, as :func:`shade_converged` takes them
    """
    if not isinstance(light, ConvergedPanel):
        diffuse, specular = shade_light(surface, light, reflectance=reflectance, caster=caster)
        return reflectance.R_d * diffuse, reflectance.R_s * specular
    assert seen is not None
    coarse = seen.coarse.copy()
    if caster is None:
        coarse[index] = np.where(surface.front, _CLEAR, _DARK).astype(np.uint8)
    else:
        coarse[index] = _classify(surface, light.light, caster)
    own, numbers, terms = coarse[index], _converged_light(light, reflectance), np.zeros((len(surface), 2))
    _add_whole_panel(surface, _unhidden(own), numbers, terms, shadows=caster is not None)
    if caster is not None:
        uncertain = (_disagreeing(coarse, sample, shape) | seen.penumbra)[index] & (own != _DARK)
        _work_out(surface, uncertain, numbers, caster, terms)
    terms *= light.light.total_weight
    return reflectance.R_d * terms[:, 0], reflectance.R_s * terms[:, 1]


def _converged_light(converged: ConvergedPanel, reflectance: Reflectance) -> ConvergedLight:
    total = converged.light.total_weight
    return ConvergedLight(
        panel_numbers(converged.light),
        total * reflectance.R_d,
        total * reflectance.R_s,
        reflectance.lobe,
        reflectance.diffuse,
        converged.nodes,
    )


def _add_whole_panel(
    surface: SurfacePoints, chosen: Bool, light: ConvergedLight, terms: Float64, *, shadows: bool
) -> None:
    # shadows: whether faces hide what is below their own planes
    rows = surface.rows if shadows else surface.rows._replace(facets=surface.normals)
    whole_panel(rows, np.flatnonzero(chosen).astype(np.int32), light, terms)


def _work_out(surface: SurfacePoints, chosen: Bool, light: ConvergedLight, caster: RayCaster, terms: Float64) -> Bool:
    # works out the chosen points, one by one, into `terms`; returns which of them see the panel in part
    crossed = np.zeros(len(surface), np.bool_)
    index = np.flatnonzero(chosen)
    for start in range(0, len(index), PENUMBRA_BATCH):
        end_if_stopped()
        batch = index[start : start + PENUMBRA_BATCH]
        some = surface.take(batch)
        terms[batch, 0], terms[batch, 1], crossed[batch] = shade_penumbra(some, light, caster)
    return crossed


def _shade_penumbrae(
    surface: SurfacePoints,
    uncertain: Bool,
    light: ConvergedLight,
    caster: RayCaster,
    coarse: UInt8,
    sample: Index,
    shape: tuple[int, int],
    terms: Float64,
) -> Bool:
    # shades the penumbrae that the uncertain points are part of into `terms`; returns which points were shaded
    k = len(surface)
    at = np.full(shape, -1, np.int32)
    at.ravel()[sample] = np.arange(k, dtype=np.int32)
    whole, has_whole = terms.copy(), _unhidden(coarse)
    known, done, crossed = np.zeros(k, np.bool_), np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    pending = uncertain
    while pending.any():
        for side in SIDES:
            corners = squares_with(at, pending, side)
            missing = points_in(at, corners, side, k) & ~has_whole
            _add_whole_panel(surface, missing, light, whole, shadows=True)
            has_whole |= missing
            smooth = smooth_squares(surface.rows, at, corners, side, coarse, whole, light)
            corners = corners[smooth]
            nodes = nodes_of(at, corners, side, k) & ~known
            crossed = np.where(nodes, _work_out(surface, nodes, light, caster, terms), crossed)
            known |= nodes
            done |= nodes
            interpolate(at, corners, side, light, whole, terms, done, crossed)
            pending = pending & ~done
        crossed |= _work_out(surface, pending, light, caster, terms)
        known |= pending
        done |= pending
        # a penumbra goes on until its neighbours, too, see the whole panel or none of it
        pending = _neighbours(crossed, sample, shape) & ~done & (coarse != _DARK)
    return done


def probe_targets(light: PanelLight) -> Float64:
    """Where the coarse rays go: the panel's centre and nearly its corners, shape (5, 3) [mm]."""
    half = 0.5 * PROBE_INSET
    return np.array(
        [
            light.centre + s * light.size[0] * light.across + t * light.size[1] * light.along
            for s, t in ((0.0, 0.0), (-half, -half), (-half, half), (half, -half), (half, half))
        ]
    )


def shadow_targets(light: PanelLight) -> Float64:
    """Where shadow rays to a light go: its points, or the probes of the converged panel; shape (t, 3) [mm]."""
    if isinstance(light, SurfaceLight):
        return light.targets
    return probe_targets(light) if light.points == "auto" else panel_grid(light, light.points)


def panel_probes(surface: SurfacePoints, targets: Float64, caster: RayCaster) -> Bool:
    """Which probes each point's face, whatever its normal, faces and sees, shape (k, 5)."""
    return clear_targets(replace(surface, normals=surface.facets), targets, caster, geometric=False).T.copy()


def _classify(surface: SurfacePoints, light: PanelLight, caster: RayCaster) -> UInt8:
    targets = probe_targets(light)
    facing = facing_targets(surface, targets, geometric=True)
    clear = caster.visible(surface.points, surface.facets, targets, candidates=facing, outside=surface.outside)
    seen, faced = clear.sum(axis=0), facing.sum(axis=0)
    coarse = np.full(len(surface), _MIXED, np.uint8)
    coarse[seen == 0] = _HIDDEN
    coarse[seen == faced] = _CLEAR
    coarse[faced == 0] = _TURNED
    coarse[~facing_targets(surface, targets, geometric=False).any(axis=0)] = _DARK
    return coarse


def _unhidden(coarse: UInt8) -> Bool:
    # points that see all of the panel that is above the planes of their faces
    return (coarse == _CLEAR) | (coarse == _TURNED)


def _disagreeing(coarse: UInt8, sample: Index, shape: tuple[int, int]) -> Bool:
    # points whose rays disagree among themselves or with those of a neighbouring sample
    near_clear = _neighbours((coarse == _CLEAR) | (coarse == _MIXED), sample, shape)
    near_hidden = _neighbours((coarse == _HIDDEN) | (coarse == _MIXED), sample, shape)
    return near_clear & near_hidden & (coarse != _DARK)


def _neighbours(flags: Bool, sample: Index, shape: tuple[int, int]) -> Bool:
    # whether any of the 3 × 3 samples around each point is flagged
    flagged = np.zeros(shape, np.bool_)
    flagged.ravel()[sample] = flags
    across = flagged.copy()
    across[:, 1:] |= flagged[:, :-1]
    across[:, :-1] |= flagged[:, 1:]
    near = across.copy()
    near[1:] |= across[:-1]
    near[:-1] |= across[1:]
    return near.ravel()[sample]


def highlight_level(scene: Scene, light: PanelLight) -> float:
    """Specular level at exposure 1 of a surface at the origin that mirrors a panel's centre [grey level].

    Of the region that is brightest there, and of the panel as a whole, whatever its number of points: R_s is what a
    single point of light would reach. Of a brushed surface, brushed the way that makes it brightest.

    light: World frame
    """
    view = scene.camera.position / np.linalg.norm(scene.camera.position)
    middle = light.targets.mean(axis=0) if isinstance(light, SurfaceLight) else light.centre
    half = view + middle / np.linalg.norm(middle)
    if (length := float(np.linalg.norm(half))) < 1e-9:
        return 0.0  # the light is opposite the camera
    normal = half[None] / length
    turns = math.pi / _TURNS * np.arange(_TURNS if any(one.lobe.widening > 1.0 for one in scene.shown) else 1)
    across = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ np.linalg.svd(normal)[2][1:]
    normals, origin = np.repeat(normal, len(turns), axis=0), np.zeros((len(turns), 3))
    views, front = np.broadcast_to(view, origin.shape).copy(), np.ones(len(turns), np.bool_)
    surface = SurfacePoints(origin, normals, normals, views, front, across=across)
    whole = light if isinstance(light, SurfaceLight) else replace(light, points="auto")
    shaded = light if whole is light else converged_panel(whole, centre=origin[0], radius=1.0)
    at: dict[str, Any] = {"sample": np.arange(len(turns)), "shape": (len(turns), 1)}
    levels = [shade_together(surface, [shaded], own, None, **at)[0][1] for own in scene.shown]
    level = float(np.max(levels))
    return level if whole is light else level * light.total_weight / whole.total_weight


def channel_groups(panels: Sequence[PanelLight | ConvergedPanel]) -> list[list[int]]:
    """Numbers of the lights that are shaded together: channels of one light, unless a programme's weights differ."""
    groups: list[list[int]] = []
    entry: tuple[int, float] | None = None
    for number, panel in enumerate(panels):
        own = (panel.entry, panel.total_weight) if isinstance(panel, SurfaceLight) else None
        if own is not None and own == entry and len(groups[-1]) < MOST_TOGETHER:
            groups[-1].append(number)
        else:
            groups.append([number])
        entry = own
    return groups
