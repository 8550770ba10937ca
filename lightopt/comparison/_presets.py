"""Lighting systems to compare with, by name: sample rigs of the package."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Final

from lightopt.core.errors import InputError
from lightopt.images import make_folder, write_text_atomic

PRESETS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "four-panel": "four-panel",
        "bars": "bars",
        "ring-quadrants": "ring-quadrants",
        "low-ring": "low-angle-ring",
        "dome-quadrants": "dome-quadrants",
        "flat-dome": "flat-dome",
        "tunnel": "tunnel",
        "coaxial": "coaxial",
        "spot": "spot",
        "led-array": "led-array",
        "display": "display-stripes",
    }
)
"""Name of each preset, and of the sample rig that it is."""


def preset_files(names: Sequence[str], folder: Path, *, force: bool = False) -> list[Path]:
    """Copy the rig files of presets to a folder, where they can be changed, and return them.

    Raises InputError: A name that no preset has, or another file in its place without `force`.
    """
    unknown = [name for name in names if name not in PRESETS]
    if unknown:
        raise InputError(*(f'no preset "{name}"; presets are {", ".join(PRESETS)}' for name in unknown))
    make_folder(folder)
    samples, found = files("lightopt.samples").joinpath("rigs"), list[Path]()
    for name in names:
        text = samples.joinpath(f"{PRESETS[name]}.yaml").read_text(encoding="utf-8")
        text = "".join(line for line in text.splitlines(keepends=True) if "yaml-language-server" not in line)
        path = folder / f"{name}.yaml"
        if path.exists() and path.read_text(encoding="utf-8") != text and not force:
            raise InputError(
                f"{path}: differs from the preset; give it as a rig file without the preset, or use option 'force'"
            )
        write_text_atomic(path, text)
        found.append(path)
    return found
