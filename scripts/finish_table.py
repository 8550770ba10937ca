"""Put the table of measured finishes into docs/reference/finishes.md, from published fits to measured reflectances.

``python scripts/finish_table.py``. Parameters of the green channel: J. Löw, J. Kronander, A. Ynnerman, J. Unger: BRDF
models for accurate and efficient rendering of glossy surfaces, ACM Transactions on Graphics 31(1), 2012,
doi:10.1145/2077341.2077350, whose microfacet model is f = k_D/π + F·G·S/(π·cosθ_i cosθ_o), S = A/(1 + B·(1 − cosδ))^C.
The paper's equation 15 has no such π, its supplement's parameters include one: so the libraries BBM
(bsdfbenchmark/bbm, lowmicrofacet.h) and dj_brdf (jdupuy/dj_brdf) evaluate them. Nickel reflects 0.19 of the light then;
by other fits to the same measurement it is 0.20 (Ward's model: A. Ngan, F. Durand, W. Matusik: Experimental analysis of
BRDF models, EGSR 2005) and 0.17 (GGX: L. De Oliveira and others: A hybrid neural-microfacet BRDF model for real-time
rendering, Computer Graphics Forum 45(4), 2026, doi:10.1111/cgf.70540).
Measured by W. Matusik, H. Pfister, M. Brand, L. McMillan: A data-driven reflectance model, SIGGRAPH 2003.

Rolled and brushed metal: G. J. Ward: Measuring and modeling anisotropic reflection, SIGGRAPH 1992, table 1, whose model
along the normal is f = ρ_d/π + ρ_s/(4π·α_x·α_y)·exp(−tan²δ·(cos²φ/α_x² + sin²φ/α_y²)).

Brushed steel: the GGX part, k_d/π + F·D·G/(4·cosθ_i cosθ_o) with F of a real index, that L. De Oliveira and others
(above) fitted to "weta_brushed_steel_satin_pink" of J. Dupuy, W. Jakob: An adaptive parameterization for efficient
material acquisition and rendering, SIGGRAPH Asia 2018. Its parameters are in the authors' file
Ours_ld4_32x2_weta_brushed_steel_satin_pink_rgb.brdf (Ubisoft-LaForge/Ubisoft-LaForge.github.io). The share of light
that the data reflect: scripts/python/amaze/res/rgl_materials.json of Timour/Amaze, green, mean at normal incidence.

Satin anodised aluminium and satin nickel are not measured: alpha is what gives a reading of a gloss meter of 60°, whose
angles are those of ISO 2813 (and ISO 7668, method C), and the share of light reflected is assumed.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize

from lightopt.optics import Reflectance, SpecularModel, least_white_level, light_factor, specular_divisor, specular_lobe

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "finishes.md"
WHITE = 100.0
MOST_MISFIT = 0.2  # of the nearest form; above it, the surface has a row and no line for part files
MOST_WIDE = 0.5  # [rad], of a part file's wide lobe
DELTA = np.radians(np.geomspace(0.1, 60.0, 400))


class Measured(NamedTuple):
    """A surface: k_D, A, B, C, and the index of refraction by which F is a dielectric's."""

    finish: str
    diffuse: float
    a: float
    b: float
    c: float
    index: float


