"""Fixtures of the unit tests."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from lightopt.report import _surface


@pytest.fixture
def read_only_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder that this user, even root, cannot write to."""
    if sys.platform == "win32":
        pytest.skip("a Windows folder has no mode that keeps its owner from writing")
    if os.geteuid() == 0:
        yield Path("/sys")
    else:
        tmp_path.chmod(0o500)
        yield tmp_path
        tmp_path.chmod(0o700)


@pytest.fixture
def world():
    """Devices of a rig in memory."""
    from capture_doubles import World

    return World()


@pytest.fixture
def take(bench, world, monkeypatch):
    """Capture the small rig on doubles that settle at once."""
    from capture_doubles import connecting

    from lightopt.config import load_part, load_rig
    from lightopt.config._hardware import TimingConfig
    from lightopt.rig.capture import CaptureOptions, CapturePlan, _wiring, capture
    from lightopt.scene import build_scene

    plain = _wiring.HardwareConfig

    def quick(**given):
        return plain(**given, timing=TimingConfig(light_ms=2, stage_ms=3))

    monkeypatch.setattr(_wiring, "HardwareConfig", quick)
    # what the devices do is compared step by step: however slow the disk, lights wait for it
    monkeypatch.setattr(CapturePlan, "relighting_s", 60.0)
    rig, part = load_rig(bench.rig), load_part(bench.part)
    scene = build_scene(rig.without_programme(), part)

    def run(folder=bench.out, truth=None, rig=rig, part=part, **options):
        control = {key: options.pop(key) for key in ("resume", "force", "run") if key in options}
        return capture(
            rig, part, folder, options=CaptureOptions(**options), connect=connecting(world, scene, truth), **control
        )

    return run


@pytest.fixture(scope="session", autouse=True)
def small_stills() -> Iterator[None]:
    """Stills of reports have a ninth of their pixels; browsers look at whole ones, in tests/system."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_surface, "STILL_WIDTH", _surface.STILL_WIDTH // 3)
        patch.setattr(_surface, "STILL_HEIGHT", _surface.STILL_HEIGHT // 3)
        yield
