"""Change values in a YAML file and nothing else, or copy it elsewhere: comments, order and layout stay."""

import itertools
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import itemgetter
from pathlib import Path

import yaml

from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig
from lightopt.config._strict_yaml import Keys, YamlError, dotted, parse
from lightopt.core.errors import InputError

_SCHEMA = re.compile(r"^(#\s*yaml-language-server:.*\$schema=)(\S+)", re.MULTILINE)


def with_values(text: str, values: Mapping[Keys, str | None]) -> str:
    """The text of a YAML file with some values replaced, removed, or added to mappings that are there.

    values: New text of each value by its path of keys, as it is to stand in the file; None removes key and value
    Raises InputError: The mapping around a key is not in the file, or is an alias that stands for a mapping somewhere
        else
    """
    spans, _, entries = _index(text)
    # a mapping or a list is removed before another takes its place
    removed = [keys for keys, value in values.items() if keys in entries and (value is None or keys not in spans)]
    gone = [_whole_entry(text, *entries[keys]) for keys in removed]
    following = len(text)
    for start, end in sorted(gone, reverse=True):
        before, behind = text[:start], text[min(end, following) :]
        if re.match(r"\s*}", behind):  # no comma is left before the end of braces
            before = re.sub(r"\s*,\s*$", "", before)
        text, following = before + behind, len(before)
    spans, mappings, _ = _index(text)
    places: list[tuple[int, int, str]] = []  # spans to replace; empty ones to insert
    for keys, value in values.items():
        if value is None:
            continue
        if keys in spans:
            places.append((*spans[keys], value))
        elif len(keys) == 1 and not mappings[()][1]:
            places.append((len(text), len(text), f"{keys[0]}: {value}\n"))
        elif keys[:-1] in mappings:
            at, flow, column = mappings[keys[:-1]]
            line = f"{keys[-1]}: {value}"
            places.append((at, at, f"{line}, " if flow else f"{line}\n{' ' * column}"))
        else:
            missing = f"the file has no mapping {dotted(keys[:-1])} of its own; write it out"
            raise InputError(f"{dotted(keys)} cannot be written: {missing}")
    for start, end, new in sorted(places, key=itemgetter(0), reverse=True):
        text = text[:start] + new + text[end:]
    try:
        parse(text)
    except YamlError as error:
        reason = f"the values cannot be put into the file: {error.problem.message}"
        raise InputError(f"{reason}; write anchors and aliases out") from None
    return text


def with_list(text: str, key: str, entries: Sequence[str], *, comment: str, replace: bool = False) -> str:
    """The text of a YAML file with a list of its own added at the end, or in the place of the one that is there.

    key: Of the list, at the top of the file, which has no such key unless that is to be replaced
    entries: Text of each entry, as it is to stand in the file
    comment: To stand above the list; of one line or several
    replace: Whether a list of this key is replaced, with the comments of its entries; the one beside the key stays
        there
    Raises InputError: The file is written so that nothing can be added at its end: in braces, or closed
    """
    span = _list_span(text, key) if replace else None
    start, end, beside = span or (0, 0, "")
    lines = [*(f"# {line}" for line in comment.splitlines()), f"{key}:{beside}", *(f"  - {entry}" for entry in entries)]
    before, after = (text.rstrip() + "\n\n", "\n") if span is None else (text[:start], text[end:])
    longer = before + "\n".join(lines) + after
    try:
        document = parse(longer)
    except YamlError as error:
        reason = f"{key} cannot be added at the end of the file: {error.problem.message}"
        raise InputError(f"{reason}; write the file without braces around it and without an end mark") from None
    if document.problems or (key, len(entries) - 1) not in document.lines or (key, len(entries)) in document.lines:
        raise InputError(f"{key} cannot be added at the end of the file: it has such a key, or ends in a text block")
    return longer


def _list_span(text: str, key: str) -> tuple[int, int, str] | None:
    # of a key at the top of a file without braces: from the key to the end of the list's last line, and the comment
    # beside the key, or behind a list in brackets, with the blanks before it; None where there is no such key
    start, end, in_braces = _index(text)[2].get((key,), (0, 0, True))
    if in_braces:
        return None
    if re.search(r"\s\*\S+$", text[start:end]):
        raise InputError(f"{key} cannot be replaced: it is an alias; write anchors and aliases out")
    # behind a list in brackets the comment is of the list, behind a block it is of its last entry
    rest = end + len(text[end:].split("\n", 1)[0].rstrip("\r"))
    if text[start:end].partition(":")[2].lstrip().startswith(("[", "{")):
        return start, rest, text[end:rest].rstrip()
    after_key = text[start:].split("\n", 1)[0].partition(":")[2]
    return start, rest, after_key.rstrip() if "#" in after_key else ""


def _whole_entry(text: str, start: int, end: int, in_braces: bool) -> tuple[int, int]:
    # of a key and its value, from `start` to `end`, what goes with them: the comma in braces, else the line's comment
    if in_braces:
        behind = re.match(r"\s*,\s*", text[end:])
        return start, end + behind.end() if behind else end
    rest = end + len(text[end:].split("\n", 1)[0]) + 1
    line = text.rfind("\n", 0, start) + 1
    if text[line:start].strip():  # behind the dash of a list, which the next key takes over
        return start, rest + len(text[rest:]) - len(text[rest:].lstrip(" "))
    return line, rest


