"""The defects of a part file, put on the part's surface."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lightopt.config import DefectConfig, PartConfig, PixelPlaceConfig, RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, collected, refuse
from lightopt.core.transforms import Posture
from lightopt.defects import BUILT_IN_CATALOGUE, CatalogueEntry, PlacedDefect, tangent_direction
from lightopt.geometry import RayCaster, SurfaceFinder, SurfacePlace, resolve_hits, surface_place
from lightopt.scene._camera import pixel_directions
from lightopt.scene._scene import Placement, Scene, view_from_part

SNAP_MM = 0.5  # a position in mm is moved to the nearest place of the surface, by at most this much
SNAP_SHARE = 0.02  # and by at most this share of the part's greatest extent
LEAST_SIGMA, MOST_SIGMA = 1e-5, 0.5  # widths of the lobe that part files may give [rad]

_DIGITS = 6


def place_defects(scene: Scene, rig: RigConfig, part: PartConfig) -> tuple[PlacedDefect, ...]:
    """The part's defects on the scene's mesh.

    Raises InputError: For each defect that is not on the part, that no pixel sees where it should, or whose σ no lobe
        can have
    """
    placed: list[PlacedDefect] = []
    problems: list[str] = []
    search = _Search(scene, rig, part)
    for index, defect in enumerate(part.defects):
        where = part.source.at("defects", index, "sigma_factor")
        problems += _sigma_problems(part, defect.shape.sigma_factor, where)
        with collected(problems):
            place = search.find(index, defect)
            x_axis, y_axis = scene.placement.rotation.T[:2]
            angle = math.radians(defect.direction_deg)
            along = tangent_direction(place.normal, angle, x_axis=x_axis, y_axis=y_axis)
            at = {"position": place.point, "normal": place.normal, "along": along}
            placed.append(PlacedDefect(name=defect.name, shape=defect.shape, **at))
    refuse(problems)
    return tuple(placed)


def build_catalogue(part: PartConfig) -> tuple[CatalogueEntry, ...]:
    """Kinds of defect that an inspection is planned for: the part's or built-in; InputError for σ of no lobe."""
    if part.defect_catalogue is None:
        catalogue = BUILT_IN_CATALOGUE
        places = ["the built-in haze"] * len(catalogue)
    else:
        catalogue = tuple(entry.entry for entry in part.defect_catalogue)
        places = [part.source.at("defect_catalogue", i, "sigma_factor") for i in range(len(catalogue))]
    wrong = (_sigma_problems(part, one.shape.sigma_factor, at) for at, one in zip(places, catalogue, strict=True))
    refuse(itertools.chain(*wrong))
    return catalogue


def defect_facts(defects: Sequence[PlacedDefect], placement: Placement) -> list[dict[str, Any]]:
    """What is known of defects, wherever the part lies: JSON form, in the mesh file's coordinates, mm and degrees.

    placement: Of the mesh file in the part frame
    """
    return [
        {
            "name": d.name,
            "kind": d.shape.kind,
            "position_mm": _rounded(placement.to_file(d.position)),
            "normal": _rounded(placement.rotation.T @ d.normal),
            "along": _rounded(placement.rotation.T @ d.along),
            "size_mm": [d.shape.length, d.shape.width],
            "area_mm2": round(d.shape.area, _DIGITS),
            "slope_deg": round(math.degrees(d.shape.slope), _DIGITS),
            "depth_mm": round(d.shape.depth, _DIGITS),
            "R_d_factor": d.shape.R_d_factor,
            "sigma_factor": d.shape.sigma_factor,
        }
        for d in defects
    ]


def outside_stage_range(rig: RigConfig, posture: Posture, *, where: str) -> list[str]:
    """Messages about a posture that the rig's stage cannot take, each beginning with `where`."""
    angles = {"elevation": posture.elevation_deg, "rotation": posture.rotation_deg}
    problems = (angle_outside_range(rig, axis, angle) for axis, angle in angles.items())
    return [f"{where}: {problem}" for problem in problems if problem is not None]


