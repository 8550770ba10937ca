"""GGX with Fresnel's factor, and two lobes, on a curved surface, beside Mitsuba 3.

``python -m benchmarks.reflection_models [--kinds panel dome ...] [--samples N] [--page]``. Needs what
``benchmarks.light_kinds`` needs, and takes surface, lights and verdict from there. GGX is Mitsuba's own BSDF
``roughconductor``, also brushed, with two roughnesses. It is sampled by lobe and by emitter, each sample weighted by
the balance heuristic. Two lobes are the sum of two of ``benchmarks.light_kinds``. Specular light alone is compared. The
noise is the standard error of the mean of eight parts of the samples: two halves are too few where some points have
most of the noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.light_kinds import CASES, MIRROR, MitsubaLight, Row, built, chosen_points, root_mean_square, run, shaded
from lightopt.config import LightConfig
from lightopt.optics import Reflectance, SpecularModel
from lightopt.rendering import SurfacePoints

Array = NDArray[Any]
ALPHAS = (0.02, 0.1, 0.3)
# nickel at 582 nm: P. B. Johnson, R. W. Christy, Phys. Rev. B 9, 5056 (1974), doi:10.1103/PhysRevB.9.5056. Metals
# hardly change below 60° of incidence; the other index is of no metal, and changes by a quarter up to 45°
INDICES = {"nickel": (1.96, 3.80), "n = 1.5": (1.5, 0.01)}
TWO_LOBES = SpecularModel(name="two-lobe", wide_share=0.02, wide_ratio=10.0)
NARROW_SIGMA = 0.003
BRUSHED = ((0.05, 4.0), (0.1, 4.0))  # α along the brushing, and how many times as much it is across
ALONG = np.array([0.8, -0.3, 0.2])  # the brushing
PARTS = 8  # of the samples


class Conductor(MitsubaLight):
    """An emitter, and its light mirrored by a rough metal of Mitsuba's."""

    def __init__(
        self, kind: str, config: LightConfig, alpha: float, index: tuple[float, float], *, ratio: float = 1.0
    ) -> None:
        super().__init__(CASES[kind], config)
        words = {"type": "roughconductor", "distribution": "ggx", "eta": index[0], "k": index[1]}
        words |= {"alpha": alpha} if ratio == 1.0 else {"alpha_u": ratio * alpha, "alpha_v": alpha}
        self._metal = self._mi.load_dict(words)
        n = complex(*index)
        # D·F/4 where light, view and normal are one direction
        self._peak = abs((n - 1.0) / (n + 1.0)) ** 2 / (4.0 * np.pi * alpha**2 * ratio)

    def _batch(self, surface: SurfacePoints, sigma: float, samples: int, seed: tuple[int, int], diffuse: bool) -> Array:
        mi, dr, size = self._mi, self._dr, len(surface) * samples
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1_000_003 * seed[0] + seed[1], size)
        index = dr.arange(mi.UInt32, size) // samples

        def rows(array: Array) -> Any:
            return mi.Vector3f(*(dr.gather(mi.Float, mi.Float(x.astype(np.float32)), index) for x in array.T))

        place = dr.zeros(mi.SurfaceInteraction3f, size)
        place.p, place.n = mi.Point3f(rows(surface.points)), mi.Normal3f(rows(surface.normals))
        if surface.across is None:
            place.sh_frame = mi.Frame3f(place.n)
        else:
            u = rows(surface.across)
            place.sh_frame = mi.Frame3f(u, dr.cross(mi.Vector3f(place.n), u), mi.Vector3f(place.n))
        place.wi = place.to_local(rows(surface.views))
        context = mi.BSDFContext()
        by_lobe, weight = self._metal.sample(context, place, sampler.next_1d(), sampler.next_2d())
        use = by_lobe.pdf > 0.0
        hit = self._scene.ray_intersect(mi.Ray3f(place.p, place.to_world(by_lobe.wo)), use)
        seen = mi.DirectionSample3f(self._scene, hit, place)
        other = self._scene.pdf_emitter_direction(place, seen, use & hit.is_valid())
        light = hit.emitter(self._scene, use).eval(hit, use)[0]
        total = dr.select(use, light * weight[0] * by_lobe.pdf / (by_lobe.pdf + other), 0.0)
        by_emitter, light = self._scene.sample_emitter_direction(place, sampler.next_2d(), False)
        value, other = self._metal.eval_pdf(context, place, place.to_local(by_emitter.d))
        of_both = by_emitter.pdf + other
        total += dr.select(by_emitter.pdf > 0.0, light[0] * value[0] * by_emitter.pdf / of_both, 0.0)
        return total.numpy().reshape(-1, samples).mean(axis=1, dtype=np.float64)[None] / self._peak


