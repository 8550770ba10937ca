"""Packages have honest faces: what an `__init__` exports is used outside it, all else is private."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lightopt"
FACES = sorted(path for path in PACKAGE.rglob("__init__.py") if "__all__" in path.read_text(encoding="utf-8"))
USERS = [
    *PACKAGE.rglob("*.py"),
    *(path for folder in ("benchmarks", "scripts", "examples") for path in (ROOT / folder).rglob("*.py")),
    *(path for path in (ROOT / "tests").rglob("*.py") if not path.name.startswith("test_")),
]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]


def name_of(face: Path) -> str:
    return ".".join(face.parent.relative_to(ROOT).parts)


def exports(face: Path) -> set[str]:
    tree = ast.parse(face.read_text(encoding="utf-8"))
    values = [node.value for node in tree.body if isinstance(node, ast.Assign) and is_all(node)]
    return set(ast.literal_eval(values[0]))


def is_all(node: ast.Assign) -> bool:
    return any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets)


def package_of(path: Path) -> Path | None:
    """The folder of the face that a module is behind."""
    return next((folder for folder in path.parents if folder / "__init__.py" in FACES), None)


@cache
def imports() -> list[tuple[Path, str, str]]:
    """All imports of names of the package: file, module, name."""
    found: list[tuple[Path, str, str]] = []
    for path in (*USERS, *PAGES):
        source = path.read_text(encoding="utf-8")
        if path.suffix == ".md":
            source = "\n".join(re.findall(r"^```python\n(.*?)^```", source, re.M | re.S))
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and node.module:
                found += [(path, node.module, alias.name) for alias in node.names]
    return found


@pytest.mark.parametrize("face", FACES, ids=map(name_of, FACES))
def test_what_is_exported_is_used_outside(face):
    name = name_of(face)
    used = {imported for path, module, imported in imports() if module == name and package_of(path) != face.parent}
    assert exports(face) - used == set()


def test_private_modules_export_nothing():
    found = [
        path.relative_to(ROOT).as_posix()
        for path in PACKAGE.rglob("_*.py")
        if path.name not in ("__init__.py", "__main__.py")
        and any(isinstance(node, ast.Assign) and is_all(node) for node in ast.parse(path.read_text()).body)
    ]
    assert found == []