def _index(
    text: str,
) -> tuple[dict[Keys, tuple[int, int]], dict[Keys, tuple[int, bool, int]], dict[Keys, tuple[int, int, bool]]]:
    # the span of every scalar; where every mapping that is not empty begins: place, whether in braces, column; and the
    # span of every key with its value, and whether it is in braces
    spans: dict[Keys, tuple[int, int]] = {}
    mappings: dict[Keys, tuple[int, bool, int]] = {}
    entries: dict[Keys, tuple[int, int, bool]] = {}
    events: Iterator[yaml.Event] = yaml.parse(text, Loader=yaml.SafeLoader)

    def value(event: yaml.Event, keys: Keys) -> int:
        # read a value and return where it ends: not the end of a block, which is beyond the comments behind it
        end = event.end_mark.index
        if isinstance(event, (yaml.ScalarEvent, yaml.AliasEvent)):
            spans[keys] = event.start_mark.index, end
        elif isinstance(event, yaml.SequenceStartEvent):
            numbers = itertools.count()
            while not isinstance(item := next(events), yaml.SequenceEndEvent):
                end = value(item, (*keys, next(numbers)))
            end = item.end_mark.index if event.flow_style else end
        elif isinstance(event, yaml.MappingStartEvent):
            while not isinstance(key := next(events), yaml.MappingEndEvent):
                mark, in_braces = key.start_mark, bool(event.flow_style)
                mappings.setdefault(keys, (mark.index, in_braces, mark.column))
                name: str = key.value if isinstance(key, yaml.ScalarEvent) else ""
                end = value(next(events), (*keys, name))
                entries[(*keys, name)] = mark.index, end, in_braces
            end = key.end_mark.index if event.flow_style else end
        return end

    for event in events:
        if isinstance(event, yaml.NodeEvent):
            value(event, ())
    return spans, mappings, entries


def copied_text(config: RigConfig | PartConfig, folder: Path, values: Mapping[Keys, str | None] | None = None) -> str:
    """The text of a configuration file for another folder; comments, order and layout stay.

    Names relative to the configuration file change: a part's mesh, masks and tables, the files and folders that a rig
    names (those of commands where they are there), and the schema in the comment that editors read.

    folder: Where the copy will lie
    values: Further values to change in the copy, as for :func:`with_values`
    Raises InputError: As of :func:`with_values`, and where the configuration was built in code
    """
    if not config.source.text:
        raise InputError(f"{config.source.path}: there is no file to write changed values into; load it from one")
    changes: dict[Keys, str | None] = {}
    for keys, value in (values or {}).items():
        place = config.source.in_file(keys)
        if changes.setdefault(place, value) != value:
            reason = "the channels of this light have different values; write them as lights of their own"
            raise InputError(f"{config.source.at(*keys)}: {reason}")
    of_rig = (
        ("hardware", "camera", "folder"),
        ("calibration", "covariance"),
        ("virtual_bench", "rig"),
        ("camera", "sensor", "data_sheet"),
    )
    names: dict[Keys, str | None] = {
        keys: reduce(lambda value, key: getattr(value, key, None), keys, config)
        for keys in ((("mesh", "file"),) if isinstance(config, PartConfig) else of_rig)
    }
    hardware = None if isinstance(config, PartConfig) else config.hardware
    for controller, device in ({} if hardware is None else hardware.controllers).items():
        for i, argument in enumerate(device.command or ()):
            if config.source.resolve(argument).is_file():
                names["hardware", "controllers", controller, "command", i] = argument
    names |= dict(referenced_files(config))
    for keys, name in names.items():
        if name is None or changes.get(keys, name) is None:  # not there, or removed
            continue
        moved = _moved(config.source.resolve(name), name, folder)
        if moved != name:
            changes[keys] = json.dumps(moved, ensure_ascii=False)
    text = with_values(config.source.text, changes)
    comment = _SCHEMA.search(text)
    # an address, or a schema that is not there, stays as it is
    if comment is None or not config.source.resolve(comment[2]).is_file():
        return text
    schema = _moved(config.source.resolve(comment[2]), comment[2], folder)
    return text[: comment.start(2)] + schema + text[comment.end(2) :]


def referenced_files(config: RigConfig | PartConfig) -> Iterator[tuple[Keys, str]]:
    """Places in the file, and names, of the pictures of a rig's lights, or of the masks and tables of a part."""
    if isinstance(config, PartConfig):
        if config.reflectance.table is not None:
            yield ("reflectance", "table"), config.reflectance.table
        for number, region in enumerate(config.regions):
            if region.mask is not None:
                yield ("regions", number, "mask", "file"), region.mask.file
            if region.reflectance.table is not None:
                yield ("regions", number, "reflectance", "table"), region.reflectance.table
        return
    for light in config.channels:
        if light.channel == 0 and light.pattern is not None:
            for number, name in enumerate(light.pattern.files or ()):
                yield ("lights", light.entry, "pattern", "files", number), name


def _moved(target: Path, name: str, folder: Path) -> str:
    # the name by which a file is found from another folder; the same name where that holds
    target = target.resolve()
    if target == (folder / name).resolve():
        return name
    try:
        return Path(os.path.relpath(target, folder.resolve())).as_posix()
    except ValueError:  # another drive
        return target.as_posix()