def compare(kind: str, *, count: int, samples: int) -> Iterator[Row]:
    """One light on each finish."""
    config, light = built(kind)
    for name, index in INDICES.items():
        for alpha in ALPHAS:
            sigma = 0.5 * alpha
            peer = Conductor(kind, config, alpha, index)
            surface = chosen_points(peer, sigma, count)
            parts = np.array([peer.at(surface, sigma, samples // PARTS, 2 + k, diffuse=False)[0] for k in range(PARTS)])
            model = SpecularModel(name="ggx", refractive_index=index)
            yield _row(kind, f"GGX, α = {alpha}, {name}", "both", surface, light, parts, sigma, model)
    for alpha, ratio in BRUSHED:
        sigma, index = 0.5 * alpha, INDICES["nickel"]
        peer = Conductor(kind, config, alpha, index, ratio=ratio)
        surface = _brushed(chosen_points(Conductor(kind, config, alpha, index), ratio * sigma, count))
        parts = np.array([peer.at(surface, sigma, samples // PARTS, 2 + k, diffuse=False)[0] for k in range(PARTS)])
        model = SpecularModel(name="ggx", refractive_index=index, across_ratio=ratio)
        finish = f"GGX, brushed, α = {alpha} and {ratio * alpha:g}, nickel"
        yield _row(kind, finish, "both", surface, light, parts, sigma, model)
    plain, model = MitsubaLight(CASES[kind], config), TWO_LOBES
    surface = chosen_points(plain, NARROW_SIGMA, count)
    widths = (NARROW_SIGMA, NARROW_SIGMA * model.wide_ratio)
    lobes = np.array([[plain.at(surface, x, samples // PARTS, 2 + k)[1:] for k in range(PARTS)] for x in widths])
    # of the two ways of each lobe, the one with less noise
    ways = [min((0, 1), key=lambda way: root_mean_square(x[:, way].std(axis=0))) for x in lobes]
    parts = lobes[0, :, ways[0]] + model.wide_share * lobes[1, :, ways[1]]
    sampled = " and ".join(("lobe", "emitter")[way] for way in ways)
    yield _row(kind, "two lobes, σ = 0.003 and 0.03", sampled, surface, light, parts, NARROW_SIGMA, model)


def _brushed(surface: SurfacePoints) -> SurfacePoints:
    across = np.cross(surface.normals, ALONG)
    return replace(surface, across=across / np.linalg.norm(across, axis=1)[:, None])


def _row(
    kind: str,
    finish: str,
    sampled: str,
    surface: SurfacePoints,
    light: Any,
    parts: Array,
    sigma: float,
    model: SpecularModel,
) -> Row:
    expected = parts.mean(axis=0)
    most = float(expected.max())
    found = shaded(surface, light, Reflectance(R_d=0.0, R_s=MIRROR / most, sigma=sigma, model=model))[1]
    off, noise = (found - expected) / most, parts.std(axis=0, ddof=1) / np.sqrt(PARTS) / most
    lit = int(np.sum(expected > 0.01 * most))
    figures = float(off.mean()), root_mean_square(off), root_mean_square(noise)
    return Row(kind, finish, sampled, len(surface), lit, *figures)


def main(arguments: list[str] | None = None) -> None:
    """Compare, print the table."""
    kinds = ["panel", "low_angle_ring", "dome"]
    run(arguments, compare, name="reflection-models", description=__doc__, kinds=kinds)


if __name__ == "__main__":
    main()
