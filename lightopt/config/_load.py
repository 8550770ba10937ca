"""Read rig, part and batch files: everything wrong with a file at once, each with its line.

And the lights of a rig whose file is wrong elsewhere: its ``hardware`` section, as far as it can be read.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError

from lightopt.config._batch import BatchConfig
from lightopt.config._camera import CameraDeviceConfig
from lightopt.config._edit import referenced_files
from lightopt.config._fields import mapping
from lightopt.config._hardware import ChannelConfig, ControllerConfig, HardwareConfig
from lightopt.config._part import MESH_SUFFIXES, PartConfig
from lightopt.config._pose import POSE_REPLACES
from lightopt.config._ranges import RangesConfig
from lightopt.config._rig import RigConfig
from lightopt.config._strict_yaml import YamlError, parse
from lightopt.config._targets import TargetsConfig
from lightopt.config._yaml_file import Misfits, decode, load_file, read_bytes
from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256

Entry = TypeVar("Entry", bound=BaseModel)
FileKind = Literal["rig", "part", "ranges", "batch"]


def load_rig(path: Path | str) -> RigConfig:
    """Read a rig file (``lightopt-rig/1``).

    Returns: The file's content, in its own units; ``source`` names file, hash and lines.
    Raises lightopt.core.errors.InputError: With one message per thing that is wrong, sorted by line
    """
    rig = load_file(Path(path), RigConfig, "lightopt-rig/1")
    rig._source = replace(rig.source, entries=tuple(light.entry for light in rig.lights))
    return rig


def load_part(path: Path | str) -> PartConfig:
    """Read a part file as :func:`load_rig` does; ``source.resolve(part.mesh.file)`` is its mesh, which must exist."""
    if Path(path).suffix.lower() in MESH_SUFFIXES and Path(path).is_file():
        raise InputError(f"{path}: a mesh; expected a part file (YAML) that names it as mesh.file")
    return load_file(Path(path), PartConfig, "lightopt-part/1")


def load_targets(path: Path | str) -> TargetsConfig:
    """Read the targets of a calibration (``lightopt-targets/1``) as :func:`load_rig` does."""
    return load_file(Path(path), TargetsConfig, "lightopt-targets/1")


def load_ranges(path: Path | str) -> RangesConfig:
    """Read the ranges of a dataset (``lightopt-ranges/1``) as :func:`load_rig` does."""
    return load_file(Path(path), RangesConfig, "lightopt-ranges/1")


def load_batch(path: Path | str, misfits: Misfits | None = None) -> BatchConfig:
    """Read the jobs of a batch (``lightopt-batch/1``) as :func:`load_rig` does.

    misfits: What is wrong with commands, options and files, which this package does not know, by keys of the file
    """
    return load_file(Path(path), BatchConfig, "lightopt-batch/1", misfits)


def input_files(config: RigConfig | PartConfig | RangesConfig) -> dict[str, Path]:
    """Files that a file names: data sheet, pictures, tables, mesh, fit; a calibration's covariance if there."""
    if isinstance(config, RangesConfig):
        return {} if config.fit is None else {"fit": config.source.resolve(config.fit)}
    files: dict[str, Path] = {}
    if isinstance(config, RigConfig) and config.camera.sensor.data_sheet is not None:
        files["data sheet"] = config.source.resolve(config.camera.sensor.data_sheet)
    if isinstance(config, RigConfig) and config.calibration is not None:
        covariance = config.source.resolve(config.calibration.covariance)
        if covariance.is_file():  # most commands do without
            files["covariance"] = covariance
    files |= {
        f"{'table' if keys[-1] == 'table' else 'picture'} {name}": config.source.resolve(name)
        for keys, name in referenced_files(config)
    }
    if isinstance(config, PartConfig):
        files["mesh"] = config.source.resolve(config.mesh.file)
    return files


def input_hashes(rig: RigConfig, part: PartConfig | None) -> dict[str, dict[str, str]]:
    """Names and SHA-256 of the files as they were read, and those of mesh and pictures, which may raise an OSError."""
    files = {"rig": rig} if part is None else {"rig": rig, "part": part}
    hashes = {kind: {"file": one.source.path.name, "sha256": one.source.sha256} for kind, one in files.items()}
    for one in files.values():
        hashes |= {what: {"sha256": file_sha256(file)} for what, file in input_files(one).items()}
    return hashes


def json_schema(kind: FileKind) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a kind of file; rules that tie keys together are not in it."""
    models = {"rig": RigConfig, "part": PartConfig, "ranges": RangesConfig, "batch": BatchConfig}
    schema = models[kind].model_json_schema()
    for model in (schema, *schema["$defs"].values()):
        for field in model["properties"].values():
            field.pop("title", None)  # only the key again, in capitals
            field["description"] = " ".join(field["description"].split())
        if "pose" in model["properties"]:
            model["required"] = [key for key in model["required"] if key not in POSE_REPLACES]
    schema["title"] = f"lightopt {kind}"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


@dataclass(frozen=True)
class LightsOnly:
    """The lights of a rig."""

    name: str  # of the rig, or of its file where that cannot be read
    rig: RigConfig | None  # None where anything is wrong with its file
    hardware: HardwareConfig | None  # what can be read, without the stage; None where there is no such section
    unreadable: tuple[str, ...] = ()  # controllers that cannot be read
    lights_unknown: tuple[str, ...] = ()  # lights of those controllers, or of none that the file has
    problems: tuple[str, ...] = ()  # all that is wrong with the file


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
        text = decode(read_bytes(path, "lightopt-rig/1"), path)
    except InputError:
        raise wrong from None
    rig = _document(text)
    # the lines from `hardware:` to the next line that is not indented
    lines = re.search(r"^hardware:.*(?:\n(?:[ \t#].*)?)*", text.replace("\r\n", "\n"), re.MULTILINE)
    alone = mapping(_document(lines[0])) if lines else {}
    section = mapping(mapping(rig).get("hardware") or alone.get("hardware"))
    raw_controllers, raw_lights = mapping(section.get("controllers")), mapping(section.get("lights"))
    controllers = _readable(ControllerConfig, raw_controllers)
    lights = _readable(ChannelConfig, raw_lights)
    unreadable = tuple(name for name in raw_controllers if name not in controllers)
    unknown = tuple(
        name for name, entry in raw_lights.items() if mapping(entry).get("controller") not in [*controllers]
    )
    if not controllers:
        reason = f"no controller can be read; lights that may be on: {', '.join(unknown) or 'all of them'}"
        if not section:
            reason = "no hardware section can be read here; any light may be on"
        advice = "correct the file and repeat, or switch the controllers off by hand"
        raise InputError(*wrong.messages, f"nothing was switched off: {reason}; {advice}")
    name = mapping(rig).get("name")
    known = name if isinstance(name, str) else path.name
    hardware = HardwareConfig(controllers=controllers, lights=lights, camera=CameraDeviceConfig())
    return LightsOnly(known, None, hardware, unreadable, unknown, wrong.messages)


def _document(text: str) -> object:
    try:
        return parse(text).data
    except YamlError:
        return None


def _readable(model: type[Entry], entries: Mapping[str, object]) -> dict[str, Entry]:
    read: dict[str, Entry] = {}
    for name, entry in entries.items():
        known = {key: value for key, value in mapping(entry).items() if key in model.model_fields}
        try:
            read[name] = model.model_validate(known)
        except ValidationError:
            continue
    return read
