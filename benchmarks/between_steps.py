"""Does the bound for positions between the candidates hold: grids of several steps, and the best of a finer one.

``python -m benchmarks.between_steps [--patches 20000] [--cases four-panel,spot]``. For each step the best score, the
bound, and what of it was found inside cells. The best of the finest grid must not exceed any bound.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks._case import CONFIGS
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design import OptimizeOptions, optimize

STEPS = (20.0, 10.0, 5.0, 1.0)


@dataclass(frozen=True)
class Case:
    """A rig and a part, with what is changed in their files."""

    rig: str
    part: str
    objective: str
    lights: tuple[str, str] = ("", "")  # in the rig file
    lobe: tuple[str, str] = ("", "")  # in the part file
    distance_steps: tuple[float, ...] = ()  # in place of STEPS


GLOSSY = ("sigma_rad: 0.0475", "sigma_rad: 0.004")
CASES = {
    "four-panel": Case("four-panel", "spout", "coverage"),
    "four-panel, paper": Case("four-panel", "spout", "paper"),
    "four-panel, defects": Case("four-panel", "spout", "detectability"),
    "four-panel, glossy": Case("four-panel", "spout", "coverage", lobe=GLOSSY),
    "spot, glossy": Case("spot", "spout", "detectability", lobe=GLOSSY),
    "display": Case(
        "display-stripes",
        "spout",
        "detectability",
        ("azimuth_deg: 90\n", "azimuth_deg: 90\n    elevation_range_deg: [25, 45]\n"),
    ),
    "dome": Case(
        "dome-quadrants",
        "spout",
        "detectability",
        ("segments: 4\n", "segments: 4\n    distance_range_mm: [10, 60]\n    distance_step_mm: STEP\n"),
        distance_steps=(50.0, 25.0, 12.5, 5.0),
    ),
}


def load(case: Case, step: float, folder: Path) -> tuple[RigConfig, PartConfig]:
    """The case's files, changed where it says so."""
    rig, part = folder / "rig.yaml", folder / f"{case.part}.yaml"
    text = (CONFIGS / "rigs" / f"{case.rig}.yaml").read_text(encoding="utf-8")
    assert case.lights[0] in text
    rig.write_text(text.replace(*case.lights).replace("STEP", f"{step:g}"), encoding="utf-8")
    text = (CONFIGS / "parts" / f"{case.part}.yaml").read_text(encoding="utf-8")
    assert case.lobe[0] in text
    text = text.replace("file: ", f"file: {CONFIGS.resolve()}/parts/")
    part.write_text(text.replace(*case.lobe), encoding="utf-8")
    return load_rig(rig), load_part(part)


def main() -> None:
    """Print a line per case and step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patches", type=int, default=20_000)
    parser.add_argument("--cases", default=";".join(CASES), help="names, separated by semicolons")
    options = parser.parse_args()
    print("case | step | best | bound | of it inside")
    for name in options.cases.split(";"):
        case = CASES[name]
        bounds: list[int] = []
        for step in case.distance_steps or STEPS:
            with tempfile.TemporaryDirectory() as folder:
                rig, part = load(case, step, Path(folder))
                request = OptimizeOptions(
                    objectives=(case.objective,),
                    step_deg=5.0 if case.distance_steps else step,
                    min_images=min(2, len(rig.lights)),
                    postures=(Posture(0.0, 0.0),),
                    patch_budget=options.patches,
                    images=False,
                )
                result = optimize(rig, part, Path(folder) / "out", options=request, run=RunContext())
            one, answer = result.results[0], result.results[0].answers[0]
            best, between = answer.found.best.score, answer.between
            assert between is not None
            whole = answer.objective.full_score(one.area)
            texts = [f"{best:,}", f"{between.bound:,}"]
            if whole is not None:
                texts = [f"{100.0 * score / whole:.2f} %" for score in (best, between.bound)]
            bounds.append(between.bound)
            print(f"{name} | {step:g} | {texts[0]} | {texts[1]} | {100.0 * between.excess:.2f} %", flush=True)
        print(f"{name}: finest best exceeds a bound: {'yes' if best > min(bounds) else 'no'}", flush=True)


if __name__ == "__main__":
    main()
