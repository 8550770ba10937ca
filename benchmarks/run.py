"""``python -m benchmarks.run [NAMES] [--quick]``: print the tables and write them to out/bench/NAME.json."""

from __future__ import annotations

import argparse
import importlib
import json
import os
from pathlib import Path

from benchmarks._case import FULL, QUICK, TOY, Size
from benchmarks._report import Report, machine

NAMES = (
    "bare",
    "peers",
    "auto",
    "command",
    "search",
    "detectability",
    "plan",
    "fit",
    "inspecting",
    "capture",
    "growth",
)


def main(arguments: list[str] | None = None) -> None:
    """Run benchmarks one after the other."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(NAMES)}; all by default")
    parser.add_argument("--quick", action="store_true", help="a smaller case and fewer rounds")
    parser.add_argument("--toy", action="store_true", help="a tiny case: does it run at all")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="folder of the JSON files")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(NAMES))
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(NAMES)}")
    size = TOY if options.toy else QUICK if options.quick else FULL
    about = machine()
    print(f"{about['cpu']}, {about['cores']} cores, Python {about['python']}, load {about['load']}")
    print(", ".join(f"{name} {version}" for name, version in dict(about["versions"]).items()))  # type: ignore[call-overload]
    for name in options.names or NAMES:
        before = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        report: Report = importlib.import_module(f"benchmarks.{name}").run(size)
        print(f"\n== {name} ({size.name} size; load of the machine at the start {before})")
        for note in report.notes:
            print(note)
        for table in report.tables:
            print(f"\n{table.text()}")
        path = save(report, size, about, before, options.out)
        print(f"\n{path}", flush=True)


def save(report: Report, size: Size, about: dict[str, object], load: float | None, folder: Path) -> Path:
    """Write a report as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{report.name}.json"
    document = {
        "benchmark": report.name,
        "size": vars(size),
        "machine": {**about, "load_at_start": load},
        "notes": list(report.notes),
        "tables": [
            {"title": t.title, "header": list(t.header), "rows": [list(row) for row in t.rows]} for t in report.tables
        ],
        "numbers": dict(report.numbers),
    }
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    main()
