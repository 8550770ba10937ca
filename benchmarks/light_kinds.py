"""Light of every kind on a curved surface, beside a Monte Carlo of Mitsuba 3 with the same emitter as a mesh.

``python -m benchmarks.light_kinds [--kinds ring dome ...] [--samples N] [--page]``. Needs ``mitsuba`` and an LLVM of 15
or later (``DRJIT_LIBLLVM_PATH``). The emitters are built here from the numbers of the rig file, not from lightopt's
elements. Half of the points of an ellipsoid are in the light's highlight, as a few rays of Mitsuba find it. At each
point Mitsuba samples the emitter for diffuse light, and for specular light the paper's lobe or the emitter, whichever
has less noise.

Differences are shares of the mirror level, the greatest specular level of the points. The noise is that of the mean of
two independent halves. A light passes with |mean| ≤ 5e-4 and rms ≤ 1.2 × noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import RIG
from benchmarks._emitter_meshes import Mesh, emitter_meshes
from benchmarks.inspection import replace_block
from lightopt.config import LightConfig, RigConfig, load_rig
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import MIN_COS_VIEW, Reflectance
from lightopt.rendering import SurfacePoints
from lightopt.rendering._converged_panel import converged_panel, shade_converged
from lightopt.rendering._surface_light import shade_surface_lights
from lightopt.scene import build_lights

Array = NDArray[Any]
FINISHES = {"chrome": 0.003, "satin": 0.0475}
MOST_MEAN, MOST_RMS = 5e-4, 1.2  # share of the mirror level; times the noise
R_D, MIRROR = 45.0, 255.0  # R_d, and the mirror level that R_s is chosen for [grey level]
EYE = np.array([0.0, 0.0, 550.0])
CENTRE, SEMI_AXES = np.array([0.0, 0.0, -10.0]), np.array([30.0, 24.0, 20.0])  # of the ellipsoid [mm]
STEEPEST_DEG = 75.0  # lean of its normals from Z
PILOT_POINTS, PILOT_SAMPLES, BATCH = 400_000, 32, 1 << 22
TEXELS = 4096


@dataclass(frozen=True)
class Case:
    """A light in the words of the rig file, and which of its channels is on."""

    light: dict[str, Any]
    channel: int = 0


def _place(distance: float, elevation: float = 90.0, azimuth: float = 270.0) -> dict[str, Any]:
    return {"distance_mm": distance, "elevation_deg": elevation, "azimuth_deg": azimuth}


_PANEL = {"size_mm": [120, 80], "points": "auto", "falloff": "inverse_square", "emission_exponent": 1}
_QUADRANT = {"radius_mm": 150, "camera_hole_mm": 40, "lower_elevation_deg": 10, "segments": 4, "leak": 0.2}
_RING = {"inner_radius_mm": 40, "outer_radius_mm": 70, "ring_tilt_deg": 20, "segments": 3}
_SINE = {"period_mm": 40, "phases": 4, "directions": ["u"]}
CASES = {
    "panel": Case({"kind": "panel", **_place(250, 50, 30), **_PANEL}),
    "bar": Case({"kind": "bar", **_place(250, 30, 180), "size_mm": [200, 20]}),
    "ring": Case({"kind": "ring", **_place(200), **_RING}, channel=1),
    "low_angle_ring": Case(
        {"kind": "low_angle_ring", **_place(20), "radius_mm": 90, "height_mm": 15, "segments": 2}, channel=1
    ),
    "dome": Case({"kind": "dome", **_place(10), **_QUADRANT}, channel=1),
    "flat_dome": Case({"kind": "flat_dome", **_place(150), "size_mm": [200, 150], "camera_hole_mm": 45}),
    "tunnel": Case({"kind": "tunnel", **_place(20, 90, 30), "radius_mm": 100, "length_mm": 200, "slot_mm": 30}),
    "coaxial": Case({"kind": "coaxial", **_place(250), "size_mm": [80, 80], "transmission": 0.6}),
    "spot": Case({"kind": "spot", **_place(300, 40, 20), "half_angle_deg": 3}),
    "led_array": Case(
        {"kind": "led_array", **_place(200, 60, 0), "size_mm": [200, 100], "rows": 2, "columns": 3, "led_mm": 8},
        channel=1,
    ),
    "display": Case({"kind": "display", **_place(300, 50, 90), "size_mm": [300, 200], "pattern": _SINE}, channel=1),
}


def _frame(words: dict[str, Any]) -> tuple[Array, Array]:
    # axes of a light in columns, and its centre
    e, a = np.radians([words["elevation_deg"], words["azimuth_deg"]])
    outward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    across = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.stack([across, np.cross(outward, across), outward], axis=1), words["distance_mm"] * outward


def placed_meshes(case: Case, config: LightConfig) -> tuple[list[Mesh], list[Mesh]]:
    """Of the channel and of the whole light, where the light stands."""
    rotation, centre = _frame(case.light)
    own, whole = ([mesh.standing(rotation, centre) for mesh in some] for some in emitter_meshes(config))
    return own, whole


class MitsubaLight:
    """An emitter in Mitsuba, and the light that it gives to points."""

    def __init__(self, case: Case, config: LightConfig) -> None:
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_mono")
        dr.set_thread_count(1)
        self._mi, self._dr = mi, dr
        words = case.light
        own, whole = placed_meshes(case, config)
        if config.kind == "panel":
            width, height = words["size_mm"]
            radiance = words["distance_mm"] ** 2 / (width * height)
        else:
            radiance = 1.0 / sum(mesh.solid_angle() for mesh in whole)
        if config.kind == "coaxial":
            radiance *= words.get("transmission", 0.5) * words.get("reflection", 0.5)
        if "pattern" in words:
            shapes = [self._display(words, case.channel, *_frame(words), radiance)]
        else:
            shapes = [self._mesh(mesh, radiance) for mesh in own]
        self._scene = mi.load_dict({"type": "scene"} | {f"shape{k}": shape for k, shape in enumerate(shapes)})

    def _mesh(self, mesh: Mesh, radiance: float) -> Any:
        mi = self._mi
        properties = mi.Properties()
        level = {"type": "uniform", "value": radiance * mesh.factor}
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": level})
        shape = mi.Mesh("emitter", len(mesh.vertices), len(mesh.faces), props=properties)
        values = mi.traverse(shape)
        values["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
        values["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
        values.update()
        return shape

    def _display(self, words: dict[str, Any], channel: int, rotation: Array, centre: Array, radiance: float) -> Any:
        mi, (width, height), pattern = self._mi, words["size_mm"], words["pattern"]
        u = width * ((np.arange(TEXELS) + 0.5) / TEXELS - 0.5)
        image = 0.5 + 0.5 * np.cos(2.0 * np.pi * (u / pattern["period_mm"] - channel / pattern["phases"]))
        data = mi.TensorXf((radiance * image).astype(np.float32)[None, :, None])
        matrix = np.eye(4)
        matrix[:3, :3] = rotation * [0.5 * width, -0.5 * height, -1.0]
        matrix[:3, 3] = centre
        texture = {"type": "bitmap", "data": data, "raw": True, "wrap_mode": "clamp"}
        light = {"type": "area", "radiance": texture}
        return mi.load_dict({"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "emitter": light})

    def at(self, surface: SurfacePoints, sigma: float, samples: int, seed: int, *, diffuse: bool = True) -> Array:
        """Diffuse light per unit of R_d, and specular light per unit of R_s two ways, shape (3, k).

        Specular light by rays of the lobe, and by places of the emitter. Without `diffuse`, the former alone.
        """
        step = max(1, BATCH // samples)
        starts = range(0, len(surface), step)
        found = [
            self._batch(surface.take(np.arange(k, min(k + step, len(surface)))), sigma, samples, (seed, i), diffuse)
            for i, k in enumerate(starts)
        ]
        return np.concatenate(found, axis=1)

    def _begun(self, size: int, samples: int, seed: tuple[int, int]) -> tuple[Any, Callable[[Array], Any]]:
        # a sampler, and what repeats the rows of an array for each sample
        mi, dr = self._mi, self._dr
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1_000_003 * seed[0] + seed[1], size)
        index = dr.arange(mi.UInt32, size) // samples

        def rows(array: Array) -> Any:
            return mi.Vector3f(*(dr.gather(mi.Float, mi.Float(x.astype(np.float32)), index) for x in array.T))

        return sampler, rows

    def _batch(self, surface: SurfacePoints, sigma: float, samples: int, seed: tuple[int, int], diffuse: bool) -> Array:
        mi, dr, size = self._mi, self._dr, len(surface) * samples
        sampler, rows = self._begun(size, samples, seed)
        p, n, v = mi.Point3f(rows(surface.points)), rows(surface.normals), rows(surface.views)
        # half vectors as dense as the lobe in angle and azimuth: dω of light is 4 (V·H) dω of H
        first, second = sampler.next_2d()
        delta, phi = sigma * dr.sqrt(-2.0 * dr.log(1.0 - first)), 2.0 * np.pi * second
        sine = dr.sin(delta)
        half = mi.Frame3f(n).to_world(mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), dr.cos(delta)))
        across = dr.dot(v, half)
        to_light = 2.0 * across * half - v
        use = (across > 0.0) & (delta < np.pi) & (dr.dot(n, to_light) > 0.0)
        hit = self._scene.ray_intersect(mi.Ray3f(p, to_light), use)
        radiance = hit.emitter(self._scene, use).eval(hit, use)[0]
        weight = 8.0 * np.pi * sigma**2 * across * dr.select(delta > 1e-6, sine / delta, 1.0)
        cosine = dr.maximum(dr.dot(n, v), MIN_COS_VIEW)
        results = [dr.select(use, radiance * weight / cosine, 0.0)]
        if diffuse:
            point = dr.zeros(mi.SurfaceInteraction3f, size)
            point.p = p
            sampled, light = self._scene.sample_emitter_direction(point, sampler.next_2d(), False)
            facing = dr.maximum(0.0, dr.dot(n, sampled.d))
            chord = dr.norm(n - dr.normalize(sampled.d + v))
            delta = 2.0 * dr.asin(dr.minimum(0.5 * chord, 1.0))
            lobe = dr.exp(-0.5 / sigma**2 * delta * delta) / cosine
            results = [light[0] * facing, *results, dr.select(facing > 0.0, light[0] * lobe, 0.0)]
        return np.array([x.numpy().reshape(-1, samples).mean(axis=1, dtype=np.float64) for x in results])


def ellipsoid(normals: Array) -> SurfacePoints:
    """Points of the ellipsoid that have these normals, shape (k, 3)."""
    stretched = SEMI_AXES**2 * normals
    points = CENTRE + stretched / np.sqrt(np.sum(stretched * normals, axis=1))[:, None]
    views = EYE - points
    views /= np.linalg.norm(views, axis=1)[:, None]
    return SurfacePoints(points, normals, normals, views, np.ones(len(points), np.bool_), True)


def chosen_points(light: MitsubaLight, sigma: float, count: int) -> SurfacePoints:
    """Points of the ellipsoid, half of them in the light's highlight."""
    rng = np.random.default_rng(1)
    z = rng.uniform(np.cos(np.radians(STEEPEST_DEG)), 1.0, PILOT_POINTS)
    phi, root = rng.uniform(0.0, 2.0 * np.pi, PILOT_POINTS), np.sqrt(1.0 - z * z)
    normals = np.stack([root * np.cos(phi), root * np.sin(phi), z], axis=1)
    specular = light.at(ellipsoid(normals), sigma, PILOT_SAMPLES, 1, diffuse=False)[0]
    bright = normals[rng.choice(np.flatnonzero(specular > 0.01 * specular.max()), count // 2)]
    bright += rng.normal(0.0, 0.5 * sigma, bright.shape)
    bright /= np.linalg.norm(bright, axis=1)[:, None]
    return ellipsoid(np.concatenate([bright, normals[: count - len(bright)]]))


def shaded(surface: SurfacePoints, light: PanelLight, reflectance: Reflectance) -> Array:
    """Diffuse and specular light of lightopt per unit of R_d and R_s, shape (2, k)."""
    if isinstance(light, SurfaceLight):
        return np.stack(shade_surface_lights(surface, [light], reflectance=reflectance, caster=None))[:, 0]
    whole = converged_panel(light, centre=CENTRE, radius=float(SEMI_AXES.max()))
    # every second place of a row: no point is another's neighbour
    sample, shape = 2 * np.arange(len(surface)), (1, 2 * len(surface))
    found = shade_converged(surface, whole, sample=sample, shape=shape, reflectance=reflectance, caster=None)
    return np.stack(found[:2])


@dataclass(frozen=True)
class Row:
    """A light on a finish: differences as shares of the mirror level."""

    kind: str
    finish: str
    sampled: str
    points: int
    lit: int
    mean: float
    rms: float
    noise: float

    @property
    def passes(self) -> bool:
        return abs(self.mean) <= MOST_MEAN and self.rms <= MOST_RMS * self.noise


def built(kind: str) -> tuple[LightConfig, PanelLight]:
    """The channel of a case, as the rig file and as lightopt has it."""
    case = CASES[kind]
    rig = {
        "format": "lightopt-rig/1",
        "name": "x",
        "camera": load_rig(RIG).camera,
        "lights": [{"name": "a", **case.light}],
    }
    if kind == "panel":
        rig["light_source"] = {key: case.light[key] for key in _PANEL}
    config = RigConfig.model_validate(rig)
    return config.lights[case.channel], build_lights(config)[case.channel]


def compare(kind: str, *, count: int, samples: int) -> Iterator[Row]:
    """One light on each finish."""
    config, light = built(kind)
    peer = MitsubaLight(CASES[kind], config)
    for finish, sigma in FINISHES.items():
        surface = chosen_points(peer, sigma, count)
        halves = [peer.at(surface, sigma, samples // 2, seed) for seed in (2, 3)]
        # of the two ways of specular light, the one with less noise
        way = min((1, 2), key=lambda k: root_mean_square(halves[0][k] - halves[1][k]))
        halves = [half[[0, way]] for half in halves]
        expected = 0.5 * (halves[0] + halves[1])
        reflectance = Reflectance(R_d=R_D, R_s=MIRROR / expected[1].max(), sigma=sigma)
        share = np.array([reflectance.R_d, reflectance.R_s])[:, None] / MIRROR
        off = np.sum(share * (shaded(surface, light, reflectance) - expected), axis=0)
        noise = 0.5 * np.sum(share * (halves[0] - halves[1]), axis=0)
        lit = int(np.sum(expected[1] > 0.01 * expected[1].max()))
        figures = float(off.mean()), root_mean_square(off), root_mean_square(noise)
        yield Row(kind, finish, ("lobe", "emitter")[way - 1], len(surface), lit, *figures)


def root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table(rows: list[Row]) -> str:
    """A line per light and finish."""
    lines = [
        "| light | finish | sampled | points (in the highlight) | mean | rms | Mitsuba's noise | verdict |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        verdict = "agrees" if row.passes else "**differs**"
        numbers = f"{row.mean:+.1e} | {row.rms:.1e} | {row.noise:.1e}"
        lines.append(
            f"| {row.kind} | {row.finish} | {row.sampled} | {row.points} ({row.lit}) | {numbers} | {verdict} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Compare, print the table."""
    run(arguments, compare, name="light-kinds", description=__doc__, kinds=list(CASES))


def run(
    arguments: list[str] | None,
    compared: Callable[..., Iterable[Row]],
    *,
    name: str,
    description: str | None,
    kinds: list[str],
) -> None:
    """Compare kinds of light with Mitsuba, print the table, and put it into its block of a page where that is asked."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{name.replace('-', '_')}", description=description)
    parser.add_argument("--kinds", nargs="+", choices=CASES, default=kinds)
    parser.add_argument("--points", type=int, default=400, help="of the surface")
    parser.add_argument("--samples", type=int, default=1 << 17, help="of all parts, per point")
    parser.add_argument("--page", action="store_true", help="put the table into docs/validation/lighting.md")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    for kind in options.kinds:
        for row in compared(kind, count=options.points, samples=options.samples):
            rows.append(row)
            print(row, flush=True)
    text = table(rows)
    print(f"\n{text}")
    if options.page:
        replace_block(name, text, page="lighting.md")


if __name__ == "__main__":
    main()
