"""Luminance matrices on disk, reused as long as nothing that they depend on has changed.

A kept matrix is an ``.npz`` with the arrays

``key``
    SHA-256 of all that the matrix depends on, as text.
``areas_mm2``
    Of the inspectable patches, shape (p,).
``grazing_mm2``
    Area that the camera sees at a grazing angle.
``light_0``, ``light_1``, …
    Delivered levels under each light of the rig, in its order, uint8 or uint16, shape (candidates, p).
``angles_0_deg``, ``angles_1_deg``, …
    Elevation and azimuth of those candidates, shape (candidates, 2).
``defects_0``, ``defects_1``, …
    Where images are tested for defects: bits of those that are visible, uint64, shape (candidates, p, words).
``patch``, ``grazing``
    With them: indices of the patches, shape (p,), and of those that the camera sees at a grazing angle.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.design.responses._defect_hypotheses import DefectHypothesis
from lightopt.design.responses._luminance_matrix import LuminanceMatrix
from lightopt.design.responses._visibility import Visibility
from lightopt.images import write_npz_atomic


def matrix_key(facts: Mapping[str, Any]) -> str:
    """SHA-256 of JSON facts, independent of their order."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def write_matrix(
    path: Path, matrix: LuminanceMatrix, angles: Sequence[Sequence[tuple[float, float]]], *, key: str
) -> str:
    """Write a matrix atomically, over one of other inputs if need be; returns the file's SHA-256."""
    arrays: dict[str, NDArray[Any]] = {
        "key": np.array(key),
        "areas_mm2": matrix.areas,
        "grazing_mm2": np.array(matrix.grazing_mm2),
    }
    for index, (layer, places) in enumerate(zip(matrix.levels, angles, strict=True)):
        arrays[f"light_{index}"] = layer
        arrays[f"angles_{index}_deg"] = np.array(places, dtype=np.float64)
    seen = matrix.visibility
    if seen is not None:
        arrays |= {f"defects_{index}": words for index, words in enumerate(seen.words)}
        arrays |= {"patch": seen.patch, "grazing": seen.grazing}
    return write_npz_atomic(path, arrays)


def read_matrix(
    path: Path, *, key: str, lights: int, hypotheses: Sequence[DefectHypothesis] | None = None
) -> LuminanceMatrix | None:
    """A cached matrix; None where there is none, it is damaged, or it depends on other inputs."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            # reading an array leaves the check of its sum out where it stops before the end of its file
            if str(arrays["key"]) != key or arrays.zip.testzip() is not None:
                return None
            seen = (
                None
                if hypotheses is None
                else Visibility(
                    hypotheses=tuple(hypotheses),
                    words=tuple(arrays[f"defects_{i}"] for i in range(lights)),
                    areas=arrays["areas_mm2"],
                    patch=arrays["patch"],
                    grazing=arrays["grazing"],
                )
            )
            return LuminanceMatrix(
                levels=tuple(arrays[f"light_{i}"] for i in range(lights)),
                areas=arrays["areas_mm2"],
                visibility=seen,
                grazing_mm2=float(arrays["grazing_mm2"]),
            )
    except Exception:  # noqa: BLE001 - zip, zlib, NumPy's header and tokenizer each have errors of their own
        return None
