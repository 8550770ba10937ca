"""Hashes of the files that a rig and a part are read from, for the provenance of results."""

from __future__ import annotations

from typing import Any

from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig
from lightopt.provenance import file_sha256

__all__ = ["input_hashes"]


def input_hashes(rig: RigConfig, part: PartConfig) -> dict[str, dict[str, str]]:
    """Names, without folders, and SHA-256 of the rig file and the part file as they were read, and that of the mesh.

    Raises
    ------
    OSError
        The mesh cannot be read.
    """
    files: dict[str, Any] = {
        name: {"file": config.source.path.name, "sha256": config.source.sha256}
        for name, config in (("rig", rig), ("part", part))
    }
    return {**files, "mesh": {"sha256": file_sha256(part.source.resolve(part.mesh.file))}}
