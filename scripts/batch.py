"""Check, render and optimise every part of a folder: ``python scripts/batch.py RIG PARTS --step 5 --out out/batch``.

Each part gets a folder of its own with ``images/`` (the rig as it is) and ``best/`` (the optimised rig). A part that
fails does not stop the others and makes the exit status 1. A second run does only what changed: images that are there
are kept, kept luminance matrices are reused; where rig, part, mesh or options changed, the results are made anew.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

HEADER = (
    "part",
    "check",
    "render",
    "optimize",
    "coverage",
    "lights (elevation, azimuth) per posture",
    "seconds",
)


def main(arguments: list[str] | None = None) -> int:
    """Run the batch; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="batch", description="Check, render and optimise every part of a folder."
    )
    parser.add_argument("rig", type=Path, help="rig file (YAML)")
    parser.add_argument("parts", type=Path, help="folder of part files (*.yaml)")
    parser.add_argument("--step", default="5", help="step of the angles [deg]")
    parser.add_argument("--out", type=Path, default=Path("out/batch"), help="output folder")
    parser.add_argument("--options", default="", help="further options of lightopt optimize, in one text")
    options = parser.parse_args(arguments)
    parts = sorted(path for path in options.parts.glob("*.yaml") if path.is_file())
    if not parts:
        print(
            f"error: {options.parts}: no part file (*.yaml) is there; give the folder of the parts",
            file=sys.stderr,
        )
        return 2
    rows = [run_part(options.rig, part, options.step, options.options.split(), options.out) for part in parts]
    widths = [max(len(row[i]) for row in (HEADER, *rows)) for i in range(len(HEADER))]
    table = [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in (HEADER, *rows)
    ]
    print("\n" + "\n".join(table))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "summary.txt").write_text("\n".join(table) + "\n", encoding="utf-8")
    failed = [row[0] for row in rows if "failed" in row]
    if failed:
        print(f"error: {len(failed)} of {len(rows)} parts failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def run_part(rig: Path, part: Path, step: str, more: list[str], out: Path) -> tuple[str, ...]:
    """Check, render and optimise a part; what fails keeps the rest from being tried."""
    print(f"== {part}", flush=True)
    folder = out / part.stem
    begun = time.perf_counter()
    commands = {
        "check": ["check", str(rig), str(part)],
        "render": ["render", str(rig), str(part), "-o", str(folder / "images"), "--quiet"],
        "optimize": [
            "optimize", str(rig), str(part), "-o", str(folder / "best"), "--step", step, "--keep-matrix", *more
        ],
    }  # fmt: skip
    said: list[str] = []
    for command in commands.values():
        said.append("-" if "failed" in said else "ok" if lightopt(command) else "failed")
    coverage, lights = summary(folder / "best" / "result.json") if said[-1] == "ok" else ("-", "-")
    return (part.stem, *said, coverage, lights, f"{time.perf_counter() - begun:.1f}")


def lightopt(command: list[str]) -> bool:
    """Whether a command succeeds; the result of other inputs is replaced. Its messages go to the terminal."""
    done = call(command)
    if done.returncode == 2 and "use --force" in done.stderr:
        print("was made from other inputs, and is made anew", flush=True)
        done = call([*command, "--force"])
    print(done.stdout, end="", flush=True)
    print(done.stderr, end="", file=sys.stderr, flush=True)
    return done.returncode == 0


def call(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a lightopt command."""
    return subprocess.run(
        [sys.executable, "-m", "lightopt", *command],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


def summary(path: Path) -> tuple[str, str]:
    """Least covered share over the postures, and the best positions."""
    results = json.loads(path.read_text(encoding="utf-8"))["results"]
    first = [group["objectives"][0] for group in results]
    shares = [
        answer["share_of_visible_area"] for answer in first if answer.get("share_of_visible_area") is not None
    ]
    lights = "; ".join(
        " ".join(f"{light['elevation_deg']:g},{light['azimuth_deg']:g}" for light in answer["lights"])
        for answer in first
    )
    return (f"{100.0 * min(shares):.1f} %" if shares else "-"), lights


if __name__ == "__main__":
    sys.exit(main())
