"""One bounce of light from the part to the part, beside Mitsuba 3's path tracer.

``python -m benchmarks.interreflection [--parts spout dish] [--samples N] [--page]``. Needs ``mitsuba``, but for
``--times``: the processor time of direct light and of one bounce, the least of three rounds, under the four lights of
the sample rig. The reflection model is a BSDF of Mitsuba's, the panel an area light of the same radiance. The bounce is
the image of paths of depth 3 without those of depth 2. Differences are of means over the part, and rms over blocks of
pixels, where Mitsuba's noise is that of two independent halves.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.inspection import replace_block
from lightopt.geometry import TriangleMesh
from lightopt.optics import MIN_COS_VIEW, Reflectance, white_level
from lightopt.rendering import PostureImages, cast_rays_at, render_posture
from lightopt.scene import Scene, build_scene, pixel_directions

Array = NDArray[Any]
PIXELS, TIMED_PIXELS = (200, 150), (800, 600)
BLOCK = 10
POSTURE, TIMED_ROUNDS = 0, 3


def dish(radius: float = 25.0, depth: float = 9.0, rings: int = 60, around: int = 120) -> TriangleMesh:
    """A solid with a hollow spherical top: a concave mirror, with normals of the sphere."""
    curvature = (radius**2 + depth**2) / (2.0 * depth)
    r = radius * np.arange(1, rings + 1) / rings
    turn = 2.0 * np.pi * np.arange(around) / around
    x, y = (r[:, None] * f(turn) for f in (np.cos, np.sin))
    z = 20.0 + curvature - depth - np.sqrt(curvature**2 - x**2 - y**2) + 0.0 * x
    top = np.concatenate([[[0.0, 0.0, 20.0 - depth]], np.stack([x, y, z], axis=-1).reshape(-1, 3)])
    normals = np.array([0.0, 0.0, 20.0 + curvature - depth]) - top
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    fan = [(0, 1 + j, 1 + (j + 1) % around) for j in range(around)]
    for i in range(rings - 1):
        for j in range(around):
            a, b = 1 + i * around + j, 1 + i * around + (j + 1) % around
            fan += [(a, a + around, b + around), (a, b + around, b)]
    # closed below by a cone, whose vertices have normals of their own
    rim = top[-around:]
    low = np.array([[0.0, 0.0, -60.0]])
    first = len(top)
    out = rim - low
    cone = [(first + j, first + around, first + (j + 1) % around) for j in range(around)]
    outward = np.stack([np.cos(turn), np.sin(turn), np.full(around, -radius / np.linalg.norm(out[0]))], axis=1)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return TriangleMesh(
        vertices=np.concatenate([top, rim, low]),
        faces=np.array(fan + cone, np.int32),
        normals=np.concatenate([normals, outward, [[0.0, 0.0, -1.0]]]),
    )


def four_lights(name: str, pixels: tuple[int, int]) -> Scene:
    """A part under the converged panels of the sample rig, in one bounce."""
    scene = build_scene("configs/rigs/four-panel.yaml", "configs/parts/spout.yaml", points="auto")
    width, height = pixels
    pixel_size = scene.camera.pixel_size * scene.camera.width / width
    camera = replace(scene.camera, width=width, height=height, pixel_size=pixel_size, principal_point=None)
    scene = replace(scene, camera=camera, bounces=1)
    return scene if name == "spout" else replace(scene, mesh=dish(), postures=scene.postures[:1])


def case(name: str) -> Scene:
    """A scene of one converged panel of real radiance and a small image, that shows a bounce."""
    scene = four_lights(name, PIXELS)
    light = replace(scene.lights[0], inverse_square=True, emission_exponent=1.0)
    return replace(scene, lights=(light,))


class MitsubaPaths:
    """A scene of Mitsuba's with the reflection model as a BSDF."""

    def __init__(self, scene: Scene) -> None:
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_mono")
        self._mi, self._dr, self._source = mi, dr, scene
        _register(mi, dr, scene.reflectance)
        mesh = scene.mesh
        assert mesh.normals is not None
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "torrance_sparrow"})
        part = mi.Mesh("part", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True, props=properties)
        values = mi.traverse(part)
        values["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
        values["vertex_normals"] = mi.Float(mesh.normals.astype(np.float32).ravel())
        values["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
        values.update()
        (light,) = scene.lights
        matrix = np.eye(4)
        axes = np.stack(
            [0.5 * light.size[0] * light.across, -0.5 * light.size[1] * light.along, -light.outward], axis=1
        )
        matrix[:3, :3], matrix[:3, 3] = axes, light.centre
        radiance = light.total_weight * light.distance**2 / (light.size[0] * light.size[1])
        lamp = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(matrix),
            "emitter": {"type": "area", "radiance": {"type": "uniform", "value": radiance}},
        }
        self._scene = mi.load_dict({"type": "scene", "part": part, "lamp": lamp})

    def images(self, samples: int, seed: int) -> tuple[Array, Array]:
        """Levels of pixel centres: by paths of two segments, and by those of three alone, shape (height, width)."""
        mi, dr, source = self._mi, self._dr, self._source
        camera = source.camera
        column, row = (a.ravel() for a in np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5))
        ways = pixel_directions(camera, column, row)
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        size = len(ways) * samples
        index = dr.arange(mi.UInt32, size) // samples
        way = mi.Vector3f(*(dr.gather(mi.Float, mi.Float(x.astype(np.float32)), index) for x in ways.T))
        path = mi.load_dict({"type": "path", "max_depth": 2, "rr_depth": 100, "hide_emitters": True})
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, size)
        ray = mi.RayDifferential3f(mi.Point3f(*(float(x) for x in camera.position)), way)
        direct, *_ = path.sample(self._scene, sampler, ray)
        hit = self._scene.ray_intersect(ray)
        known = hit.is_valid()
        sampled, weight = hit.bsdf(ray).sample(mi.BSDFContext(), hit, sampler.next_1d(), sampler.next_2d(), known)
        onward = mi.RayDifferential3f(hit.spawn_ray(hit.to_world(sampled.wo)))
        known &= sampled.pdf > 0
        light, *_ = path.sample(self._scene, sampler, onward, active=known)
        scale = np.pi * white_level(source.reflectance)
        found = []
        for level in (direct[0], dr.select(known, light[0] * weight[0], 0.0)):
            mean = (scale * level).numpy().reshape(-1, samples).mean(axis=1, dtype=np.float64)
            found.append(mean.reshape(camera.height, camera.width))
        return found[0], found[1]


