"""Choose postures, and one set of light positions for all of them, that show most defects."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.design import OptimizeOptions, PlanOptions, finish_design, optimize, write_design

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    options = OptimizeOptions(step_deg=30, patch_budget=600, images=False)
    plan = PlanOptions(choose_postures=2, posture_step_deg=90)
    result = optimize(rig, part, out, options=options, plan=plan)
    print("postures, in the order of least travel:", *result.options.postures or ())
    finish_design(write_design(result), None)
    print(out / "part.planned.yaml")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-plan"))
