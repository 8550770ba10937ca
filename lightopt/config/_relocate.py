"""A copy of a configuration file for another folder, where what it names is found all the same."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from lightopt.config._edit import with_values
from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig
from lightopt.config._source import Keys

_SCHEMA = re.compile(r"^(#\s*yaml-language-server:.*\$schema=)(\S+)", re.MULTILINE)


def copied_text(
    config: RigConfig | PartConfig, folder: Path, values: Mapping[Keys, str] | None = None
) -> str:
    """The text of a configuration file for another folder, all else as a person wrote it.

    Files are named relative to the configuration file: a part's mesh, the folder that a rig's camera replays, and the
    schema in the comment that editors read.

    folder: Where the copy will lie
    values: What else the copy says anew, as for :func:`with_values`
    Raises InputError: As of :func:`with_values`
    """
    said = dict(values or {})
    for keys, name in _names(config).items():
        moved = _moved(config.source.resolve(name), name, folder)
        if moved != name:
            said[keys] = json.dumps(moved, ensure_ascii=False)
    text = with_values(config.source.text, said)
    comment = _SCHEMA.search(text)
    # an address, or a schema that is not there, stays as it is
    if comment is None or not config.source.resolve(comment[2]).is_file():
        return text
    schema = _moved(config.source.resolve(comment[2]), comment[2], folder)
    return text[: comment.start(2)] + schema + text[comment.end(2) :]


def _names(config: RigConfig | PartConfig) -> dict[Keys, str]:
    if isinstance(config, PartConfig):
        return {("mesh", "file"): config.mesh.file}
    if config.hardware is None or config.hardware.camera.folder is None:
        return {}
    return {("hardware", "camera", "folder"): config.hardware.camera.folder}


def _moved(target: Path, name: str, folder: Path) -> str:
    # the name by which a file is found from another folder; the same name where that holds
    target = target.resolve()
    if target == (folder / name).resolve():
        return name
    try:
        return Path(os.path.relpath(target, folder.resolve())).as_posix()
    except ValueError:  # another drive
        return target.as_posix()
