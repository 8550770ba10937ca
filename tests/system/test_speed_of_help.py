"""``lightopt --help`` is instant, because it imports nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numpy", "numba", "pydantic", "OpenImageIO", "trimesh", "PIL", "rich", "cascadio", "embreex", "yaml")


def loaded(statement: str) -> set[str]:
    """Top-level modules that are loaded after a statement, in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(ran.stdout.split("\n")[-2].split())


@pytest.mark.parametrize(
    "statement",
    [
        "import lightopt",
        "import lightopt.cli",
        "from lightopt.cli._main import run; run(['--help'])",
        "from lightopt.cli._main import run; run(['render', '--help'])",
        "from lightopt.cli._main import run; run(['--version'])",
        "from lightopt.cli._main import run; run(['rendr'])",
    ],
)
def test_nothing_heavy_is_imported(statement):
    assert not loaded(statement) & set(HEAVY)


def test_the_test_would_notice():
    assert "numpy" in loaded("import lightopt.sensor")
