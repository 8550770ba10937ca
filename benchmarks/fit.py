"""The fit to 16 images, from files to intervals, against rendering one of those images."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks._case import CONFIGS, Size
from benchmarks._report import Report, Table, ratios, rounds
from benchmarks.bare import THREADS
from benchmarks.command import write_rig
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.run_context import RunContext
from lightopt.estimate.reflectance import FitOptions, fit_specular
from lightopt.images import read_image_set
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, render_posture
from lightopt.scene import build_scene

TARGET = 60.0
PART = CONFIGS / "parts" / "cover-knob.yaml"
PANELS = {"m = 4": None, "points: auto": "auto"}


def run(size: Size) -> Report:
    """Measure fits of R_d, R_s and σ to four lights in four postures, with and without validation."""
    rows: list[tuple[str, ...]] = []
    numbers: dict[str, object] = {}
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        folder = Path(name)
        rig = write_rig(folder / "rig.yaml", size.width)
        for panel, points in PANELS.items():
            images = folder / panel.replace(": ", "-").replace(" = ", "")
            render_image_set(
                rig, PART, images, options=RenderOptions(points=points, noise=1), run=RunContext(threads=THREADS)
            )
            found = rounds(_tasks(load_rig(rig), load_part(PART), images, points), min(3, size.repeats))
            one = found["one image"]
            numbers[panel] = found
            for name in ("fit", "fit, validated"):
                least, median = ratios(found[name], one)
                rows.append(
                    (f"{panel}: {name}", f"{min(one):.2f}", f"{min(found[name]):.1f}", f"{least:.1f}", f"{median:.1f}")
                )
    return Report(
        "fit",
        [
            Table(
                f"fit-specular --joint to 16 images {size.width} px wide, against rendering one of them "
                f"(target < {TARGET:g})",
                ("", "one image s", "fit s", "ratio of least", "median ratio"),
                rows,
            )
        ],
        numbers,
        [
            f"one image: one light in one posture, from mesh in memory to floats, {THREADS} threads",
            "fit: from YAML, STEP and PNG files to values, standard errors and profile intervals",
            "validated: and every light left out in turn",
        ],
    )


def _tasks(rig: RigConfig, part: PartConfig, images: Path, points: int | str | None) -> dict[str, Callable[[], object]]:
    scene = build_scene(rig, part, points=points)  # type: ignore[arg-type]
    alone = replace(scene, lights=scene.lights[:1])

    def fit(validate: bool) -> object:
        tried = () if points is None else (points,)
        options = FitOptions(joint=True, validate=validate, points=tried)  # type: ignore[arg-type]
        return fit_specular(rig, part, read_image_set(images), options=options, run=RunContext(threads=THREADS))

    return {
        "one image": lambda: render_posture(alone, alone.postures[0], caster=cast_rays_at(alone), threads=THREADS),
        "fit": lambda: fit(False),
        "fit, validated": lambda: fit(True),
    }
