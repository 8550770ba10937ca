"""Measure in rounds, describe the machine, print small tables."""

from __future__ import annotations

import gc
import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Table:
    """A table as it is printed."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def text(self) -> str:
        """Columns padded to their widest cell; the first to the left, the others to the right."""
        lines = [list(self.header), *map(list, self.rows)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.header))]
        padded = [
            "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True)))
            for line in lines
        ]
        return "\n".join([self.title, *("  " + line.rstrip() for line in padded)])


@dataclass(frozen=True)
class Report:
    """What a benchmark found: tables for people, `numbers` (seconds, ratios, errors) for programs."""

    name: str
    tables: Sequence[Table]
    numbers: Mapping[str, object]
    notes: Sequence[str] = field(default=())


def rounds(tasks: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Seconds of each task in each round; a round runs every task once, one after the other."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(repeats):
        for name, task in tasks.items():
            gc.collect()
            start = time.perf_counter()
            result = task()
            seconds[name].append(time.perf_counter() - start)
            del result
    return seconds


def ratios(times: Sequence[float], base: Sequence[float]) -> tuple[float, float]:
    """Ratio of the least times, and the median of the rounds' ratios."""
    return min(times) / min(base), statistics.median(a / b for a, b in zip(times, base, strict=True))


def ratio_text(times: Sequence[float], base: Sequence[float]) -> tuple[str, str]:
    """Both ratios as cells of a table."""
    least, median = ratios(times, base)
    return f"{least:.2f}", f"{median:.2f}"


def machine() -> dict[str, object]:
    """What was measured on, with which versions, and how busy it was."""
    packages = ("lightopt", "numpy", "numba", "embreex", "trimesh", "open3d", "mitsuba", "typer")
    versions = {package: version for package in packages if (version := _version(package))}
    return {
        "cpu": _cpu_name(),
        "cores": os.cpu_count() or 1,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
    }


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
