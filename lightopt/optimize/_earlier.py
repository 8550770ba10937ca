"""The result of an earlier run in the output folder: the same run again, or another one."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lightopt.errors import InputError

__all__ = ["refuse_other_result", "remove_stale"]


def refuse_other_result(path: Path, provenance: Mapping[str, Any]) -> None:
    """Stop before any work where a folder holds the result of other inputs.

    Parameters
    ----------
    path
        The result.json that may be there.
    provenance
        Of the run to come, JSON.

    Raises
    ------
    InputError
        It is there and was made otherwise, or cannot be read.
    """
    if not path.exists():
        return
    found = _read(path)
    advice = "use --force to replace it, or choose another output folder"
    if found is None:
        raise InputError(f"{path}: exists and is not a result of lightopt optimize; {advice}")
    there, now = _flat(found), _flat(provenance)
    differences = [
        f"{key}: there {there.get(key, 'absent')}, now {value}"
        for key, value in now.items()
        if there.get(key) != value
    ]
    if differences:
        raise InputError(f"{path}: the result of another run ({'; '.join(differences)}); {advice}")


def remove_stale(path: Path, written: Iterable[Path]) -> None:
    """Remove the rigs and overlap maps that an earlier result.json lists and the new run did not write."""
    keep = {file.resolve() for file in written}
    earlier = _read(path) or {}
    listed = [(entry, "file") for entry in earlier.get("rigs", [])]
    listed += [(entry, "map") for entry in earlier.get("overlaps", [])]
    for entry, key in listed:
        with suppress(OSError, TypeError, KeyError):
            stale = (path.parent / str(entry[key])).resolve()
            if stale not in keep and stale.is_relative_to(path.parent.resolve()):
                stale.unlink()


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    right = isinstance(found, dict) and str(found.get("format", "")).startswith("lightopt-optimum/")
    return found if right else None


def _flat(facts: Mapping[str, Any]) -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in facts.items():
        inner = value.items() if isinstance(value, dict) else [(None, value)]
        for name, leaf in inner:
            if (key, name) not in (("rig", "file"), ("part", "file")):
                flat[key if name is None else f"{key}.{name}"] = json.dumps(leaf, sort_keys=True)
    return flat
