"""``lightopt --help`` is instant, because it imports nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {
    "numpy", "numba", "pydantic", "OpenImageIO", "trimesh", "PIL", "matplotlib", "rich", "cascadio", "embreex", "yaml",
}  # fmt: skip


def loaded(statement: str) -> set[str]:
    """Top-level modules that are loaded after a statement, in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(ran.stdout.split("\n")[-2].split())


@pytest.mark.parametrize("statement", ["import lightopt", "import lightopt.cli", "import lightopt.__main__"])
def test_importing_the_command_line_imports_nothing_heavy(statement):
    assert not loaded(statement) & HEAVY


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments):
    assert not loaded(f"from lightopt.cli._main import run; run({arguments})") & HEAVY


@pytest.mark.parametrize("arguments", [["render", "--help"], ["rendr"]])
def test_a_commands_help_imports_no_more_than_typer_does(arguments):
    # newer releases of typer look at a command's options through pydantic
    assert loaded(f"from lightopt.cli._main import run; run({arguments})") & HEAVY <= {"pydantic"}


def test_matplotlib_is_imported_when_something_is_drawn_and_not_before():
    assert "matplotlib" not in loaded("import lightopt.report")


def test_the_test_would_notice():
    assert "numpy" in loaded("import lightopt.optics")
