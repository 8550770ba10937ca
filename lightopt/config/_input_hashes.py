"""Hashes of the files that a rig and a part are read from, for the provenance of results."""

from __future__ import annotations

from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig
from lightopt.core.provenance import file_sha256


def input_hashes(rig: RigConfig, part: PartConfig | None) -> dict[str, dict[str, str]]:
    """Names, without folders, and SHA-256 of the rig file and the part file as they were read, and that of the mesh.

    Without a part, of the rig file alone.

    Raises OSError: The mesh cannot be read
    """
    hashes = {"rig": _file(rig)}
    if part is not None:
        hashes["part"] = _file(part)
        hashes["mesh"] = {"sha256": file_sha256(part.source.resolve(part.mesh.file))}
    return hashes


def _file(config: RigConfig | PartConfig) -> dict[str, str]:
    return {"file": config.source.path.name, "sha256": config.source.sha256}
