"""Check, render and optimise every part of a folder: ``python scripts/batch.py RIG PARTS --step 5 --out out/batch``.

Each part gets a folder of its own with ``images/`` (the rig as it is) and ``best/`` (the optimised rig). A part that
fails does not stop the others and makes the exit status 1. A second run does only what changed: images that are there
are kept, kept luminance matrices are reused; where rig, part, mesh or options changed, the results are made anew.
Ctrl-C ends it with the summary of what was done and exit status 130.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

INTERRUPTED = 130

OWN = {("lightopt-images", "simulated"), ("lightopt-optimum", "simulated")}

HEADER = ("part", "check", "render", "optimize", "seconds", "posture", "share", "lights (elevation, azimuth)")


def main(arguments: list[str] | None = None) -> int:
    """Run the batch; returns the exit status."""
    parser = argparse.ArgumentParser(prog="batch", description="Check, render and optimise every part of a folder.")
    parser.add_argument("rig", type=Path, help="rig file (YAML)")
    parser.add_argument("parts", type=Path, help="folder of part files (*.yaml)")
    parser.add_argument("--step", default="5", help="step of the angles [deg]")
    parser.add_argument("--out", type=Path, default=Path("out/batch"), help="output folder")
    parser.add_argument("--options", default="", help="further options of lightopt optimize, in one text")
    options = parser.parse_args(arguments)
    parts = sorted(path for path in options.parts.glob("*.yaml") if path.is_file())
    if not parts:
        print(f"error: {options.parts}: no part file (*.yaml) is there; give the folder of the parts", file=sys.stderr)
        return 2
    rows: list[tuple[str, ...]] = []
    tried, failed = 0, list[str]()
    interrupted = False
    for part in parts:
        own, interrupted = run_part(options.rig, part, options.step, options.options.split(), options.out)
        rows += own
        tried += 1
        failed += [part.stem] if "failed" in own[0] else []
        if interrupted:
            break
    widths = [max(len(row[i]) for row in (HEADER, *rows)) for i in range(len(HEADER))]
    table = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in (HEADER, *rows)]
    print("\n" + "\n".join(table))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "summary.txt").write_text("\n".join(table) + "\n", encoding="utf-8")
    if interrupted:
        done = f"{tried - 1} of {len(parts)} parts were done before"
        print(f"interrupted: {done}; the same command continues", file=sys.stderr)
        return INTERRUPTED
    if failed:
        print(f"error: {len(failed)} of {tried} parts failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def run_part(rig: Path, part: Path, step: str, more: list[str], out: Path) -> tuple[list[tuple[str, ...]], bool]:
    """Check, render and optimise a part; what fails keeps the rest from being tried.

    Rows, one for each set of lights and so for each posture, or one for all; and whether Ctrl-C was pressed.
    """
    print(f"== {part}", flush=True)
    folder = out / part.stem
    begun = time.perf_counter()
    best, images = folder / "best", folder / "images"
    commands = (
        (["check", str(rig), str(part)], None),
        (["render", str(rig), str(part), "-o", str(images), "--quiet"], images / "manifest.json"),
        (
            ["optimize", str(rig), str(part), "-o", str(best), "--step", step, "--keep-matrix", *more],
            best / "result.json",
        ),
    )
    said: list[str] = []
    for command, result in commands:
        said.append("-" if {"failed", "stopped"} & set(said) else lightopt(command, part, result))
    sets = summary(best / "result.json") if said[-1] == "ok" else [("-", "-", "-")]
    first = (part.stem, *said, f"{time.perf_counter() - begun:.1f}")
    rows = [(*(first if k == 0 else ("",) * len(first)), *own) for k, own in enumerate(sets)]
    return rows, "stopped" in said


def lightopt(command: list[str], part: Path, result: Path | None) -> str:
    """Run a command: ok, failed or stopped. Its own earlier result of the same part is replaced where inputs changed.

    Its messages go to the terminal.
    """
    done = call(command)
    if done.returncode == 2 and "use --force" in done.stderr and result is not None and is_own(result, part):
        print("was made from other inputs, and is made anew", flush=True)
        done = call([*command, "--force"])
    print(done.stdout, end="", flush=True)
    print(done.stderr, end="", file=sys.stderr, flush=True)
    return "ok" if done.returncode == 0 else "stopped" if done.returncode == INTERRUPTED else "failed"


def is_own(result: Path, part: Path) -> bool:
    """Whether a result.json or manifest.json is lightopt's, computed, of the part file of this name."""
    try:
        found = json.loads(result.read_text(encoding="utf-8"))
        kind = (str(found["format"]).partition("/")[0], found.get("kind", "simulated"))
        made_from = found["part"] if "part" in found else found["provenance"]["inputs"]["part"]
        return kind in OWN and made_from["file"] == part.name
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return False


def call(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a lightopt command; where Ctrl-C is pressed, it has it too, and ends by itself."""
    process = subprocess.Popen(
        [sys.executable, "-m", "lightopt", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )
    stopped = False
    while True:
        try:
            out, err = process.communicate()
        except KeyboardInterrupt:
            stopped = True
            continue
        return subprocess.CompletedProcess(command, INTERRUPTED if stopped else process.returncode, out, err)


def summary(path: Path) -> list[tuple[str, str, str]]:
    """Of each set of lights its posture, or how many, the share by the first objective, and the best positions."""
    sets: list[tuple[str, str, str]] = []
    for group in json.loads(path.read_text(encoding="utf-8"))["results"]:
        answer, postures = group["objectives"][0], group["postures"]
        share = answer.get("share_of_inspectable_area")
        angles = [f"{light['elevation_deg']:g},{light['azimuth_deg']:g}" for light in answer["lights"]]
        one = f"{postures[0]['elevation_deg']:g},{postures[0]['rotation_deg']:g}"
        sets.append(
            (
                one if len(postures) == 1 else f"all {len(postures)}",
                "-" if share is None else f"{100.0 * share:.1f} %",
                " ".join(angles),
            )
        )
    return sets


if __name__ == "__main__":
    sys.exit(main())
