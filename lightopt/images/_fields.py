"""Reading a JSON object key by key, with types, collecting what is wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lightopt.images._names import inside_problem


class Fields:
    """A JSON object whose keys are read with a type; collects what is wrong."""

    def __init__(self, path: str | Path, data: object, where: str, problems: list[str] | None = None) -> None:
        self.path = path
        self.where = where
        self.problems: list[str] = [] if problems is None else problems
        self.data: Mapping[str, Any] = data if isinstance(data, dict) else {}
        if not isinstance(data, dict):
            self.problem("", "an object", data)

    def problem(self, key: str, expected: str, found: object) -> None:
        """Note what is wrong with a key."""
        place = ".".join(part for part in (self.where, key) if part)
        text = "nothing" if found is None else json.dumps(found, default=str)
        found_text = text if len(text) <= 60 else text[:60] + "…"
        self.problems.append(f"{self.path}: {place or 'manifest'}: expected {expected}, found {found_text}")

    def number(
        self, key: str, default: float | None = None, *, above: float = -math.inf, upto: float = math.inf
    ) -> float:
        """Read a number in (above, upto]; required when there is no default."""
        value = self.data.get(key, default)
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not (good and above < value <= upto):
            limits = (f" above {above:g}" if above > -math.inf else "") + (
                f" up to {upto:g}" if upto < math.inf else ""
            )
            self.problem(key, f"a number{limits}", value)
            return 1.0
        return value

    def text(self, key: str) -> str:
        """Read a text that is not empty; required."""
        value = self.data.get(key)
        if not isinstance(value, str) or not value:
            self.problem(key, "text", value)
            return ""
        return value

    def optional_text(self, key: str) -> str | None:
        """Read a text, or None when the key is absent or null."""
        return None if self.data.get(key) is None else self.text(key)

    def file(self, key: str) -> str | None:
        """Read a path inside the set's folder, or None when absent."""
        name = self.optional_text(key)
        if name and (problem := inside_problem(name)):
            self.problems.append(
                f"{self.path}: {'.'.join(filter(None, (self.where, key)))}: {problem}, found {name!r}"
            )
        return name

    def texts(self, key: str) -> dict[str, str]:
        """Read an object of texts, empty when absent."""
        inner = Fields(
            self.path, self.data.get(key) or {}, ".".join(filter(None, (self.where, key))), self.problems
        )
        return {name: inner.text(name) for name in inner.data}

    def items(self, key: str, *, required: bool = False) -> Iterator[Fields]:
        """Yield the objects of a list."""
        value = self.data.get(key, None if required else [])
        if not isinstance(value, list):
            self.problem(key, "a list", value)
            return
        for i, item in enumerate(value):
            yield Fields(self.path, item, f"{key}[{i}]", self.problems)

    def unknown(self, known: tuple[str, ...]) -> dict[str, Any]:
        """Return the keys that are not known."""
        return {key: value for key, value in self.data.items() if key not in known}