SURFACES = (
    Measured("chrome", 0.002520, 771.035522, 64661.257812, 1.905420, 99.999413),
    Measured("chrome steel", 0.008416, 629.395203, 122360.4375, 1.486198, 99.999619),
    Measured("stainless steel 440", 0.004251, 613.785278, 96436.515625, 1.550240, 99.999336),
    Measured("nickel", 0.006663, 32.745403, 705.733887, 1.945258, 5.441883),
    Measured("aluminium bronze", 0.022346, 37.932693, 10482.133789, 0.816737, 2.236525),
    Measured("aluminium", 0.002017, 1090.751821, 218716.59375, 1.092006, 6.282688),
    Measured("brass", 0.012504, 1931.137207, 244596.53125, 1.136163, 2.698691),
    Measured("silver metallic paint", 0.000025, 2.373467, 58.200935, 1.718832, 9.073233),
    Measured("silver paint", 0.127910, 1.207139, 38.884895, 1.971779, 8.336617),
    Measured("black oxidised steel", 0.011743, 1.057305, 30.661055, 1.869546, 1.660413),
    Measured("white paint", 0.312274, 146.118881, 2777.948730, 1.813009, 1.197418),
    Measured("pearl paint", 0.162150, 0.714731, 30.882542, 1.941556, 9.303603),
    Measured("black phenolic", 0.001674, 99.654602, 8696.112305, 1.524949, 1.839669),
    Measured("specular black phenolic", 0.001737, 2568.570068, 291094.21875, 1.252478, 1.415415),
    Measured("black soft plastic", 0.000594, 0.442911, 124.908409, 0.618811, 1.902569),
    Measured("red plastic", 0.044432, 1.045352, 34.117554, 1.529797, 1.666450),
    Measured("grey plastic", 0.100258, 204.230804, 33710.691406, 1.023289, 1.400441),
    Measured("white acrylic", 0.300911, 1291.507080, 153332.265625, 1.153521, 1.291205),
    Measured("white diffuse ball", 0.272448, 2.082304, 75.010391, 1.940200, 1.693726),
    Measured("teflon (PTFE)", 0.313597, 1.816174, 41.644257, 2.066234, 1.611215),
)


class Brushed(NamedTuple):
    """A surface with a direction: ρ_d, ρ_s (of GGX that of F), α_x and α_y, the smaller one along the brushing."""

    finish: str
    diffuse: float
    specular: float
    along: float
    across: float
    form: str = "gaussian"


BRUSHED = (
    Brushed("rolled brass", 0.10, 0.33, 0.050, 0.16),
    Brushed("rolled aluminium", 0.10, 0.21, 0.040, 0.09),
    Brushed("lightly brushed aluminium", 0.15, 0.19, 0.088, 0.13),
    Brushed("brushed steel", 0.070954, (4.608883 / 6.608883) ** 2, 0.019124, 0.387415, "ggx"),
)


def lobe_of(model: SpecularModel, sigma: float) -> np.ndarray:
    """Values of a lobe at `DELTA`."""
    lobe = Reflectance(R_d=0.0, R_s=1.0, sigma=sigma, model=model).lobe
    return np.array([specular_lobe((2.0 * math.sin(0.5 * d)) ** 2, 0.0, lobe) for d in DELTA])


def misfit(values: np.ndarray, wanted: np.ndarray) -> tuple[float, float]:
    """Root mean square of the logarithm's error, weighted by the light that each angle reflects, and the height."""
    weight = wanted * np.sin(2.0 * DELTA) * DELTA
    error = np.log(wanted / np.maximum(values, 1e-12))
    height = float(np.average(error, weights=weight))
    return math.sqrt(float(np.average((error - height) ** 2, weights=weight))), math.exp(height)


def fitted(name: str, wanted: np.ndarray) -> tuple[SpecularModel, float, float, float]:
    """The form of the lobe that is nearest to values at `DELTA`: itself, its σ, its height, its misfit."""

    def model(x: np.ndarray) -> tuple[SpecularModel, float]:
        if name == "two-lobe":
            share, ratio = 1.0 / (1.0 + math.exp(-x[1])), 1.0 + math.exp(x[2])
            return SpecularModel(name="two-lobe", wide_share=share, wide_ratio=ratio), math.exp(x[0])
        return SpecularModel(name="ggx" if name == "ggx" else "torrance-sparrow"), math.exp(x[0])

    best = None
    for sigma in (0.002, 0.01, 0.05, 0.15):
        start = [math.log(sigma), -3.0, 1.0] if name == "two-lobe" else [math.log(sigma)]
        how = {"xatol": 1e-5, "fatol": 1e-8, "maxiter": 4000}
        found = minimize(lambda x: misfit(lobe_of(*model(x)), wanted)[0], start, method="Nelder-Mead", options=how)
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    form, sigma = model(best.x)
    error, height = misfit(lobe_of(form, sigma), wanted)
    return form, sigma, height, error


