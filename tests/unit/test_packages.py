"""Packages have honest faces: what an `__init__` exports is used outside it, all else is private."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lightopt"
FACES = sorted(PACKAGE.rglob("__init__.py"))
USERS = [
    *PACKAGE.rglob("*.py"),
    *(path for folder in ("benchmarks", "scripts", "examples") for path in (ROOT / folder).rglob("*.py")),
    *(path for path in (ROOT / "tests").rglob("*.py") if not path.name.startswith("test_")),
]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]


def name_of(face: Path) -> str:
    return ".".join(face.parent.relative_to(ROOT).parts)


def exports(face: Path) -> set[str]:
    """What is imported from the package's own modules and not used in the face itself, or listed."""
    tree = ast.parse(face.read_text(encoding="utf-8"))
    own = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.level]
    here = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return {alias.name for node in own for alias in node.names} - here | exports_to_type_checkers(face)


def exports_to_type_checkers(face: Path) -> set[str]:
    """What is imported as itself, ``from a import x as x``, or listed: those who use the package may import it."""
    tree = ast.parse(face.read_text(encoding="utf-8"))
    imported = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    listed = [ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign) and is_all(node)]
    return {alias.name for alias in imported if alias.asname == alias.name}.union(*listed)


def is_all(node: ast.Assign) -> bool:
    return any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets)


def package_of(path: Path) -> Path | None:
    """The folder of the face that a module is behind."""
    return next((folder for folder in path.parents if folder / "__init__.py" in FACES), None)


PACKAGES = {name_of(face) for face in FACES}


@cache
def imports() -> list[tuple[Path, str, str]]:
    """All uses of names of the package, imported or as attributes of an imported package: file, module, name."""
    found: list[tuple[Path, str, str]] = []
    for path in (*USERS, *PAGES):
        source = path.read_text(encoding="utf-8")
        if path.suffix == ".md":
            source = "\n".join(re.findall(r"^```python\n(.*?)^```", source, re.M | re.S))
        nodes = list(ast.walk(ast.parse(source)))
        mine = [
            (path, f"{name_of(path)}.{node.module}" if node.level else node.module, alias.name)
            for node in nodes
            if isinstance(node, ast.ImportFrom) and node.module
            for alias in node.names
        ]
        packages = {name: f"{module}.{name}" for _, module, name in mine if (f"{module}.{name}") in PACKAGES}
        found += mine
        found += [
            (path, packages[node.value.id], node.attr)
            for node in nodes
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in packages
        ]
    return found


@pytest.mark.parametrize("face", FACES, ids=map(name_of, FACES))
def test_what_is_exported_is_used_outside(face):
    name = name_of(face)
    used = {imported for path, module, imported in imports() if module == name and package_of(path) != face.parent}
    assert exports(face) - used == set()


@pytest.mark.parametrize("face", FACES, ids=map(name_of, FACES))
def test_what_examples_and_pages_use_is_exported_to_type_checkers(face):
    name = name_of(face)
    readers = {*PAGES, *(ROOT / "examples").rglob("*.py")}
    used = {imported for path, module, imported in imports() if module == name and path in readers}
    assert used & exports(face) <= exports_to_type_checkers(face)


def test_private_modules_export_nothing():
    found = [
        path.relative_to(ROOT).as_posix()
        for path in PACKAGE.rglob("_*.py")
        if path.name not in ("__init__.py", "__main__.py")
        and "__all__" in (text := path.read_text(encoding="utf-8"))
        and any(isinstance(node, ast.Assign) and is_all(node) for node in ast.parse(text).body)
    ]
    assert found == []
