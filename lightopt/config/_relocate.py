"""What changes in a configuration file when a copy of it lies in another folder."""

from __future__ import annotations

import json
import os
from pathlib import Path

from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig
from lightopt.config._source import Keys

__all__ = ["relocated"]


def relocated(config: RigConfig | PartConfig, folder: Path) -> dict[Keys, str]:
    """Paths that a copy of a configuration file in another folder must say anew, for :func:`with_values`.

    Files are named relative to the configuration file: a part's mesh, and the folder that a rig's camera replays.

    Parameters
    ----------
    config
        The configuration, as read from its file.
    folder
        Where the copy will lie.

    Returns
    -------
    dict
        New text of each value by its path of keys; empty where the names hold.
    """
    values: dict[Keys, str] = {}
    for keys, name in _names(config).items():
        target = config.source.resolve(name).resolve()
        if target != (folder / name).resolve():
            values[keys] = json.dumps(_path_from(folder.resolve(), target), ensure_ascii=False)
    return values


def _names(config: RigConfig | PartConfig) -> dict[Keys, str]:
    if isinstance(config, PartConfig):
        return {("mesh", "file"): config.mesh.file}
    if config.hardware is None or config.hardware.camera.folder is None:
        return {}
    return {("hardware", "camera", "folder"): config.hardware.camera.folder}


def _path_from(folder: Path, target: Path) -> str:
    try:
        return Path(os.path.relpath(target, folder)).as_posix()
    except ValueError:  # another drive
        return target.as_posix()
