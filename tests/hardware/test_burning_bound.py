"""How long a light burns at most when replies are lost, and what goes dark first."""

from __future__ import annotations

import time

import pytest

from lightopt.capture._burning import BurnWatch
from lightopt.errors import HardwareError
from lightopt.hardware import LightSettings, light_drivers
from lightopt.virtualbench import BenchProcess

LONGEST_S = 0.3


def burned_s(bench, device, channel):
    """How long a channel burned, by the bench's clock."""
    changes = [(t, share) for t, name, number, share in bench.trace() if (name, number) == (device, channel)]
    lit = next(t for t, share in changes if share)
    return next(t for t, share in changes if t > lit and not share) - lit


@pytest.mark.parametrize(("kind", "tcp", "answered"), [("ccs", True, 1), ("sa", False, 0)])
def test_a_light_burns_no_longer_because_replies_are_lost(kind, tcp, answered):
    """The controller falls silent as the light comes on: for ccs once it has acknowledged the intensity."""
    with BenchProcess({"main": {"kind": kind}}, tcp=tcp) as bench:
        settings = LightSettings("main", bench.ports["main"], timeout_s=1.0)
        controller = light_drivers()[kind](settings, None)
        bench.set_fault("main", "drop", count=None, after=answered)
        watch = BurnWatch(lambda _light: controller.set_level(3, 0))
        watch.begin("light", LONGEST_S)
        with pytest.raises(HardwareError, match="because a light had to be switched off"):
            controller.set_level(3, 200)
        until = time.monotonic() + 3
        while bench.levels("main")[3] and time.monotonic() < until:
            time.sleep(0.02)
        assert burned_s(bench, "main", 3) < LONGEST_S + 0.4
        bench.set_fault("main", "clear")
        watch.end_all()
        controller.close()


def test_a_reading_gives_way_to_darkening():
    with BenchProcess({"main": {"kind": "ccs", "options": {"levels": {"1": 200}}}}) as bench:
        controller = light_drivers()["ccs"](LightSettings("main", bench.ports["main"], timeout_s=5.0), None)
        bench.set_fault("main", "drop")
        watch = BurnWatch(lambda _light: controller.set_level(1, 0))
        watch.begin("light", 0.1)
        with pytest.raises(HardwareError, match="no longer waited for"):
            controller.read_level(2)
        watch.end_all()  # waits for the thread that darkens
        assert not any(bench.levels("main").values())
        assert controller.read_level(1) == 0
        controller.close()
