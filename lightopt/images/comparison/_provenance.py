"""What a comparison depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightopt.core.provenance import file_sha256, files_sha256, provenance
from lightopt.images import MANIFEST_NAME
from lightopt.images.comparison._channels import Thresholds
from lightopt.images.comparison._files import FileComparison
from lightopt.images.comparison._sets import SetComparison


def comparison_provenance(result: FileComparison | SetComparison, thresholds: Thresholds) -> dict[str, Any]:
    """What a comparison depends on, in the layout of :mod:`lightopt.core.provenance`.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    if isinstance(result, SetComparison):
        inputs = {
            "golden": _set_hashes(result.a, [file.a for file in result.files]),
            "new": _set_hashes(result.b, [file.b for file in result.files]),
        }
    else:
        inputs = {"golden": {"sha256": file_sha256(result.a)}, "new": {"sha256": file_sha256(result.b)}}
    return provenance(inputs, asdict(thresholds))


def _set_hashes(given: str, files: Sequence[str]) -> dict[str, str]:
    manifest = Path(given) / MANIFEST_NAME if Path(given).is_dir() else Path(given)
    names = (Path(file).relative_to(manifest.parent).as_posix() for file in files)
    return {"manifest_sha256": file_sha256(manifest), "files_sha256": files_sha256(manifest.parent, names)}