def angle_outside_range(rig: RigConfig, axis: str, angle: float) -> str | None:
    """Message about an angle [°] that the stage's axis, ``elevation`` or ``rotation``, cannot take; else None."""
    key = f"{axis}_range_deg"
    low, high = getattr(rig.stage, key)
    if low <= angle <= high:
        return None
    return f"{axis} {angle:g}° is outside the stage's range {low:g}° to {high:g}° ({rig.source.at('stage', key)})"


@dataclass(frozen=True, eq=False)
class _Search:
    """Finds the places that a part file names on the scene's mesh."""

    scene: Scene
    rig: RigConfig
    part: PartConfig

    @cached_property
    def finder(self) -> SurfaceFinder:
        return SurfaceFinder(self.scene.mesh)

    @cached_property
    def caster(self) -> RayCaster:
        return RayCaster(self.scene.mesh.vertices, self.scene.mesh.faces)

    def find(self, index: int, defect: DefectConfig) -> SurfacePlace:
        if defect.at_pixel is not None:
            return self.seen(self.part.source.at("defects", index, "at_pixel"), defect.at_pixel)
        assert defect.at_mm is not None
        return self.nearest(self.part.source.at("defects", index, "at_mm"), np.array(defect.at_mm, np.float64))

    def nearest(self, where: str, at_mm: Float64) -> SurfacePlace:
        placement, mesh = self.scene.placement, self.scene.mesh
        point = placement.to_part(at_mm)
        place = self.finder.nearest(point)
        distance = float(np.linalg.norm(place.point - point))
        most = min(SNAP_MM, SNAP_SHARE * float(np.max(np.subtract(*mesh.bounds[::-1]))))
        if distance > most:
            near = ", ".join(f"{x:.4g}" for x in placement.to_file(place.point))
            text = f"the nearest, [{near}], is {distance:.3g} mm away; coordinates are those of {self.part.mesh.file}"
            raise InputError(f"{where}: expected a place on the part's surface, within {most:.3g} mm; {text}")
        return place

    def seen(self, where: str, at: PixelPlaceConfig) -> SurfacePlace:
        posture = Posture(elevation_deg=at.posture.elevation_deg, rotation_deg=at.posture.rotation_deg)
        problems = outside_stage_range(self.rig, posture, where=where)
        column, row = at.pixel
        camera, mesh = view_from_part(self.scene, posture).camera, self.scene.mesh
        if column >= camera.width or row >= camera.height:
            size = f"{camera.width} × {camera.height}"
            problems.append(f"{where}: expected a pixel of the image, {size}, found [{column}, {row}]")
        refuse(problems)
        directions = pixel_directions(camera, np.array([column + 0.5]), np.array([row + 0.5]))
        face = self.caster.first_hit(camera.position, directions)
        hits = resolve_hits(face, camera.position, directions, mesh.vertices, mesh.faces)
        pixel = f"in posture {posture} pixel [{column}, {row}]"
        if not len(hits.face):
            raise InputError(f"{where}: {pixel} does not see the part; choose one that does")
        place = surface_place(mesh, int(hits.face[0]), float(hits.u[0]), float(hits.v[0]))
        if place.normal @ directions[0] >= 0.0:
            raise InputError(f"{where}: {pixel} sees the back of a face; choose one that sees the outside")
        return place


def _sigma_problems(part: PartConfig, factor: float, where: str) -> list[str]:
    sigma = part.reflectance.sigma * factor
    if factor == 1.0 or part.reflectance.table is not None or LEAST_SIGMA <= sigma <= MOST_SIGMA:
        return []
    range_text = f"{LEAST_SIGMA:g} to {MOST_SIGMA:g}"
    return [f"{where}: makes sigma {sigma:.3g} rad of {part.reflectance.sigma:g}; expected from {range_text}"]


def _rounded(vector: Float64) -> list[float]:
    return [round(float(x), _DIGITS) + 0.0 for x in vector]
