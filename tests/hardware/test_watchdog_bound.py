"""How long a light burns at most when replies are lost, and what goes dark first."""

from __future__ import annotations

import threading
import time

import pytest
from faulty_bench import set_fault, trace

from lightopt.core.errors import HardwareError
from lightopt.rig.capture._safe_devices import LightWatchdog
from lightopt.rig.devices import LIGHT_DRIVERS, LightSettings, LightsStillOnError, all_off, run_in_parallel
from lightopt.rig.simulated import BenchProcess

LONGEST_S = 0.3
TIMEOUT_S = 3.0  # of a reply, of which each command waits for three; a busy machine may darken some time later


def burned_s(bench, device, channel):
    """How long a channel burned, by the bench's clock."""
    changes = [(t, share) for t, name, number, share in trace(bench) if (name, number) == (device, channel)]
    lit = next(t for t, share in changes if share)
    return next(t for t, share in changes if t > lit and not share) - lit


@pytest.mark.parametrize(("kind", "tcp", "answered"), [("ccs", True, 1), ("sa", False, 0)])
def test_a_light_burns_no_longer_because_replies_are_lost(kind, tcp, answered):
    """The controller falls silent as the light comes on: for ccs once it has acknowledged the intensity."""
    with BenchProcess({"main": {"kind": kind, "tcp": tcp}}) as bench:
        settings = LightSettings("main", bench.ports["main"], timeout_s=TIMEOUT_S)
        controller = LIGHT_DRIVERS[kind](settings, None)
        set_fault(bench, "main", "drop", count=None, after=answered)
        watch = LightWatchdog(lambda _light: controller.set_level(3, 0))
        watch.start("light", LONGEST_S)
        with pytest.raises(HardwareError, match="because a light had to be switched off"):
            controller.set_level(3, 200)
        until = time.monotonic() + 60
        while bench.levels("main")[3] and time.monotonic() < until:
            time.sleep(0.02)
        assert burned_s(bench, "main", 3) < LONGEST_S + 0.8 * TIMEOUT_S
        set_fault(bench, "main", "clear")
        watch.stop_all()
        controller.close()


def test_a_reading_gives_way_to_darkening():
    with BenchProcess({"main": {"kind": "ccs", "options": {"levels": {"1": 200}}}}) as bench:
        controller = LIGHT_DRIVERS["ccs"](LightSettings("main", bench.ports["main"], timeout_s=5.0), None)
        set_fault(bench, "main", "drop")
        watch = LightWatchdog(lambda _light: controller.set_level(1, 0))
        watch.start("light", 0.1)
        with pytest.raises(HardwareError, match="no longer waited for"):
            controller.read_level(2)
        watch.stop_all()  # waits for the thread that darkens
        assert not any(bench.levels("main").values())
        assert controller.read_level(1) == 0
        controller.close()


class Controller:
    """Notes down which channels are darkened; a mute one fails at each, once `waits_for` has darkened all its own."""

    channels = 4

    def __init__(self, *, mute=False, waits_for=None):
        self.mute, self.waits_for, self.dark, self.all_dark = mute, waits_for, [], threading.Event()

    def set_level(self, channel, level):
        assert level == 0
        self.dark.append(channel)
        if len(self.dark) == self.channels:
            self.all_dark.set()
        if self.mute:
            if self.waits_for is not None:
                assert self.waits_for.all_dark.wait(60), "it waits for the mute one"
            raise HardwareError("no reply")


def test_what_burns_goes_dark_first_whatever_the_other_controllers_do():
    right = Controller()
    left = Controller(mute=True, waits_for=right)
    with pytest.raises(LightsStillOnError) as raised:
        all_off({"left": left, "right": right}, lit={"right": [4], "left": [3]})
    assert right.dark == [4, 1, 2, 3]
    assert left.dark == [3, 1, 2, 4]
    assert raised.value.channels == {"left": [1, 2, 3, 4]}
    assert raised.value.messages == (
        "controller left, channels 1, 2, 3, 4: not switched off, may still be lit: no reply",
    )


def test_the_report_does_not_depend_on_who_is_first_to_fail():
    def slow(_channel, _level):
        time.sleep(0.1)
        raise HardwareError("slow")

    left, right = Controller(), Controller()
    left.set_level = slow
    right.mute = True
    with pytest.raises(LightsStillOnError) as raised:
        all_off({"left": left, "right": right, "third": Controller()})
    assert [message.partition(",")[0] for message in raised.value.messages] == ["controller left", "controller right"]


def test_all_of_it_is_done_although_some_fails_and_no_thread_can_be_started(monkeypatch):
    done = []

    def fail():
        raise KeyboardInterrupt("SIGINT")

    work = {"a": fail, "b": lambda: done.append("b"), "c": lambda: done.append("c")}
    with pytest.raises(KeyboardInterrupt, match="SIGINT"):
        run_in_parallel(work)
    assert sorted(done) == ["b", "c"]

    def none_left(_self):
        raise RuntimeError("can't create new thread at interpreter shutdown")

    monkeypatch.setattr(threading.Thread, "start", none_left)
    with pytest.raises(KeyboardInterrupt, match="SIGINT"):
        run_in_parallel(work)
    assert done[2:] == ["b", "c"]
    assert run_in_parallel({}) == {}
