"""Where a configuration came from, so that later errors can still name the file and the line."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Keys = tuple[str | int, ...]


def dotted(keys: Keys) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


@dataclass(frozen=True)
class Source:
    """The file that a configuration was read from; hash and text are empty for one that was built in code.

    >>> source = Source(Path("rig.yaml"), "", {("camera",): 3, ("camera", "roll_deg"): 7})
    >>> source.at("camera", "roll_deg")
    'rig.yaml:7: camera.roll_deg'
    >>> source.at("camera", "sensor", "bit_depth")
    'rig.yaml:3: camera.sensor.bit_depth'
    """

    path: Path  # the YAML file, as it was given
    sha256: str  # of the file's bytes, hexadecimal
    # line number (1-based) of each path of keys in the file
    lines: Mapping[Keys, int] = field(default_factory=dict[Keys, int], repr=False, compare=False)
    text: str = field(default="", repr=False, compare=False)  # as it was read

    def at(self, *keys: str | int) -> str:
        """Beginning of a message about a key: ``rig.yaml:12: lights[2].gain``, with the nearest line that is there."""
        around = (keys[:end] for end in range(len(keys), -1, -1))
        line = next((self.lines[path] for path in around if path in self.lines), None)
        place = str(self.path) if line is None else f"{self.path}:{line}"
        return f"{place}: {dotted(keys)}" if keys else place

    def resolve(self, name: str) -> Path:
        """Path of a file that the configuration names, relative to the folder of the configuration."""
        return self.path.parent / name
