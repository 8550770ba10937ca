"""Find the best light positions for each posture, and write them with a report."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.design import OptimizeOptions, finish_design, optimize, places_of, write_design
from lightopt.report.design import design_report

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    options = OptimizeOptions(objectives=("coverage",), step_deg=10, patch_budget=2000, report=True)
    result = optimize(rig, part, out, options=options)
    for one in result.results:
        best = one.answers[0].found.ranking[0]  # of the first objective
        print(one.postures[0], [f"{elevation:g}°" for elevation, _ in places_of(result.candidates, best)])
    output = write_design(result)
    finish_design(output, design_report(output))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-optimise"))
