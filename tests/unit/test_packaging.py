"""What the installed package holds: every room, and every sample."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def declared() -> set[str]:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = text[text.index("packages = [") : text.index("]", text.index("packages = ["))]
    return {line.strip(' ",') for line in listed.splitlines()[1:] if line.strip()}


def test_every_package_is_installed_and_nothing_else(declared):
    rooms = {".".join(folder.parent.relative_to(ROOT).parts) for folder in (ROOT / "lightopt").rglob("__init__.py")}
    assert {name for name in declared if not name.startswith("lightopt.samples")} == rooms


def test_every_folder_of_samples_is_installed(declared):
    homes = {path.parent for path in (ROOT / "configs").rglob("*.yaml")} | {ROOT / "configs"}
    names = {".".join(("lightopt.samples", *home.relative_to(ROOT / "configs").parts)) for home in homes}
    assert {name for name in declared if name.startswith("lightopt.samples")} == names