def row(surface: Measured) -> tuple[str, str | None]:
    """A row of the table, and the line for a part file; None where no form describes the surface."""
    fresnel = ((surface.index - 1.0) / (surface.index + 1.0)) ** 2
    wanted = (1.0 + surface.b * (1.0 - np.cos(DELTA))) ** -surface.c
    peak = surface.a * fresnel * WHITE
    forms = {name: fitted(name, wanted) for name in ("torrance-sparrow", "ggx", "two-lobe")}
    R_d = surface.diffuse * WHITE
    two, wide = forms["two-lobe"], forms["two-lobe"][0].wide_ratio * forms["two-lobe"][1]
    chosen = "ggx" if forms["ggx"][3] <= 1.2 * two[3] or wide > MOST_WIDE else "two-lobe"
    form, sigma, height, _ = forms[chosen]
    own = Reflectance(R_d=R_d, R_s=peak * height, sigma=sigma, model=form)
    albedo = least_white_level(own) / WHITE
    keys = f"R_d: {R_d:.3g}, R_s: {peak * height:.4g}"
    if chosen == "ggx":
        keys += f", alpha: {2.0 * sigma:.3g}"
    else:
        wide = f"R_s_wide: {peak * height * form.wide_share:.4g}, sigma_wide_rad: {sigma * form.wide_ratio:.3g}"
        keys += f", sigma_rad: {sigma:.3g}, {wide}"
    misfits = " / ".join(f"{100.0 * one[3]:.0f}" for one in forms.values())
    block = f"reflectance: {{model: {chosen}, {keys}, white_level: {WHITE:g}}}   # {surface.finish}"
    described = forms[chosen][3] <= MOST_MISFIT
    return (
        f"| {surface.finish} | {chosen if described else 'none'} | {misfits} | {albedo:.2f} |",
        block if described else None,
    )


def brushed_row(surface: Brushed) -> tuple[str, str]:
    """A row of the table of brushed surfaces, and the line for a part file: one Gaussian lobe has σ = α/√2."""
    R_d, R_s = surface.diffuse * WHITE, surface.specular * WHITE / (4.0 * surface.along * surface.across)
    keys = f"R_d: {R_d:.3g}, R_s: {R_s:.4g}"
    if surface.form == "ggx":
        keys = f"model: ggx, {keys}, alpha: {surface.along:.3g}, alpha_across: {surface.across:.3g}"
        form = SpecularModel(name="ggx", across_ratio=surface.across / surface.along)
        share = least_white_level(Reflectance(R_d=R_d, R_s=R_s, sigma=0.5 * surface.along, model=form)) / WHITE
    else:
        sigma, across = surface.along / math.sqrt(2.0), surface.across / math.sqrt(2.0)
        keys += f", sigma_rad: {sigma:.3g}, sigma_across_rad: {across:.3g}"
        share = surface.diffuse + surface.specular
    brushing = "brushing: {direction: [1, 0, 0]}"
    return (
        f"| {surface.finish} | {surface.form} | {surface.along:.2g} / {surface.across:.2g} | {share:.2f} |",
        f"reflectance: {{{keys}, {brushing}, white_level: {WHITE:g}}}   # {surface.finish}",
    )


class Satin(NamedTuple):
    """A surface known by its gloss only: the share of light that it reflects, and readings at 60° [gloss units]."""

    finish: str
    share: float
    readings: tuple[float, ...]


SATIN = (Satin("satin anodised aluminium", 0.70, (30.0, 50.0, 70.0)), Satin("satin nickel", 0.55, (50.0, 100.0, 200.0)))
GLOSS_ANGLE = math.radians(60.0)
RECEPTOR, SOURCE = np.radians([4.4, 11.7]), np.radians([0.75, 2.5])  # sides of the apertures, in and across the plane
STANDARD = 0.1001  # of the light at 60° is reflected by black glass of index 1.567, which has 100 gloss units


