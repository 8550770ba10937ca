"""What a result depends on: the code that computed it, the packages that this code runs on, its inputs, its options.

Its layout is in docs/reference/conventions.md. Results of equal provenance are the same; whatever is reused is reused
only where its provenance is that of the run.
"""

import functools
import hashlib
import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lightopt import __version__

# packages that results depend on; llvmlite turns numba's code into that of the processor
_PACKAGES = ("cascadio", "embreex", "llvmlite", "numba", "numpy", "OpenImageIO", "scipy", "trimesh")

# folders of the package that compute no result: they parse, print and draw what the others found
_PRESENTATION = ("cli", "report")

_CODE_KEY = "code_sha256"
_BLOCK_BYTES = 1 << 20
_MOST_CHARACTERS = 100
_MOST_DIFFERENCES = 6


def provenance(inputs: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """What a result depends on, as JSON.

    inputs: Hashes of what was read, such as :func:`lightopt.config.input_hashes` gives; names without folders, so that
        the same files give the same bytes everywhere
    options: Of the run, JSON-able
    """
    return {**computed_by(), "inputs": dict(inputs), "options": dict(options)}


def computed_by() -> dict[str, Any]:
    """What computes: version, hash of the code, versions of the packages."""
    return {"lightopt": __version__, _CODE_KEY: code_sha256(), "versions": dict(versions())}


@functools.cache
def code_sha256() -> str:
    """SHA-256 in hex of the names and contents of all source files that compute results."""
    package = Path(__file__).parents[1]
    sources: list[Path] = []
    for folder, below, files in os.walk(package):
        below[:] = [name for name in below if name not in (*_PRESENTATION, "__pycache__")]
        sources += [Path(folder, name) for name in files if name.endswith(".py")]
    digest = hashlib.sha256()
    for path in sorted(sources):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()


@functools.cache
def versions() -> Mapping[str, str]:
    """Versions of Python and of the packages that results depend on."""
    return MappingProxyType({"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}})


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def files_sha256(folder: Path, names: Iterable[str]) -> str:
    """SHA-256 in hex of files by name and content, in order; a missing file is reported where it is read."""
    digest = hashlib.sha256()
    for name in names:
        path = folder / name
        digest.update(f"{name} {file_sha256(path) if path.is_file() else 'missing'}\n".encode())
    return digest.hexdigest()


def differences(there: Mapping[str, Any], now: Mapping[str, Any], *, partly: bool = False) -> str:
    """How two runs differ, in words: first options, then versions, then contents; empty where they do not.

    Names of files do not count: the same content under another name gives the same results.

    there, now: Of the previous and of the present run, JSON of any depth
    partly: Whether `now` is only a part of what is known of the present run
    """
    old, new = dict(_leaves(there)), dict(_leaves(now))
    keys = new if partly else dict.fromkeys((*old, *new))
    pairs = [(key, old.get(key), new.get(key)) for key in keys if old.get(key) != new.get(key)]
    ranked = sorted((_difference(*pair) for pair in pairs), key=itemgetter(0))
    texts = list(dict.fromkeys(text for _, text in ranked))
    more = len(texts) - _MOST_DIFFERENCES
    return "; ".join([*texts[:_MOST_DIFFERENCES], *([f"and {more} more"] if more > 0 else [])])


def _leaves(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted key (``options.points``) and JSON text of each value; the sections of a provenance are not named."""
    for key, inner in value.items():
        name = prefix if not prefix and key in ("provenance", "inputs") else f"{prefix}{key}"
        if isinstance(inner, Mapping) and inner:
            yield from _leaves(inner, f"{name}." if name else "")
        elif name and name not in ("rig.file", "part.file", "calibration.file"):
            yield name, json.dumps(inner, sort_keys=True)


def _difference(key: str, old: str | None, new: str | None) -> tuple[int, str]:
    """Place among the differences (options, versions, contents), and the words."""
    if key == _CODE_KEY:
        return 2, "the code of lightopt has changed"
    if not key.startswith("versions.") and (key.endswith("sha256") or "sha256" in f"{old}{new}"):
        return 2, f"{key}: another content"
    there, now = (
        text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]}…"
        for text in (old or "absent", new or "absent")
    )
    return int(key.startswith("versions.")), f"{key}: previously {there}, now {now}"
