"""A measured lobe: a table of δ, or a material of the MERL database, read from its file.

W. Matusik, H. Pfister, M. Brand, L. McMillan: A data-driven reflectance model, ACM Transactions on Graphics 22 (3),
2003, doi:10.1145/882262.882343
"""

import csv
import math
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.optics import gaussian_sum

LARGEST_ERROR = 0.1  # of the sum of lobes that follows a table, as a share

_MOST_ROWS = 100_000
_LIGHT_CONES_DEG = 30.0  # angles between light and half vector whose mean the lobe is
_LAST_DEG = 80.0  # angle δ at which a MERL table is cut
_MERL_SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0


def table_lobes(path: Path) -> tuple[tuple[float, float], ...]:
    """Height and σ [rad] of each Gaussian lobe whose sum follows a file's table, from the narrowest on.

    Raises InputError: The file is no table of a lobe, or no sum of Gaussian lobes follows it to 10 %, noise
        aside.
    """
    try:
        delta, value = _merl(path) if path.suffix.lower() == ".binary" else _rows(path)
        found = gaussian_sum(delta, value)
    except OSError as failed:
        raise InputError(f"{path}: {failed.strerror or failed}") from failed
    except InputError as failed:
        raise InputError(f"{path}: {failed.args[0]}") from None
    if found.error > LARGEST_ERROR:
        raise InputError(
            f"{path}: the lobes that model measured adds up follow the table only to {100.0 * found.error:.0f} %, at "
            f"δ = {math.degrees(found.worst):.2g} degrees (most {100.0 * LARGEST_ERROR:.0f} %): expected a lobe that "
            "falls steadily, without an edge or a second peak; check the rows there, end the table before them, or use "
            "model ggx or two-lobe"
        )
    return found.lobes


def _rows(path: Path) -> tuple[Float64, Float64]:
    # angle [°] and value in each line; a first line of words is a heading
    rows: list[tuple[float, float]] = []
    with path.open(encoding="utf-8", newline="") as file:
        try:
            for number, cells in enumerate(csv.reader(file), start=1):
                if not cells or (number == 1 and not _is_number(cells[0])):
                    continue
                if len(cells) != 2 or not all(map(_is_number, cells)):
                    raise InputError(f"line {number}: expected δ in degrees and the lobe's value, two numbers")
                rows.append((float(cells[0]), float(cells[1])))
        except (UnicodeDecodeError, csv.Error):
            raise InputError("expected a text file with two columns, δ in degrees and the lobe's value") from None
    table = np.array(rows).reshape(-1, 2)
    if not 5 <= len(table) <= _MOST_ROWS:
        raise InputError(f"expected 5 to {_MOST_ROWS} rows, found {len(table)}")
    delta, value = np.radians(table[:, 0]), table[:, 1]
    if np.any(np.diff(delta) <= 0.0) or not 0.0 <= delta[0] <= 0.02 * delta[-1] or delta[-1] > 0.5 * math.pi:
        raise InputError("expected ascending angles from 0, or nearly so, up to at most 90 degrees")
    if np.any(value < 0.0):
        raise InputError("expected values of 0 and above")
    return delta, value


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _merl(path: Path) -> tuple[Float64, Float64]:
    # what of the mean of the colours is above the diffuse light, times cosθ_i cosθ_o, where light and camera are beside
    # each other (φ_d = 90°), where both cosines are cosδ cosθ_d
    size = np.fromfile(path, np.int32, 3)
    shape = tuple(size.tolist())
    if len(shape) != 3 or min(shape) < 2 or path.stat().st_size != 12 + 24 * math.prod(shape):
        raise InputError("expected a material of the MERL database: three counts, and as many values of three colours")
    colours = np.fromfile(path, np.float64, offset=12).reshape(3, *shape)[..., shape[2] // 2]
    theta_h = 0.5 * math.pi * (np.arange(shape[0]) / shape[0]) ** 2
    theta_d = 0.5 * math.pi * np.arange(shape[1]) / shape[1]
    brdf = np.tensordot(_MERL_SCALES / 3.0, np.where(colours < 0.0, np.nan, colours), axes=1)
    brdf = brdf[theta_h <= math.radians(_LAST_DEG)][:, theta_d <= math.radians(_LIGHT_CONES_DEG)]
    theta_h, theta_d = theta_h[: len(brdf)], theta_d[: brdf.shape[1]]
    if not np.isfinite(brdf[0]).all():
        raise InputError("the table has no values at its peak")
    diffuse = np.nanmin(np.nanmean(brdf, axis=1))
    lobe = np.maximum(brdf - diffuse, 0.0) * (np.cos(theta_h)[:, None] * np.cos(theta_d)) ** 2
    value = np.nanmean(lobe, axis=1)
    return theta_h, np.nan_to_num(value)
