"""Comparing two patch tables."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.images.comparison._channels import ChannelDifference, Thresholds, compare_arrays
from lightopt.images.comparison._files import FileComparison


def compare_tables(a: Path, b: Path, thresholds: Thresholds) -> FileComparison:
    """Compare the arrays of two ``.npz`` files: floats within `geometry_absolute`, the rest exactly."""
    reasons: list[str] = []
    golden, new = _load("golden", a, reasons), _load("new", b, reasons)
    if reasons:
        return FileComparison(str(a), str(b), reasons=tuple(reasons))
    if golden.keys() != new.keys():
        reasons.append(f"different arrays: golden {sorted(golden)}, new {sorted(new)}")
    channels: list[ChannelDifference] = []
    for name in sorted(golden.keys() & new.keys()):
        old, now = golden[name], new[name]
        if old.shape != now.shape or old.dtype.kind != now.dtype.kind:
            reasons.append(f"{name}: golden {old.dtype} {old.shape}, new {now.dtype} {now.shape}")
        elif old.dtype.kind in "biuf":
            absolute = thresholds.geometry_absolute if old.dtype.kind == "f" else 0.0
            share = thresholds.max_share
            channels.append(compare_arrays(name, old, now, absolute=absolute, relative=0, max_share=share))
        elif not np.array_equal(old, now):
            reasons.append(f"{name}: different texts")
    reasons += [reason for channel in channels for reason in channel.reasons]
    return FileComparison(str(a), str(b), channels=tuple(channels), reasons=tuple(reasons))


def _load(role: str, path: Path, reasons: list[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays; where that fails, add the reason."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        reasons.append(f"{role} file is missing: {path}")
    except (
        OSError,
        ValueError,
        EOFError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        reasons.append(f"{role} file is no readable .npz: {path}: {error}")
    return {}
