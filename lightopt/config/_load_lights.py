"""The lights of a rig whose file is wrong elsewhere: its ``hardware`` section, as far as it can be read."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

from pydantic import BaseModel, ValidationError

from lightopt.config._camera import CameraDeviceConfig
from lightopt.config._hardware import HardwareConfig
from lightopt.config._light_controllers import ChannelConfig, ControllerConfig
from lightopt.config._load import load_rig, read_text
from lightopt.config._rig import RigConfig
from lightopt.config._strict_yaml import YamlError, parse
from lightopt.core.errors import InputError

Entry = TypeVar("Entry", bound=BaseModel)


@dataclass(frozen=True)
class LightsOnly:
    """The lights of a rig.

    name: Of the rig, or of its file where that cannot be read
    rig: The rig; None where anything is wrong with its file
    hardware: Controllers and lights that can be read, without the stage; None where there is no such section
    unreadable: Controllers that cannot
    lights_unknown: Lights of those controllers, or of none that the file has
    problems: All that is wrong with the file
    """

    name: str
    rig: RigConfig | None
    hardware: HardwareConfig | None
    unreadable: tuple[str, ...] = ()
    lights_unknown: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def load_lights(path: Path | str) -> LightsOnly:
    """Read which light is plugged in where, of a rig file that may be wrong in any other way.

    Controllers and lights are read one by one; a mistake in one hides no other. Where the file is not even YAML, the
    lines of its ``hardware`` section are read by themselves.

    Raises lightopt.core.errors.InputError: With all that is wrong, when the file cannot be read, or has no section of
        which a controller can be read
    """
    path = Path(path)
    try:
        rig = load_rig(path)
    except InputError as error:
        return _read_what_is_valid(path, error)
    return LightsOnly(rig.name, rig, rig.hardware)


def _read_what_is_valid(path: Path, wrong: InputError) -> LightsOnly:
    """Lights and controllers of a file that is wrong in other places."""
    try:
        text = read_text(path, "lightopt-rig/1")
    except InputError:
        raise wrong from None
    rig = _document(text)
    section = _mapping(_mapping(rig).get("hardware") or _mapping(_document(_section(text))).get("hardware"))
    if not section:
        raise InputError(
            *wrong.messages,
            "nothing was switched off: no hardware section can be read here, so nobody knows which lights may be on; "
            "mend the file and repeat, or switch the controllers off by hand",
        )
    raw_controllers, raw_lights = _mapping(section.get("controllers")), _mapping(section.get("lights"))
    controllers = _readable(ControllerConfig, raw_controllers)
    lights = _readable(ChannelConfig, raw_lights)
    unreadable = tuple(name for name in raw_controllers if name not in controllers)
    unknown = tuple(name for name, entry in raw_lights.items() if _mapping(entry).get("controller") not in controllers)
    if not controllers:
        raise InputError(
            *wrong.messages,
            "nothing was switched off: no controller can be read; "
            f"lights that may be on: {', '.join(unknown) or 'all of them'}; "
            "mend the file and repeat, or switch the controllers off by hand",
        )
    name = _mapping(rig).get("name")
    return LightsOnly(
        name if isinstance(name, str) else path.name,
        None,
        HardwareConfig(controllers=controllers, lights=lights, camera=CameraDeviceConfig()),
        unreadable,
        unknown,
        wrong.messages,
    )


def _document(text: str) -> object:
    try:
        return parse(text).data
    except YamlError:
        return None


def _section(text: str) -> str:
    """The lines from ``hardware:`` to the next line that is not indented."""
    found = re.search(r"^hardware:.*(?:\n(?:[ \t#].*)?)*", text.replace("\r\n", "\n"), re.MULTILINE)
    return found[0] if found else ""


def _readable(model: type[Entry], entries: Mapping[str, object]) -> dict[str, Entry]:
    """The entries that fit the model once keys that it does not know are left out."""
    read: dict[str, Entry] = {}
    for name, entry in entries.items():
        known = {key: value for key, value in _mapping(entry).items() if key in model.model_fields}
        try:
            read[name] = model.model_validate(known)
        except ValidationError:
            continue
    return read


def _mapping(value: object) -> Mapping[str, object]:
    return cast("Mapping[str, object]", value) if isinstance(value, dict) else {}
