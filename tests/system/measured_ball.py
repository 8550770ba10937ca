"""Images of a ball that neither the renderer nor the reflection model of this project has made: closed form, NumPy.

A sphere under distant lights, seen by a pinhole camera. The surface is like measured ones: two lobes with the tails of
GGX (Walter et al. 2007, doi:10.2312/EGWR/EGSR07/195-206), diffuse light that falls off like cos^1.12, noise.
Beside it, the three-parameter model of the project written anew, and its best fit by plain SciPy from many starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation

RADIUS = 20.0
DISTANCE = 550.0
IMAGE_DISTANCE = 55.0
LIGHT_DISTANCE = 20_000.0

RIG = """\
format: lightopt-rig/1
name: distant-lights
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [{size}, {size}]
  pixel_size_um: {pixel}
  image_distance_mm: 55
  sensor: {{bit_depth: {bits}, read_noise_levels: {noise}}}
light_source: {{size_mm: [1, 1], points: 1}}
lights:
{lights}
stage: {{elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}}
"""

PART = """\
format: lightopt-part/1
name: ball
mesh: {file: ball.obj, units: mm}
placement: {anchor: as_modelled}
postures: [{elevation_deg: 0, rotation_deg: 0}]
reflectance: {R_d: 30, R_s: 1000, sigma_rad: 0.1}
"""


@dataclass(frozen=True)
class Surface:
    """Diffuse level and exponent; per lobe its level at the peak and the roughness of GGX."""

    diffuse: float = 60.0
    exponent: float = 1.12
    lobes: tuple[tuple[float, float], ...] = ((260.0, 0.055), (35.0, 0.22))


def hemisphere(count: int) -> np.ndarray:
    """Elevation and azimuth [deg] of lights spread over the upper hemisphere, from 25° up; shape (count, 2).

    Golden-angle spiral, in an order in which each first part is spread as well.
    """
    i = np.arange(count)
    height = math.sin(math.radians(25.0)) + (1.0 - math.sin(math.radians(25.0))) * (i + 0.5) / count * 0.98
    azimuth = np.degrees(i * math.pi * (3.0 - math.sqrt(5.0))) % 360.0
    order = np.argsort((i * 0.6180339887498949) % 1.0, kind="stable")
    return np.stack([np.degrees(np.arcsin(height)), azimuth], axis=1)[order].round(3)


class Ball:
    """The ball under distant lights, `size` × `size` px; `angles` in degrees, shape (L, 2)."""

    def __init__(self, angles: np.ndarray, *, size: int = 100) -> None:
        self.angles, self.size = angles, size
        self.pixel_mm = 2.2 * RADIUS * IMAGE_DISTANCE / (DISTANCE - RADIUS) / size
        centre = (np.arange(size) + 0.5 - 0.5 * size) * self.pixel_mm
        ray = np.stack(np.broadcast_arrays(centre[None, :], -centre[:, None], -IMAGE_DISTANCE), axis=-1)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        eye = np.array([0.0, 0.0, DISTANCE])
        b = ray @ eye
        under = b * b - (DISTANCE**2 - RADIUS**2)
        self.hit = under > 0.0
        point = eye + (-b - np.sqrt(np.maximum(under, 0.0)))[..., None] * ray
        normal, view = (point / RADIUS)[self.hit], -ray[self.hit]
        elevation, azimuth = np.radians(angles).T
        lights = LIGHT_DISTANCE * np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
        )
        # geometry of the pixels that show the ball, per light: shape (L, P)
        towards = lights[:, None] - point[self.hit][None]
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        half = towards + view
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        self.cos_in = np.clip(np.einsum("lpi,pi->lp", towards, normal), 0.0, 1.0)
        self.cos_out = np.maximum(np.einsum("pi,pi->p", view, normal), 0.01)
        self.delta = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(half - normal, axis=-1), 0.0, 1.0))

    def light(self, surface: Surface) -> np.ndarray:
        """Grey levels of the measured-like surface, shape (L, P)."""
        value = surface.diffuse * self.cos_in**surface.exponent
        for level, alpha in surface.lobes:
            t = np.tan(np.minimum(self.delta, 1.5)) / alpha
            value += np.where(self.cos_in > 0.0, level / (1.0 + t * t) ** 2 / self.cos_out, 0.0)
        return value

    def model(self, x: np.ndarray, lights: np.ndarray) -> np.ndarray:
        """The project's reflection model written anew: R_d, ln R_s, ln σ; grey levels, shape (lights, P)."""
        lobe = np.exp(-0.5 * (self.delta[lights] / math.exp(x[2])) ** 2) / self.cos_out
        return x[0] * self.cos_in[lights] + np.where(self.cos_in[lights] > 0.0, math.exp(x[1]) * lobe, 0.0)

    def shoot(self, surface: Surface, *, bits: int, noise: float, seed: int, exposure: float = 1.0) -> np.ndarray:
        """What a camera delivers, shape (L, P)."""
        top = 2**bits - 1
        level = exposure * self.light(surface) * top / 255.0
        level += noise * np.random.default_rng(seed).standard_normal(level.shape)
        return np.clip(np.floor(level + 0.5), 0, top)

    def write(self, folder: Path, *, bits: int = 8, noise: float = 1.0) -> None:
        """Rig, part and a fine mesh of the ball."""
        lights = "\n".join(
            f"  - {{name: light{i}, distance_mm: {LIGHT_DISTANCE:g}, elevation_deg: {e}, azimuth_deg: {a}}}"
            for i, (e, a) in enumerate(self.angles)
        )
        pixel = 1000.0 * self.pixel_mm
        text = RIG.format(size=self.size, pixel=f"{pixel:.9g}", bits=bits, noise=noise, lights=lights)
        (folder / "rig.yaml").write_text(text, encoding="utf-8")
        (folder / "part.yaml").write_text(PART, encoding="utf-8")
        rows, columns = 90, 180
        polar = math.pi * np.arange(rows + 1) / rows
        around = 2.0 * math.pi * np.arange(columns) / columns
        points = RADIUS * np.stack(
            [
                np.outer(np.sin(polar), np.cos(around)),
                np.outer(np.sin(polar), np.sin(around)),
                np.outer(np.cos(polar), np.ones(columns)),
            ],
            axis=-1,
        )
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points[1:-1].reshape(-1, 3)]
        lines += [f"v 0 0 {RADIUS}", f"v 0 0 -{RADIUS}"]
        count = (rows - 1) * columns

        def at(row: int, column: int) -> int:
            return row * columns + column % columns + 1

        for column in range(columns):
            lines.append(f"f {count + 1} {at(0, column)} {at(0, column + 1)}")
            lines.append(f"f {count + 2} {at(rows - 2, column + 1)} {at(rows - 2, column)}")
            for row in range(rows - 2):
                a, b, c, d = (at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1))
                lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        (folder / "ball.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def observations(self, levels: np.ndarray, lights, *, bits: int) -> tuple[Observation, ...]:
        """Delivered images of some lights."""
        images = []
        for light in lights:
            image = np.zeros((self.size, self.size), np.float32)
            image[self.hit] = levels[light]
            images.append(
                Observation(
                    light=f"light{light}",
                    posture=Posture(0.0, 0.0),
                    exposure=1.0,
                    levels=image,
                    saturated=image >= 2**bits - 1,
                    half_width=0.5,
                    source=Path("made-by-test.png"),
                )
            )
        return tuple(images)

    def rms(self, x: np.ndarray, levels: np.ndarray, lights, *, bits: int) -> float:
        """Of measured minus predicted level over all pixels of the ball, both clipped, in 255ths."""
        top = 2**bits - 1
        model = np.clip(self.model(x, np.asarray(lights)) * top / 255.0, 0.0, top)
        return float(np.sqrt(np.mean((levels[lights] - model) ** 2))) * 255.0 / top

    def best_fit(self, levels: np.ndarray, lights, *, bits: int) -> tuple[np.ndarray, float]:
        """Least squares of clipped levels over all pixels by SciPy, the best of many starts; parameters and rms."""
        lights = np.asarray(lights)
        top = 2**bits - 1
        measured = levels[lights] * 255.0 / top

        def residual(x: np.ndarray) -> np.ndarray:
            return (np.clip(self.model(x, lights), 0.0, 255.0) - measured).ravel()

        found = [
            least_squares(
                residual,
                [r_d, math.log(r_s), math.log(sigma)],
                bounds=([0.0, -3.0, math.log(1e-3)], [300.0, 25.0, math.log(0.6)]),
                x_scale=[10.0, 1.0, 0.3],
                diff_step=1e-4,
                max_nfev=40,
            )
            for r_d in (50.0,)
            for r_s in (150.0, 800.0)
            for sigma in (0.01, 0.03, 0.06, 0.12, 0.25)
        ]
        best = min(found, key=lambda one: one.cost)
        return best.x, self.rms(best.x, levels, lights, bits=bits)
