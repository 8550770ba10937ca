"""Fits to images of another renderer and another surface, over subsets of the lights.

No R_d, R_s and σ are the true ones there. Expected: the subsets agree, predict unseen lights as well as the best
three-parameter fit of another program, and say as much in their intervals.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from captured import profile_interval
from measured_ball import Ball, Surface, hemisphere

from lightopt import build_scene
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._quality import assess_quality
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.estimate.reflectance._vector import LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.registration import _image_checks, _refinement
from lightopt.rendering import cast_rays_at

SURFACES = {
    "like metal": Surface(),
    "a sharp lobe in a haze": Surface(40.0, 1.12, ((600.0, 0.03), (60.0, 0.2))),
    "a haze that is all but diffuse": Surface(80.0, 1.12, ((500.0, 0.02), (40.0, 0.3))),
    "a core of few pixels": Surface(60.0, 1.12, ((4000.0, 0.004), (30.0, 0.1))),
}


class Bench:
    """A ball, its rig and its images."""

    def __init__(self, folder, surface, *, lights, size, bits=8, noise=1.0, exposure=1.0):
        self.bits, self.noise = bits, noise
        self.ball = Ball(hemisphere(lights), size=size)
        scaled = noise * (2**bits - 1) / 255.0
        self.ball.write(folder, bits=bits, noise=scaled)
        self.levels = self.ball.shoot(surface, bits=bits, noise=scaled, seed=1, exposure=exposure)
        self.scene = build_scene(folder / "rig.yaml", folder / "part.yaml")
        self.caster = cast_rays_at(self.scene)
        self.all = np.arange(lights)

    def fit(self, lights, *, budget=1000):
        images = self.ball.observations(self.levels, lights, bits=self.bits)
        return fit_reflectance(collect_samples(self.scene, images, caster=self.caster, budget=budget))

    def judge(self, lights, found):
        """Raise where the misfit is blamed on the ball's place, or the images are not taken for the ball's."""
        images = self.ball.observations(self.levels, lights, bits=self.bits)
        samples = collect_samples(self.scene, images, caster=self.caster, budget=300)
        quality = replace(assess_quality(samples, found), epsilon=1.0)  # however good, it is looked into
        assert quality.poor
        refuse_unexplained_images(FitSetup(self.scene, self.caster, images), samples, found, quality)

    def unseen(self, x, lights):
        rest = np.setdiff1d(self.all, lights)
        return self.ball.rms(x[:3], self.levels, rest if len(rest) else self.all, bits=self.bits)


def subsets(lights, size):
    """Disjoint subsets of one size that are all spread over the hemisphere."""
    step = lights // size
    return [np.arange(first, step * size, step) for first in range(step)]


def disjoint_pairs_overlap(intervals):
    """Share of pairs of disjoint subsets of one size whose intervals overlap; intervals by size."""
    pairs = [pair for group in intervals for pair in itertools.combinations(group, 2)]
    return np.mean([a[0] <= b[1] and b[0] <= a[1] for a, b in pairs])


def examine(bench, sizes, *, most_of_each, places=(R_D, LOG_R_S, LOG_SIGMA), alike=True):
    """Check what holds of fits to subsets of the lights; the fits by the number of lights.

    Where SciPy's best fits of the subsets differ from each other (`alike=False`), each is held against SciPy's.
    """
    fits, sigmas, intervals = {}, {}, {place: [] for place in places}
    others = 0
    for size in sizes:
        chosen = subsets(len(bench.all), size)[:most_of_each]
        found = fits[size] = [bench.fit(lights) for lights in chosen]
        sigmas[size] = [one.sigma for one in found]
        for place in places:
            intervals[place].append([profile_interval(one, place) for one in found])
        reference, _ = bench.ball.best_fit(bench.levels, chosen[0], bits=bench.bits)
        ours, best = bench.unseen(found[0].x, chosen[0]), bench.unseen(reference, chosen[0])
        print(
            f"{size} lights: σ", np.round(sigmas[size], 4), f"SciPy's {math.exp(reference[2]):.4f}; unseen {ours:.3f}"
            f" and {best:.3f} levels rms; interval of σ", np.exp(intervals[LOG_SIGMA][-1][0]).round(4),
        )  # fmt: skip
        assert ours <= 1.1 * best
        for number, (lights, one) in enumerate(zip(chosen, found, strict=True)):
            assert one.maximum.converged
            assert one.describes == (best < 1.1 * bench.noise)
            # what is reported is the best of the profile that is drawn
            assert max(one.scan, key=lambda point: point.value).sigma == pytest.approx(one.sigma, rel=1e-12)
            if not alike and number < 3:  # SciPy takes half a minute each
                own, rms = bench.ball.best_fit(bench.levels, lights, bits=bench.bits)
                ours = bench.ball.rms(one.x[:3], bench.levels, lights, bits=bench.bits)
                assert ours <= 1.02 * rms
                # all but as good may be two optima: the core, which few pixels show, and what surrounds it
                same = abs(own[LOG_SIGMA] - one.x[LOG_SIGMA]) < 0.5
                others += not same
                if not same:
                    continue
                low, high = intervals[LOG_SIGMA][-1][number]
                # intervals of 95 %: one in twenty just misses it; a misfit that the noise hides is not in them
                margin = 0.15 if one.describes else 0.02
                assert low - margin <= own[2] <= high + margin
    assert others <= 2  # of a dozen
    many = [sigma for size in sizes if size >= 12 for sigma in sigmas[size]]
    few = [sigma for size in sizes if size < 12 for sigma in sigmas[size]]
    if alike:
        assert max(many) <= 1.1 * min(many)
        assert all(min(many) / 1.25 <= sigma <= 1.25 * max(many) for sigma in few)
    shares = [disjoint_pairs_overlap(intervals[place]) for place in places]
    print("disjoint subsets whose intervals of R_d, ln R_s, ln σ overlap:", np.round(shares, 3))
    # a misfit that the noise hides is not in the intervals
    assert min(shares) >= (0.85 if any(found[0].describes for found in fits.values()) else 0.9)
    return fits


@pytest.mark.slow
def test_subsets_of_lights_agree(tmp_path):
    bench = Bench(tmp_path, SURFACES["a sharp lobe in a haze"], lights=24, size=56)
    fits = examine(bench, (6, 12), most_of_each=4)
    bench.judge(subsets(24, 6)[0], fits[6][0])


@pytest.mark.nightly
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize(
    ("bits", "exposure"),
    [(8, 1.0), (16, 1.0), (16, 0.25), (8, 4.0)],
    ids=["8 bit", "16 bit", "unsaturated", "much saturated"],
)
def test_subsets_of_96_lights_agree(tmp_path, name, bits, exposure):
    surface = SURFACES[name]
    if exposure < 1.0:
        surface = Surface(surface.diffuse, surface.exponent, tuple((min(r, 600.0), a) for r, a in surface.lobes))
    bench = Bench(tmp_path, surface, lights=96, size=80, bits=bits, exposure=exposure)
    # SciPy's own σ differ: 0.050 to 0.056 by how the few pixels of the core fall on the camera's grid; and 0.017 or
    # 0.146, two optima that are all but equally good, where 6 lights show a peak of 6 levels in a haze of 75
    alike = name != "a core of few pixels" and (name, exposure) != ("a haze that is all but diffuse", 0.25)
    examine(bench, (6, 12, 24, 48, 96), most_of_each=8, alike=alike)


CHROME = Surface(0.6, 1.12, ((280.0, 0.03), (30.0, 0.09)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: np.roll(image, 3, axis=1), r"shifted by (2\.[5-9]|3\.[0-5]) px"),
        (lambda image: image[::-1, ::-1], "they fit far better rotated by 180°"),
        pytest.param(lambda image: image, None, marks=pytest.mark.nightly),
    ],
    ids=["shifted", "turned", "in place"],
)
def test_where_a_chrome_ball_lies_is_found_from_its_highlights(tmp_path, monkeypatch, change, words):
    """Hardly any light of it is diffuse, and its highlights are few pixels: not dust, nor another posture."""
    monkeypatch.setattr(_image_checks, "PIXELS", 2000)
    monkeypatch.setattr(_refinement, "FIRST_INNER_PIXELS", 1000)
    bench = Bench(tmp_path, CHROME, lights=4, size=96, noise=0.3)
    images = [
        replace(image, levels=change(image.levels), saturated=change(image.saturated))
        for image in bench.ball.observations(bench.levels, bench.all, bits=8)
    ]
    samples = collect_samples(bench.scene, images, caster=bench.caster, budget=300)
    found = fit_reflectance(samples)
    world = FitSetup(bench.scene, bench.caster, images)
    if words is None:
        assert refuse_unexplained_images(world, samples, found, assess_quality(samples, found))
        return
    with pytest.raises(InputError, match=words):
        refuse_unexplained_images(world, samples, found, assess_quality(samples, found))
