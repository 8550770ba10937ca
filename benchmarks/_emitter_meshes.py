"""Meshes of emitters, from the numbers of the rig file: the other side of ``benchmarks.light_kinds``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import LightConfig

Array = NDArray[Any]
FINE = 720  # edges of a mesh around a full turn


@dataclass(frozen=True)
class Mesh:
    """Triangles of an emitter that shine to the origin: [mm], shapes (n, 3) and (f, 3); radiance of the whole light."""

    vertices: Array
    faces: Array
    factor: float = 1.0

    def solid_angle(self) -> float:
        """Of all triangles as seen from the origin [sr]; Van Oosterom & Strackee 1983, doi:10.1109/TBME.1983.325207."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        triple = np.abs(np.sum(a * np.cross(b, c), axis=1))
        below = la * lb * lc + np.sum(a * b, axis=1) * lc + np.sum(a * c, axis=1) * lb + np.sum(b * c, axis=1) * la
        return float(2.0 * np.arctan2(triple, below).sum())

    def standing(self, rotation: Array, centre: Array) -> Mesh:
        """In the world, each triangle turned so that its normal is on the side of the origin."""
        vertices = self.vertices @ rotation.T + centre
        a, b, c = (vertices[self.faces[:, k]] for k in range(3))
        away = np.sum(np.cross(b - a, c - a) * (a + b + c), axis=1) > 0.0
        faces = np.where(away[:, None], self.faces[:, ::-1], self.faces)
        return Mesh(vertices, faces, self.factor)


def _sheet(at: Callable[[Array, Array], tuple[Any, Any, Any]], u: Array, v: Array) -> Mesh:
    places = np.stack(np.broadcast_arrays(*at(*np.meshgrid(u, v, indexing="ij"))), axis=-1)
    corner = np.arange(places[..., 0].size).reshape(places.shape[:2])
    a, b, c, d = (some.ravel() for some in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices = places.reshape(-1, 3)
    start, second, third = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(second - start, third - start), axis=1)
    return Mesh(vertices, faces[area > 0.0])


def _rectangle(width: float, height: float, x: float = 0.0, y: float = 0.0) -> Mesh:
    ends = np.array([-0.5, 0.5])
    return _sheet(lambda u, v: (u, v, 0.0), x + width * ends, y + height * ends)


def emitter_meshes(light: LightConfig) -> tuple[list[Mesh], list[Mesh]]:
    """Of the channel and of the whole light; x along the azimuth, y along the elevation, z away from the part."""
    words: dict[str, Any] = light.model_dump(exclude_none=True)
    segments, channel = words.get("segments", 1), light.channel
    width, height = words.get("size_mm", (0.0, 0.0))
    hole = 0.5 * words.get("camera_hole_mm", 0.0)
    step = 2.0 * np.pi / segments

    def turns(at: Callable[[Array, Array], tuple[Any, Any, Any]], v: Array) -> list[Mesh]:
        around = np.linspace(0.0, step, FINE // segments + 1)
        return [_sheet(at, around + k * step, v) for k in range(segments)]

    match light.kind:
        case "ring":
            inner, outer = words["inner_radius_mm"], words["outer_radius_mm"]
            rise = np.tan(np.radians(words.get("ring_tilt_deg", 0.0)))
            middle = 0.5 * (inner + outer)
            ends = np.array([inner, outer])
            parts = turns(lambda u, v: (v * np.cos(u), v * np.sin(u), (middle - v) * rise), ends)
        case "low_angle_ring":
            radius, ends = words["radius_mm"], 0.5 * words["height_mm"] * np.array([-1.0, 1.0])
            parts = turns(lambda u, v: (radius * np.cos(u), radius * np.sin(u), v), ends)
        case "dome":
            radius, low = words["radius_mm"], np.radians(words.get("lower_elevation_deg", 0.0))
            parts = turns(
                lambda u, v: tuple(radius * x for x in (np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v))),
                np.linspace(low, np.arccos(hole / radius), FINE // 4 + 1),
            )
            leak = words.get("leak", 0.0)
            shares = [leak / segments + (1.0 - leak) * (k == channel) for k in range(segments)]
            own = [Mesh(part.vertices, part.faces, share) for part, share in zip(parts, shares, strict=True) if share]
            return own, parts
        case "spot":
            radius = words["distance_mm"] * np.tan(np.radians(words["half_angle_deg"]))
            parts = turns(lambda u, v: (v * np.cos(u), v * np.sin(u), 0.0), np.array([0.0, radius]))
        case "tunnel":
            radius, ends = words["radius_mm"], 0.5 * words["length_mm"] * np.array([-1.0, 1.0])
            cut = np.arcsin(0.5 * words.get("slot_mm", 0.0) / radius)
            halves = [(0.0, 0.5 * np.pi - cut), (0.5 * np.pi + cut, np.pi)]
            arcs = [np.linspace(*half, FINE // 4 + 1) for half in halves]
            parts = [_sheet(lambda u, v: (v, radius * np.cos(u), radius * np.sin(u)), arc, ends) for arc in arcs]
            return parts, parts
        case "led_array":
            columns, rows, led = words["columns"], words["rows"], words["led_mm"]
            at = [((i + 0.5) / columns - 0.5, (j + 0.5) / rows - 0.5) for j in range(rows) for i in range(columns)]
            parts = [_rectangle(led, led, width * x, height * y) for x, y in at]
        case "flat_dome":
            # straight out from the hole to the sides, the corners among the directions
            corner = np.arctan2(height, width)
            corners = [corner, np.pi - corner, np.pi + corner, 2.0 * np.pi - corner]
            around = np.union1d(np.linspace(0.0, 2.0 * np.pi, FINE + 1), corners)

            def out(u: Array, v: Array) -> tuple[Array, Array, float]:
                edge = 0.5 / np.maximum(np.abs(np.cos(u)) / width, np.abs(np.sin(u)) / height)
                rho = hole + v * (edge - hole)
                return rho * np.cos(u), rho * np.sin(u), 0.0

            parts = [_sheet(out, around, np.array([0.0, 1.0]))]
        case _:
            parts = [_rectangle(width, height)]
    return [parts[channel if len(parts) > 1 else 0]], parts
