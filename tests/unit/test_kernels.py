"""Compiled kernels are cached under a name that changes with their sources."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from lightopt import kernels

PACKAGE = Path(kernels.__file__).parent


@pytest.fixture
def copy(tmp_path, monkeypatch):
    """A copy of the rooms with kernels, which the cache's name is then made from."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "cache"))
    for room in kernels._ROOMS:
        shutil.copytree(PACKAGE / room, tmp_path / room)
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "kernels.py"))
    return tmp_path


def test_every_room_with_kernels_counts():
    users = {
        path.relative_to(PACKAGE).parts[0]
        for path in PACKAGE.rglob("*.py")
        if "from lightopt.kernels import" in path.read_text(encoding="utf-8")
    }
    assert users == set(kernels._ROOMS)


@pytest.mark.parametrize("room", kernels._ROOMS)
def test_an_edit_in_any_of_them_makes_all_kernels_anew(copy, room):
    before = kernels.cache_folder()
    assert kernels.cache_folder() == before
    assert before.is_relative_to(copy / "cache")
    source = sorted((copy / room).glob("*.py"))[0]
    source.write_text(source.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert kernels.cache_folder() != before


def test_a_cache_that_cannot_be_written_is_replaced_by_a_private_one(copy):
    (copy / "cache").write_text("a file where the folder should be", encoding="utf-8")
    folder = kernels.cache_folder()
    assert folder.is_dir()
    assert not folder.is_relative_to(copy)
    folder.rmdir()
