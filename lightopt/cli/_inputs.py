from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig


def load_inputs(rig: Path, part: Path | None) -> tuple[RigConfig, PartConfig | None]:
    """Read a rig file and, where there is one, a part file, and report all errors of both at once."""
    from lightopt.config import load_part, load_rig

    problems: list[str] = []
    loaded_rig = loaded_part = None
    try:
        loaded_rig = load_rig(rig)
    except InputError as error:
        problems += error.messages
    if part is not None:
        try:
            loaded_part = load_part(part)
        except InputError as error:
            problems += error.messages
    if problems or loaded_rig is None:
        raise InputError(*problems)
    return loaded_rig, loaded_part