def satin_reflectance(share: float, alpha: float) -> Reflectance:
    """GGX alone, of a surface that reflects a share of the light along its normal."""
    one = Reflectance(R_d=0.0, R_s=1.0, sigma=0.5 * alpha, model=SpecularModel(name="ggx"))
    return Reflectance(R_d=0.0, R_s=share * WHITE / least_white_level(one), sigma=0.5 * alpha, model=one.model)


def _directions(sides: np.ndarray, count: int) -> np.ndarray:
    # unit vectors of the middles of a rectangle of angles about the direction of 60°
    middles = (np.arange(count) + 0.5) / count - 0.5
    off, across = (side * middles for side in sides)
    theta, phi = np.meshgrid(GLOSS_ANGLE + off, across, indexing="ij")
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(phi), np.cos(theta) * np.cos(phi)], axis=-1).reshape(-1, 3)


def gloss(reflectance: Reflectance, *, nodes: int = 24) -> float:
    """What a gloss meter of 60° reads [gloss units]."""
    lobe, total = reflectance.lobe, 0.0
    sources, receptors = _directions(SOURCE, 3), _directions(RECEPTOR, nodes) * [-1.0, 1.0, 1.0]
    solid_angle = float(np.prod(2.0 * np.sin(0.5 * RECEPTOR))) / len(receptors)
    for light in sources:
        for view in receptors:
            half = light + view
            size = float(np.linalg.norm(half))
            chord = float(np.sum((half / size - [0.0, 0.0, 1.0]) ** 2))
            value = specular_lobe(chord, 0.0, lobe) * light_factor(float(light[2]), 0.0, size, lobe)
            level = reflectance.R_s * value / specular_divisor(float(view[2]), 0.0, lobe)
            total += level / (math.pi * WHITE) * view[2] * solid_angle / light[2]
    return 100.0 * total / len(sources) / STANDARD


def satin_row(surface: Satin, reading: float) -> tuple[str, str]:
    """A row of the table of surfaces known by their gloss, and the line for a part file."""

    def off(log_alpha: float) -> float:
        return math.log(gloss(satin_reflectance(surface.share, math.exp(log_alpha))) / reading)

    own = satin_reflectance(surface.share, math.exp(brentq(off, math.log(0.02), math.log(0.9), xtol=1e-4)))
    alpha, name = 2.0 * own.sigma, f"{surface.finish}, {reading:g} gloss units"
    keys = f"R_d: 0, R_s: {own.R_s:.4g}, alpha: {alpha:.3g}, white_level: {WHITE:g}"
    return (f"| {name} | ggx | {alpha:.2g} | {surface.share:.2f} |", f"reflectance: {{model: ggx, {keys}}}   # {name}")


def main() -> None:
    """Compute the table and put it into the page."""
    rows, blocks = zip(*map(row, SURFACES), strict=True)
    head = "| surface | nearest form | misfit of one lobe / GGX / two lobes [%] | share of light reflected |"
    lines = [block for block in blocks if block is not None]
    text = "\n".join([head, "|---|---|---|---|", *rows, "", "```yaml", *lines, "```"])
    rows, lines = zip(*map(brushed_row, BRUSHED), strict=True)
    head = "| surface with a direction | form | α along / across | share of light reflected |"
    text += "\n\n" + "\n".join([head, "|---|---|---|---|", *rows, "", "```yaml", *lines, "```"])
    rows, lines = zip(*(satin_row(one, reading) for one in SATIN for reading in one.readings), strict=True)
    head = "| surface, by its gloss at 60° | form | α | share of light reflected, assumed |"
    text += "\n\n" + "\n".join([head, "|---|---|---|---|", *rows, "", "```yaml", *lines, "```"])
    page = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- begin finishes -->", "<!-- end finishes -->"
    pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    PAGE.write_text(pattern.sub(lambda _: f"{begin}\n{text}\n{end}", page), encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