def _register(mi: Any, dr: Any, reflectance: Reflectance) -> None:
    scale = 1.0 / (np.pi * white_level(reflectance))
    sigma, diffuse, specular = reflectance.sigma, scale * reflectance.R_d, scale * reflectance.R_s

    class TorranceSparrow(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def _parts(self, wi: Any, wo: Any) -> tuple[Any, Any, Any]:
            half = dr.normalize(wi + wo)
            chord = dr.norm(half - mi.Vector3f(0, 0, 1))
            delta = 2.0 * dr.asin(dr.minimum(0.5 * chord, 1.0))
            return delta, dr.dot(wi, half), dr.exp(-0.5 / sigma**2 * delta**2)

        def _value(self, wi: Any, wo: Any) -> Any:
            _, _, lobe = self._parts(wi, wo)
            value = diffuse * wo.z + specular * lobe / dr.maximum(wi.z, MIN_COS_VIEW)
            return dr.select((wi.z > 0) & (wo.z > 0), value, 0.0)

        def _density(self, wi: Any, wo: Any) -> Any:
            delta, across, lobe = self._parts(wi, wo)
            narrowing = dr.select(delta > 1e-6, dr.sin(delta) / delta, 1.0)
            of_lobe = lobe / (2.0 * np.pi * sigma**2 * narrowing * 4.0 * dr.maximum(across, 1e-6))
            density = 0.5 * wo.z / np.pi + 0.5 * dr.select(across > 0, of_lobe, 0.0)
            return dr.select((wi.z > 0) & (wo.z > 0), density, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            delta, phi = sigma * dr.sqrt(-2.0 * dr.log(1.0 - sample2.x)), 2.0 * np.pi * sample2.y
            sine = dr.sin(delta)
            half = mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), dr.cos(delta))
            mirrored = 2.0 * dr.dot(si.wi, half) * half - si.wi
            wo = dr.select(sample1 < 0.5, mi.warp.square_to_cosine_hemisphere(sample2), mirrored)
            sampled = mi.BSDFSample3f()
            sampled.wo, sampled.pdf, sampled.eta = wo, self._density(si.wi, wo), 1.0
            sampled.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            sampled.sampled_component = mi.UInt32(0)
            good = active & (sampled.pdf > 0)
            return sampled, dr.select(good, self._value(si.wi, wo) / dr.maximum(sampled.pdf, 1e-20), 0.0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return mi.Spectrum(dr.select(active, self._value(si.wi, wo), 0.0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(active, self._density(si.wi, wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    mi.register_bsdf("torrance_sparrow", TorranceSparrow)


def rendered(scene: Scene, rounds: int = 1) -> tuple[list[PostureImages], list[float]]:
    """The images of direct light and of one bounce, and their processor time, the least of some rounds [s]."""
    posture, caster = scene.postures[POSTURE], cast_rays_at(scene)
    seconds, images = [math.inf, math.inf], []
    for _ in range(rounds + 1):  # the first one compiles
        images = []
        for bounces in (0, 1):
            begun = time.process_time()
            images.append(render_posture(replace(scene, bounces=bounces), posture, caster=caster))
            seconds[bounces] = min(seconds[bounces], time.process_time() - begun)
    return images, seconds


def compare(name: str, samples: int, batches: int) -> dict[str, Any]:
    """Direct light and bounce of lightopt and of Mitsuba."""
    scene = case(name)
    images, seconds = rendered(scene)
    hit = images[0].geometry.hit
    direct = images[0].lights[0].level.astype(np.float64)
    bounce = images[1].lights[0].level - direct
    peer = MitsubaPaths(scene)
    halves = []
    for half in (0, 1):
        found = [peer.images(samples, 1000 * half + batch) for batch in range(batches)]
        halves.append(np.mean(found, axis=0))
    theirs = np.mean(halves, axis=0)
    means = [float(a[hit].mean()) for a in (direct, theirs[0], bounce, theirs[1])]
    noise = 0.5 * float((halves[0][1] - halves[1][1])[hit].mean())
    blocks = [_blocks(np.where(hit, a, 0.0)) for a in (bounce - theirs[1], 0.5 * (halves[0][1] - halves[1][1]))]
    rms = [float(np.sqrt(np.mean(a**2))) for a in blocks]
    return {"part": name, "means": means, "noise": noise, "rms": rms, "seconds": seconds, "hit": int(hit.sum())}


def _blocks(image: Array) -> Array:
    height, width = image.shape
    return image.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).mean(axis=(1, 3))


def table(rows: list[dict[str, Any]]) -> str:
    """A line per part."""
    lines = [
        f"| part | direct light | Mitsuba | bounce | Mitsuba | difference | rms of {BLOCK} × {BLOCK} px | its noise |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        direct, their_direct, bounce, their_bounce = row["means"]
        off = bounce / their_bounce - 1.0
        lines.append(
            f"| {row['part']} | {direct:.2f} | {their_direct:.2f} | {bounce:.3f} | {their_bounce:.3f} ± "
            f"{abs(row['noise']):.3f} | {100 * off:+.2f} % | {row['rms'][0]:.2f} | {row['rms'][1]:.2f} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Compare, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.interreflection", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=("spout", "dish"), default=["spout", "dish"])
    parser.add_argument("--samples", type=int, default=256, help="of a pixel in a batch")
    parser.add_argument("--batches", type=int, default=8, help="of each half")
    parser.add_argument("--page", action="store_true", help="put the table into docs/validation/lighting.md")
    parser.add_argument("--times", action="store_true", help="measure only how long a bounce takes")
    options = parser.parse_args(arguments)
    if options.times:
        for name in options.parts:
            _, (direct, bounced) = rendered(four_lights(name, TIMED_PIXELS), TIMED_ROUNDS)
            print(f"| {name} | {direct:.1f} s | {bounced:.1f} s | {bounced / direct:.1f} |", flush=True)
        return
    rows = []
    for name in options.parts:
        rows.append(compare(name, options.samples, options.batches))
        print(rows[-1], flush=True)
    text = table(rows)
    print(f"\n{text}")
    if options.page:
        replace_block("interreflection", text, page="lighting.md")


if __name__ == "__main__":
    main()
