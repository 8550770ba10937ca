"""Strict YAML: text to plain data with the line of every key, and what is wrong on the way.

Built from PyYAML's events, so no tag is ever resolved and no constructor ever runs. Plain scalars are read by the core
schema of YAML 1.2 (YAML 1.2.2, section 10.3.2): PyYAML follows YAML 1.1, where `5e7` is text, `yes` is a boolean and
`1:30` is ninety.
"""

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import yaml

Keys = tuple[str | int, ...]

MAX_NODES = 20_000
MAX_DEPTH = 40

_READ_DIFFERENTLY = re.compile(r"[\t!?\ufeff]|[|>]\S*#")
"""Tabs, tags, question marks, byte-order marks, comments without a space before them: PyYAML's parser in C takes some
of them that the one in Python refuses."""

_SURROGATE = re.compile("[\ud800-\udfff]")
_HALF = "half of a surrogate pair is not a character"
_CONSTANTS: Mapping[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGERS = {10: re.compile(r"[-+]?[0-9]+"), 8: re.compile(r"0o[0-7]+"), 16: re.compile(r"0x[0-9a-fA-F]+")}
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NON_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_LONGEST_INT = 300  # digits; beyond, an integer is not a double any more


INVALID: Final = object()
"""Stands where the file has a value that is already reported as wrong."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a file: the line it is in, the keys that lead to it, and the message."""

    line: int
    keys: Keys
    message: str


class YamlError(Exception):
    """The text cannot be read any further."""

    def __init__(self, line: int, message: str) -> None:
        self.problem = Problem(line, (), message)


@dataclass
class Document:
    """Plain data of a YAML document, the line of each path of keys, and the problems met."""

    data: object = None
    lines: dict[Keys, int] = field(default_factory=dict[Keys, int])
    problems: list[Problem] = field(default_factory=list[Problem])
    invalid: set[Keys] = field(default_factory=set[Keys])  # paths whose value is INVALID
    incomplete: set[Keys] = field(default_factory=set[Keys])  # mappings that lost a key

    def line(self, keys: Keys) -> int:
        """Line of a path of keys, or of the nearest one around it."""
        return next((self.lines[keys[:end]] for end in range(len(keys), -1, -1) if keys[:end] in self.lines), 1)


@dataclass(frozen=True)
class _Node:
    line: int
    event: yaml.NodeEvent
    children: "list[_Node]" = field(default_factory=list["_Node"])  # of a mapping: key, value, key, value, …


def parse(text: str) -> Document:
    """Read one YAML document; `data` is None when there is nothing in it. YamlError where it cannot be read."""
    reader = _Reader(text, yaml.SafeLoader)
    try:
        root = _quickly_read(text) or reader.document()
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise YamlError(line, f"control character U+{ord(text[error.position]):04X}; remove it") from None
    except yaml.MarkedYAMLError as error:
        raise YamlError(*_explain(error)) from None
    except (yaml.YAMLError, ValueError, OverflowError, IndexError) as error:
        # PyYAML lets chr() fail on an escape such as "\UFFFFFFFF".
        raise YamlError(reader.line, f"not valid YAML: {error}") from None
    document = Document()
    if root is not None:
        document.data = _Expansion(document).value(root, (), root.line)
    return document


def _quickly_read(text: str) -> _Node | None:
    # by the parser in C where PyYAML has it; None where there is nothing, or something for the other to explain
    loader = getattr(yaml, "CSafeLoader", None)
    if loader is None or _READ_DIFFERENTLY.search(text):
        return None
    try:
        return _Reader(text, loader).document()
    except (yaml.YAMLError, ValueError, OverflowError, IndexError):
        return None


class _Reader:
    """Builds the tree of nodes from PyYAML's events."""

    def __init__(self, text: str, loader: type[yaml.SafeLoader]) -> None:
        self.events: Iterator[yaml.Event] = yaml.parse(text, Loader=loader)
        self.anchors: dict[str, _Node] = {}
        self.count = 0
        self.line = 1

    def each(self) -> Iterator[yaml.Event]:
        for event in self.events:
            self.line = event.start_mark.line + 1
            yield event

    def document(self) -> _Node | None:
        root: _Node | None = None
        for event in self.each():
            if isinstance(event, yaml.NodeEvent):
                root = self.node(event, 0)
            elif isinstance(event, yaml.DocumentStartEvent) and root is not None:
                raise YamlError(self.line, "a second document starts here (---); expected one per file")
        return root

    def node(self, event: yaml.Event, depth: int) -> "_Node":
        self.count += 1
        if self.count > MAX_NODES:
            raise YamlError(self.line, f"more than {MAX_NODES} values; this is not a configuration file")
        if depth > MAX_DEPTH:
            raise YamlError(self.line, f"nested more than {MAX_DEPTH} levels deep")
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                raise YamlError(self.line, f"*{event.anchor} refers to no complete &{event.anchor} before it")
            return self.anchors[event.anchor]
        assert isinstance(event, yaml.NodeEvent)
        node = _Node(self.line, event)
        if isinstance(event, yaml.CollectionStartEvent):
            inner = itertools.takewhile(lambda child: not isinstance(child, yaml.CollectionEndEvent), self.each())
            node.children.extend(self.node(child, depth + 1) for child in inner)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node


class _Expansion:
    """Turns the tree of nodes into plain data, aliases written out."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.count = 0

    def report(self, line: int, keys: Keys, message: str) -> object:
        self.document.problems.append(Problem(line, keys, message))
        self.document.invalid.add(keys)
        return INVALID

    def value(self, node: _Node, keys: Keys, line: int) -> object:
        self.count += 1
        if self.count > MAX_NODES or len(keys) > MAX_DEPTH:
            raise YamlError(line, f"aliases expand to more than {MAX_NODES} values or {MAX_DEPTH} levels")
        self.document.lines[keys] = line
        event = node.event
        if isinstance(event, (yaml.ScalarEvent, yaml.CollectionStartEvent)) and event.tag is not None:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            return self.report(node.line, keys, f"tag {tag} is not allowed; write the plain value")
        if isinstance(event, yaml.ScalarEvent):
            return self.scalar(event, keys, line)
        if isinstance(event, yaml.SequenceStartEvent):
            return [self.value(item, (*keys, i), item.line) for i, item in enumerate(node.children)]
        return self.mapping(node, keys)

    def scalar(self, event: yaml.ScalarEvent, keys: Keys, line: int) -> object:
        text: str = event.value
        if _SURROGATE.search(text):
            return self.report(line, keys, _HALF)
        try:
            return _plain_scalar(text) if event.implicit[0] else text
        except ValueError as error:
            return self.report(line, keys, str(error))

    def mapping(self, node: _Node, keys: Keys) -> dict[str, object]:
        data: dict[str, object] = {}
        for key_node, value_node in zip(node.children[::2], node.children[1::2], strict=True):
            line, event = key_node.line, key_node.event
            key = str(getattr(event, "value", ""))  # never a number or a boolean
            problem = ""
            if not isinstance(event, yaml.ScalarEvent) or event.tag is not None:
                problem = "expected a key of plain text"
            elif key == "<<" and event.implicit[0]:
                problem = 'merging with "<<" is not part of YAML 1.2; write the keys out'
            elif _SURROGATE.search(key):
                problem = _HALF
            if problem:
                self.document.incomplete.add(keys)
            elif key in data:
                problem = f'key "{key[:60]}" is given twice; the first is in line {self.document.lines[(*keys, key)]}'
            if problem:
                self.document.problems.append(Problem(line, keys, problem))
            else:
                data[key] = self.value(value_node, (*keys, key), line)
        return data


def _explain(error: yaml.MarkedYAMLError) -> tuple[int, str]:
    mark = error.problem_mark or error.context_mark
    line = mark.line + 1 if mark else 1
    column = f" (column {mark.column + 1})" if mark else ""
    problem = error.problem or "it cannot be read"
    if r"'\t'" in problem:
        return line, f"a tab{column}: YAML is indented with spaces"
    if "mapping values are not allowed" in problem:
        return line, f'a second ": "{column}: check the indentation, or put the text in quotes'
    if "could not find expected ':'" in problem:
        return line, 'expected "key: value" before this line; a colon with a space after it is missing'
    if "expected <block end>" in problem:
        return line, f"indented differently from the lines above{column}"
    context = f", {error.context}" if error.context else ""
    if error.context and error.context_mark and error.context_mark.line + 1 != line:
        context += f" that starts in line {error.context_mark.line + 1}"
    return line, f"not valid YAML{column}: {problem}{context}"


def is_number(text: str) -> bool:
    return any(pattern.fullmatch(text) for pattern in (*_INTEGERS.values(), _FLOAT))


def _plain_scalar(text: str) -> str | int | float | bool | None:
    """Value of an unquoted scalar; a ValueError for NaN, infinities and numbers beyond a double."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _NON_FINITE.fullmatch(text):
        raise ValueError(f"expected a finite number, found {text}")
    for base, pattern in _INTEGERS.items():
        if pattern.fullmatch(text):
            if len(text) > _LONGEST_INT:
                raise ValueError(f"expected a finite number, found one of {len(text)} digits")
            return int(text if base == 10 else text[2:], base)
    if _FLOAT.fullmatch(text):
        value = float(text)
        if math.isinf(value):
            raise ValueError(f"expected a finite number, found {text[:40]}, which is too large")
        return value
    return text


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
    # index in the file of each light of a rig, where lights of several channels have several; else empty
    entries: tuple[int, ...] = field(default=(), repr=False, compare=False)

    def in_file(self, keys: Keys) -> Keys:
        """The path of keys in the file, of one in the configuration."""
        if len(keys) > 1 and keys[0] == "lights" and isinstance(keys[1], int) and keys[1] < len(self.entries):
            return ("lights", self.entries[keys[1]], *keys[2:])
        return keys

    def at(self, *keys: str | int) -> str:
        """Beginning of a message about a key: ``rig.yaml:12: lights[2].gain``, with the nearest line that is there."""
        keys = self.in_file(keys)
        around = (keys[:end] for end in range(len(keys), -1, -1))
        line = next((self.lines[path] for path in around if path in self.lines), None)
        place = str(self.path) if line is None else f"{self.path}:{line}"
        return f"{place}: {dotted(keys)}" if keys else place

    def resolve(self, name: str) -> Path:
        """Path of a file that the configuration names, relative to the folder of the configuration."""
        return self.path.parent / name
