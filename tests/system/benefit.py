"""The benefit of ``detectability``, counted: random defects seen under its lights, and under those of ``paper``.

``python tests/system/benefit.py [PART.yaml …] [--plan [--finish satin]] [--out DIR]``; the sample parts by default. A
catalogue is strewn over what the camera sees, rendered under each set of lights and exposed with noise; an image shows
a defect where one of its pixels passes the plain contrast test, and a defect is seen where enough images show it.
Beside each count is the objective's own: defects with a bit set on the patch of one of their walls, in as many images.

*Lights*: the best set for ``detectability`` against the best for ``paper``, in the part's first posture: for both
finishes, for one image and for two, and with free azimuths (±45° about the rig's) where a part is named in FREE.

*Plan* (``--plan``): postures of the stage chosen with one set of lights, against as many of the part's own, planned for
the same goal in the same way; both at exposure 1 and with shorter and longer exposures offered, planned as the command
plans them; defects over all that any candidate posture sees. As the part's file says, or ``--finish satin``.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

from benefit_plans import plans
from benefit_sets import DEFECTS, sets
from benefit_views import Row
from truth import FINISHES, PARTS, RIG

from lightopt import load_part, load_rig

__all__ = ["Row", "main", "plans", "sets", "table"]


def table(rows: Sequence[Row]) -> str:
    """A line for each row."""
    lines = [
        "| part | surface | images | set | lights | share | predicted | counted |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.part} | {r.finish} | {r.min_images} | {r.what} | {r.lights} | {100.0 * r.share:.1f} % | "
        f"{r.predicted} of {r.defects} | {r.counted} |"
        for r in rows
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Count, print a table, write all rows."""
    parser = argparse.ArgumentParser(prog="python tests/system/benefit.py", description=__doc__)
    parser.add_argument("parts", nargs="*", type=Path, metavar="PART", default=list(PARTS), help="part files")
    parser.add_argument("--rig", type=Path, default=RIG, help="rig file")
    parser.add_argument("--plan", action="store_true", help="postures and exposures instead of lights")
    parser.add_argument("--finish", choices=FINISHES, default="glossy", help="of a plan's surface")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--defects", type=int, default=DEFECTS, help="how many are strewn")
    parser.add_argument("--out", type=Path, default=Path("out/benefit"), help="folder of benefit.csv or plan.csv")
    options = parser.parse_args(arguments)
    rig = load_rig(options.rig)
    rows: list[Row] = []
    for path in options.parts:
        part = load_part(path)
        sizes = {"patches": options.patches, "defects": options.defects}
        made = plans(rig, part, finish=options.finish, **sizes) if options.plan else sets(rig, part, **sizes)
        for row in made:
            rows.append(row)
            print(table(rows).splitlines()[-1], flush=True)
    print("\n" + table(rows))
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / ("plan.csv" if options.plan else "benefit.csv")
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["part", "surface", "min_images", "set", "lights", "share", "defects", "predicted", "counted"])
        for r in rows:
            numbers = (f"{r.share:.6f}", r.defects, r.predicted, r.counted)
            writer.writerow([r.part, r.finish, r.min_images, r.what, r.lights, *numbers])
    print(path)


if __name__ == "__main__":
    main()
