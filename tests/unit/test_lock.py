"""The locked environment: what pyproject.toml asks for, in one exact version with hashes for each Python."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
EXTRAS = {"dev": ("test", "dev"), "ci": ("test", "dev", "aravis", "genicam"), "docs": ("docs",)}
PLATFORMS = [
    {"python_version": version, "python_full_version": f"{version}.4", "sys_platform": platform}
    for version in ("3.10", "3.11", "3.12", "3.13")
    for platform in ("linux", "win32")
]


def requested(extras) -> list[Requirement]:
    """Direct dependencies as pyproject.toml has them, and the package that builds lightopt."""
    # Python 3.10 has no reader of TOML
    lists = dict(re.findall(r"^(\w+) = \[(.*?)\][ ]*(?:#[^\n]*)?$", PYPROJECT, re.MULTILINE | re.DOTALL))
    lines = [lists["requires"], lists["dependencies"], *(lists[extra] for extra in extras)]
    found = [Requirement(text) for line in lines for text in re.findall(r'"([^"]+)"', line)]
    return [requirement for requirement in found if requirement.name != "lightopt"]


def locked(name) -> list[tuple[Requirement, int]]:
    """Requirements of a lock, and how many hashes each has."""
    text = (ROOT / "requirements" / f"{name}.lock").read_text(encoding="utf-8")
    entries = re.split(r"^(?=[A-Za-z])", text, flags=re.MULTILINE)[1:]
    return [(Requirement(entry.split("\\\n")[0].strip()), entry.count("--hash=sha256:")) for entry in entries]


def test_direct_dependencies_are_read():
    names = {requirement.name for requirement in requested(EXTRAS["ci"])}
    assert {"setuptools", "numba", "pytest", "ruff", "PyGObject", "harvesters"} <= names
    assert len(names) > 25


@pytest.mark.parametrize("name", EXTRAS)
def test_everything_is_in_one_exact_version_with_hashes(name):
    for requirement, hashes in locked(name):
        assert [clause.operator for clause in requirement.specifier] == ["=="], requirement
        assert hashes, requirement


@pytest.mark.parametrize("environment", PLATFORMS, ids=lambda e: f"{e['python_version']}-{e['sys_platform']}")
@pytest.mark.parametrize("name", EXTRAS)
def test_a_lock_is_within_the_ranges_of_every_direct_dependency(name, environment):
    environment = {**default_environment(), **environment}
    versions = {}
    for requirement, _ in locked(name):
        if requirement.marker is None or requirement.marker.evaluate(environment):
            key = canonicalize_name(requirement.name)
            assert key not in versions, f"{key} twice"
            versions[key] = next(iter(requirement.specifier)).version
    for requirement in requested(EXTRAS[name]):
        version = versions.get(canonicalize_name(requirement.name))
        assert version is not None, f"make lock: {requirement.name} is not in requirements/{name}.lock"
        assert requirement.specifier.contains(version, prereleases=True), f"make lock: {requirement}, not {version}"


def test_a_lock_has_what_its_packages_need():
    """They are installed without looking for that."""
    names = {canonicalize_name(requirement.name) for requirement, _ in locked("dev")}
    missing = set()
    for name in names:
        try:
            needs = distribution(name).requires or []
        except PackageNotFoundError:  # of another platform
            continue
        for need in map(Requirement, needs):
            if need.marker is None or need.marker.evaluate({"extra": ""}):
                missing |= {canonicalize_name(need.name)} - names
    assert not missing


def test_both_locks_have_the_same_versions():
    both = [{str(requirement) for requirement, _ in locked(name)} for name in ("dev", "ci")]
    assert both[0] <= both[1]
