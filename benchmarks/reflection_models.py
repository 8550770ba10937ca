"""Forms of the lobe and of the diffuse component, and regions, on a curved surface, beside Mitsuba 3.

``python -m benchmarks.reflection_models [--kinds panel dome ...] [--samples N] [--page]``. Needs what
``benchmarks.light_kinds`` needs, and takes surface, lights and verdict from there.

GGX is Mitsuba's own BSDF ``roughconductor``, also brushed, with two roughnesses. It is sampled by lobe and by emitter,
each sample weighted by the balance heuristic. Two lobes are the sum of two of ``benchmarks.light_kinds``. Forms of the
diffuse component are summed by their formulas over places of Mitsuba's emitter. A part of two regions is two meshes of
Mitsuba's, with ``roughconductor`` and ``diffuse``, which rays of the camera meet; lightopt finds the region by a box.

The noise is the standard error of the mean of eight parts of the samples: two halves are too few where some points have
most of the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.light_kinds import (
    CASES,
    CENTRE,
    EYE,
    MIRROR,
    SEMI_AXES,
    MitsubaLight,
    Row,
    built,
    chosen_points,
    root_mean_square,
    run,
    shaded,
)
from lightopt.config import LightConfig
from lightopt.geometry import (
    BoxRegion,
    LoadedMesh,
    RayCaster,
    TriangleMesh,
    mesh_with_regions,
    resolve_hits,
    sphere_mesh,
)
from lightopt.lights import PanelLight
from lightopt.optics import DiffuseForm, Reflectance, SpecularModel
from lightopt.rendering import SurfacePoints, shade_isolated
from lightopt.rendering._surface import surface_at

Array = NDArray[Any]
ALPHAS = (0.02, 0.1, 0.3)
# nickel at 582 nm: P. B. Johnson, R. W. Christy, Phys. Rev. B 9, 5056 (1974), doi:10.1103/PhysRevB.9.5056. Metals
# hardly change below 60° of incidence; the other index is of no metal, and changes by a quarter up to 45°
INDICES = {"nickel": (1.96, 3.80), "n = 1.5": (1.5, 0.01)}
TWO_LOBES = SpecularModel(name="two-lobe", wide_share=0.02, wide_ratio=10.0)
NARROW_SIGMA = 0.003
BRUSHED = ((0.05, 4.0), (0.1, 4.0))  # α along the brushing, and how many times as much it is across
ALONG = np.array([0.8, -0.3, 0.2])  # the brushing
FORMS = {
    "diffuse, (N·L)^0.7": DiffuseForm(exponent=0.7),
    "diffuse, (N·L)²": DiffuseForm(exponent=2.0),
    "diffuse, Oren–Nayar, r = 0.5": DiffuseForm(roughness=0.5),
}
BOX = ((-99.0, -99.0, -99.0), (3.0, 6.0, 99.0))  # whose inside is painted [mm]
WHITE = 0.9  # reflectance of the paint
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
        sampler, rows = self._begun(size, samples, seed)
        place, bsdf = self._place(surface, rows)
        context = mi.BSDFContext()
        by_lobe, weight = bsdf.sample(context, place, sampler.next_1d(), sampler.next_2d())
        use = by_lobe.pdf > 0.0
        hit = self._scene.ray_intersect(mi.Ray3f(place.p, place.to_world(by_lobe.wo)), use)
        seen = mi.DirectionSample3f(self._scene, hit, place)
        other = self._scene.pdf_emitter_direction(place, seen, use & hit.is_valid())
        light = hit.emitter(self._scene, use).eval(hit, use)[0]
        total = dr.select(use, light * weight[0] * by_lobe.pdf / (by_lobe.pdf + other), 0.0)
        by_emitter, light = self._scene.sample_emitter_direction(place, sampler.next_2d(), False)
        value, other = bsdf.eval_pdf(context, place, place.to_local(by_emitter.d))
        of_both = by_emitter.pdf + other
        total += dr.select(by_emitter.pdf > 0.0, light[0] * value[0] * by_emitter.pdf / of_both, 0.0)
        return total.numpy().reshape(-1, samples).mean(axis=1, dtype=np.float64)[None] / self._peak

    def _place(self, surface: SurfacePoints, rows: Callable[[Array], Any]) -> tuple[Any, Any]:
        # the points in Mitsuba's words, and their BSDF
        mi, dr = self._mi, self._dr
        place = dr.zeros(mi.SurfaceInteraction3f)
        place.p, place.n = mi.Point3f(rows(surface.points)), mi.Normal3f(rows(surface.normals))
        if surface.across is None:
            place.sh_frame = mi.Frame3f(place.n)
        else:
            u = rows(surface.across)
            place.sh_frame = mi.Frame3f(u, dr.cross(mi.Vector3f(place.n), u), mi.Vector3f(place.n))
        place.wi = place.to_local(rows(surface.views))
        return place, self._metal


class Painted(Conductor):
    """A part of two materials as two meshes of Mitsuba's: the metal, and white paint where faces have material 1."""

    def __init__(
        self, kind: str, config: LightConfig, alpha: float, index: tuple[float, float], part: TriangleMesh
    ) -> None:
        super().__init__(kind, config, alpha, index)
        mi = self._mi
        assert part.normals is not None
        meshes: dict[str, Any] = {"type": "scene"}
        for number, bsdf in enumerate((self._metal, mi.load_dict({"type": "diffuse", "reflectance": WHITE}))):
            properties = mi.Properties()
            properties["bsdf"] = bsdf
            faces = part.faces[part.material == number]
            mesh = mi.Mesh(f"part{number}", len(part.vertices), len(faces), has_vertex_normals=True, props=properties)
            values = mi.traverse(mesh)
            values["vertex_positions"] = mi.Float(part.vertices.astype(np.float32).ravel())
            values["vertex_normals"] = mi.Float(part.normals.astype(np.float32).ravel())
            values["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
            values.update()
            meshes[f"part{number}"] = mesh
        self._part = mi.load_dict(meshes)
        # as levels, of a highest one of the metal where R_s is 1
        self.paint = WHITE / np.pi / self._peak

    def _place(self, surface: SurfacePoints, rows: Callable[[Array], Any]) -> tuple[Any, Any]:
        mi = self._mi
        eye = mi.Point3f(*EYE.tolist())
        place = self._part.ray_intersect(mi.Ray3f(eye, -rows(surface.views)))
        return place, place.bsdf()


class Matte(MitsubaLight):
    """An emitter, and its diffuse light by the formula of a form, for which Mitsuba has no BSDF."""

    def __init__(self, kind: str, config: LightConfig, form: DiffuseForm) -> None:
        super().__init__(CASES[kind], config)
        self._form = form

    def _batch(self, surface: SurfacePoints, sigma: float, samples: int, seed: tuple[int, int], diffuse: bool) -> Array:
        mi, dr, size, (q, r) = self._mi, self._dr, len(surface) * samples, self._form
        sampler, rows = self._begun(size, samples, seed)
        point = dr.zeros(mi.SurfaceInteraction3f, size)
        point.p = mi.Point3f(rows(surface.points))
        sampled, light = self._scene.sample_emitter_direction(point, sampler.next_2d(), False)
        n, v = rows(surface.normals), rows(surface.views)
        facing, seen = dr.dot(n, sampled.d), dr.dot(n, v)
        s = dr.dot(sampled.d, v) - facing * seen
        fujii = (1.0 + r * s / dr.select(s > 0.0, dr.maximum(facing, seen), 1.0)) / (
            1.0 + (0.5 - 2.0 / (3.0 * np.pi)) * r
        )
        total = dr.select(facing > 0.0, light[0] * dr.power(facing, q) * fujii, 0.0)
        return total.numpy().reshape(-1, samples).mean(axis=1, dtype=np.float64)[None]


def painted_part() -> TriangleMesh:
    """The ellipsoid, of whose faces those in a box have material 1."""
    ball = sphere_mesh(1.0)
    normals = ball.vertices / SEMI_AXES
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    loaded = LoadedMesh(TriangleMesh(CENTRE + SEMI_AXES * ball.vertices, ball.faces, normals), ())
    return mesh_with_regions(loaded, [BoxRegion(*BOX)], most=10**6, place=str)


def compare(kind: str, *, count: int, samples: int) -> Iterator[Row]:
    """One light on each finish."""
    config, light = built(kind)
    for name, index in INDICES.items():
        for alpha in ALPHAS:
            sigma = 0.5 * alpha
            peer = Conductor(kind, config, alpha, index)
            surface = chosen_points(peer, sigma, count)
            parts = _parts(peer, surface, sigma, samples)
            model = SpecularModel(name="ggx", refractive_index=index)
            yield _row(
                kind,
                f"GGX, α = {alpha}, {name}",
                "both",
                surface,
                parts,
                _specular(surface, light, parts, sigma, model),
            )
    for alpha, ratio in BRUSHED:
        sigma, index = 0.5 * alpha, INDICES["nickel"]
        peer = Conductor(kind, config, alpha, index, ratio=ratio)
        surface = _brushed(chosen_points(Conductor(kind, config, alpha, index), ratio * sigma, count))
        parts = _parts(peer, surface, sigma, samples)
        model = SpecularModel(name="ggx", refractive_index=index, across_ratio=ratio)
        finish = f"GGX, brushed, α = {alpha} and {ratio * alpha:g}, nickel"
        yield _row(kind, finish, "both", surface, parts, _specular(surface, light, parts, sigma, model))
    plain, model = MitsubaLight(CASES[kind], config), TWO_LOBES
    surface = chosen_points(plain, NARROW_SIGMA, count)
    widths = (NARROW_SIGMA, NARROW_SIGMA * model.wide_ratio)
    lobes = np.array([[plain.at(surface, x, samples // PARTS, 2 + k)[1:] for k in range(PARTS)] for x in widths])
    # of the two ways of each lobe, the one with less noise
    ways = [min((0, 1), key=lambda way: root_mean_square(x[:, way].std(axis=0))) for x in lobes]
    parts = lobes[0, :, ways[0]] + model.wide_share * lobes[1, :, ways[1]]
    sampled = " and ".join(("lobe", "emitter")[way] for way in ways)
    found = _specular(surface, light, parts, NARROW_SIGMA, model)
    yield _row(kind, "two lobes, σ = 0.003 and 0.03", sampled, surface, parts, found)
    for name, form in FORMS.items():
        parts = _parts(Matte(kind, config, form), surface, NARROW_SIGMA, samples)
        matte = Reflectance(R_d=MIRROR / float(parts.mean(axis=0).max()), R_s=0.0, sigma=NARROW_SIGMA, diffuse=form)
        yield _row(kind, name, "emitter", surface, parts, shaded(surface, light, matte)[0])
    yield _painted_row(kind, config, light, count, samples)


def _painted_row(kind: str, config: LightConfig, light: PanelLight, count: int, samples: int) -> Row:
    alpha, index, part = ALPHAS[-1], INDICES["nickel"], painted_part()
    peer = Painted(kind, config, alpha, index, part)
    aims = chosen_points(Conductor(kind, config, alpha, index), 0.5 * alpha, count)
    caster = RayCaster(part.vertices, part.faces, rays=count)
    hits = resolve_hits(caster.first_hit(EYE, -aims.views), EYE, -aims.views, part.vertices, part.faces)
    surface = surface_at(hits, part, EYE, outside=True)
    parts = _parts(peer, surface, 0.5 * alpha, samples)
    R_s, model = MIRROR / float(parts.mean(axis=0).max()), SpecularModel(name="ggx", refractive_index=index)
    metal = Reflectance(R_d=0.0, R_s=R_s, sigma=0.5 * alpha, model=model)
    paint = Reflectance(R_d=R_s * peer.paint, R_s=0.0, sigma=0.5 * alpha)
    (found,) = shade_isolated(surface, [light], reflectances=[metal, paint], caster=caster, shadows=False)
    assert surface.material is not None
    finish = f"two regions: GGX, α = {alpha}, nickel, and diffuse ({surface.material.sum()} points)"
    return _row(kind, finish, "both", surface, parts, found / R_s)


def _parts(peer: MitsubaLight, surface: SurfacePoints, sigma: float, samples: int) -> Array:
    # the light of each part of the samples, shape (parts, k)
    return np.array([peer.at(surface, sigma, samples // PARTS, 2 + k, diffuse=False)[0] for k in range(PARTS)])


def _specular(surface: SurfacePoints, light: PanelLight, parts: Array, sigma: float, model: SpecularModel) -> Array:
    # lightopt's, per unit of R_s
    reflectance = Reflectance(R_d=0.0, R_s=MIRROR / float(parts.mean(axis=0).max()), sigma=sigma, model=model)
    return shaded(surface, light, reflectance)[1]


def _brushed(surface: SurfacePoints) -> SurfacePoints:
    across = np.cross(surface.normals, ALONG)
    return replace(surface, across=across / np.linalg.norm(across, axis=1)[:, None])


def _row(kind: str, finish: str, sampled: str, surface: SurfacePoints, parts: Array, found: Array) -> Row:
    expected = parts.mean(axis=0)
    most = float(expected.max())
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
