"""A machine-vision camera against a scripted one: how it is set, triggered, checked, and asked again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import CameraInfo, CameraSettings, Event, frame_limit_s
from lightopt.rig.devices._camera import FrameOrder, MachineCamera
from lightopt.rig.devices._camera_sdk import RawFrame, choose_camera
from lightopt.rig.devices._device import LinkLostError

SETTINGS = CameraSettings(where="rig.yaml:7: camera", resolution_px=(4, 2), bit_depth=8)


class Sdk:
    """A camera in memory: features are a dictionary, and a list says what each trigger delivers."""

    def __init__(self, **features: Any) -> None:
        self.features: dict[str, Any] = {
            "PixelFormat": "Mono8",
            "Width": 64,
            "Height": 48,
            "OffsetX": 5,
            "OffsetY": 5,
            "ExposureTime": 100.0,
            "Gain": 1.5,
            "ExposureAuto": "Continuous",
            "GammaEnable": True,
            "TriggerMode": "Off",
            "TriggerSource": "Line0",
            "TriggerSelector": "FrameStart",
            "AcquisitionMode": "SingleFrame",
            **features,
        }
        self.choices = {
            "PixelFormat": ("Mono8", "Mono12p"),
            "TriggerSource": ("Line0", "Software"),
            "TriggerSelector": ("FrameStart",),
        }
        self.limits = {
            "Width": (4.0, 64.0, 2.0),
            "Height": (2.0, 48.0, 2.0),
            "OffsetX": (0.0, 60.0, 4.0),
            "OffsetY": (0.0, 60.0, 4.0),
            "ExposureTime": (20.0, 1e6, 0.0),
            "Gain": (0.0, 24.0, 0.0),
        }
        self.units: dict[str, str] = {}
        self.stuck: dict[str, Any] = {}
        self.script: list[Callable[[int], list[RawFrame]]] = []
        self.queue: list[RawFrame] = []
        self.count = 0
        self.log: list[str] = []
        self.details = {"model": "scripted"}

    def has(self, feature: str) -> bool:
        return feature in self.features

    def read(self, feature: str, kind: Callable[[Any], Any]) -> Any:
        return kind(self.stuck.get(feature, self.features[feature]))

    def write(self, feature: str, value: Any) -> None:
        self.log.append(f"{feature}={value:g}" if isinstance(value, float) else f"{feature}={value}")
        self.features[feature] = value

    def bounds(self, feature: str) -> tuple[float, float, float]:
        return self.limits[feature]

    def unit(self, feature: str) -> str:
        return self.units.get(feature, "")

    def entries(self, feature: str) -> tuple[str, ...]:
        return self.choices[feature]

    def execute(self, feature: str) -> None:
        self.log.append(feature)
        self.count += 1
        step = self.script.pop(0) if self.script else lambda n: [frame(n)]
        self.queue += step(self.count)

    def start(self) -> None:
        self.log.append("start")
        self.queue.clear()

    def stop(self) -> None:
        self.log.append("stop")

    def pop(self, timeout_s: float) -> RawFrame | None:
        if not self.queue:
            time.sleep(timeout_s)
            return None
        return self.queue.pop(0)

    def close(self) -> None:
        self.log.append("close")


class InjectedTime:
    """Time that passes by being slept through, and a little by being looked at."""

    now_s = 1000.0

    def monotonic(self) -> float:
        self.now_s += 1e-5
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture(autouse=True)
def injected_time(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = InjectedTime()
    monkeypatch.setattr("lightopt.rig.devices._camera.time", passes)
    monkeypatch.setitem(globals(), "time", passes)


def frame(number: int, **changed: Any) -> RawFrame:
    whole = RawFrame(
        data=np.full(8, number % 256, np.uint8),
        width=4,
        height=2,
        code=0x01080001,
        number=number,
        timestamp_ns=number * 1000,
    )
    return replace(whole, **changed)


def opened(sdk: Sdk | None = None, **changed: Any) -> tuple[MachineCamera, Sdk, list[Event]]:
    reported: list[Event] = []
    sdk = sdk or Sdk()
    return MachineCamera("aravis", sdk, replace(SETTINGS, **changed), on_event=reported.append), sdk, reported


def test_it_is_set_as_a_measuring_instrument() -> None:
    camera, sdk, reported = opened()
    wanted = {
        "ExposureAuto": "Off",
        "GammaEnable": False,
        "TriggerMode": "On",
        "TriggerSource": "Software",
        "AcquisitionMode": "Continuous",
        "Width": 4,
        "Height": 2,
        "OffsetX": 28,  # (64 - 4) / 2 = 30, and it moves by 4
        "OffsetY": 20,
        "Gain": 1.5,
    }
    assert {name: sdk.features[name] for name in wanted} == wanted
    assert (camera.triggered, camera.resolution_px, camera.bit_depth) == (True, (4, 2), 8)
    assert camera.exposure_range_us == (20.0, 1e6)
    assert camera.identify()["gain"] == "1.5"
    assert "start" not in sdk.log
    assert reported == []


ALTERED = {
    "LUTEnable": (True, False),
    "ReverseX": (True, False),
    "ReverseY": (True, False),
    "BinningHorizontal": (2, 1),
    "BinningVertical": (2, 1),
    "DecimationHorizontal": (4, 1),
    "DecimationVertical": (4, 1),
    "TestPattern": ("GreyDiagonalRamp", "Off"),
    "TestImageSelector": ("TestImage1", "Off"),
    "ExposureMode": ("TriggerWidth", "Timed"),
}


def altered() -> Sdk:
    """As another program may have left it."""
    sdk = Sdk(**{name: found for name, (found, _) in ALTERED.items()})
    sdk.choices["TestPattern"] = sdk.choices["TestImageSelector"] = ("Off", "GreyDiagonalRamp", "TestImage1")
    return sdk


def test_what_alters_the_image_is_switched_off_before_its_size_is_set() -> None:
    _, sdk, _ = opened(altered())
    assert {name: sdk.features[name] for name in ALTERED} == {name: to for name, (_, to) in ALTERED.items()}
    assert sdk.log.index("BinningHorizontal=1") < sdk.log.index("Width=4")


@pytest.mark.parametrize("feature", ALTERED)
def test_what_alters_the_image_and_cannot_be_switched_off_is_refused(feature: str) -> None:
    sdk = altered()
    sdk.stuck[feature] = ALTERED[feature][0]
    with pytest.raises(HardwareError, match=f"{feature} was set to .*, and the camera holds"):
        opened(sdk)
    assert sdk.log[-1] == "close"


def test_no_frame_waits_for_another_trigger_than_its_own() -> None:
    class Selects(Sdk):
        """A camera with a trigger mode for each kind of trigger."""

        modes = {"AcquisitionStart": "On", "FrameStart": "Off", "FrameBurstStart": "On"}  # noqa: RUF012

        def read(self, feature: str, kind: Callable[[Any], Any]) -> Any:
            chosen = self.features["TriggerSelector"]
            return self.modes[chosen] if feature == "TriggerMode" else super().read(feature, kind)

        def write(self, feature: str, value: Any) -> None:
            super().write(feature, value)
            if feature == "TriggerMode":
                self.modes[self.features["TriggerSelector"]] = value

    sdk = Selects()
    sdk.choices["TriggerSelector"] = tuple(sdk.modes)
    camera, _, _ = opened(sdk)
    assert sdk.modes == {"AcquisitionStart": "Off", "FrameStart": "On", "FrameBurstStart": "Off"}
    assert sdk.features["TriggerSelector"] == "FrameStart"
    assert camera.triggered


@pytest.mark.parametrize(
    ("sdk", "changed", "words"),
    [
        (Sdk(), {"resolution_px": (66, 2)}, "larger than the camera's sensor of 64 × 48"),
        (Sdk(), {"resolution_px": (5, 2)}, "5 pixels in Width, and this camera can do 4 and more in steps of 2"),
        (Sdk(), {"offset_px": (2, 0)}, "multiples of 4 only"),
        (Sdk(), {"offset_px": (64, 0)}, "more than the sensor's 64"),
        (Sdk(), {"gain": 25.0}, "a gain of 0 to 24"),
        (Sdk(), {"bit_depth": 10}, "no pixel format of 10 bits"),
        (Sdk(), {"fixed_exposure_us": 10.0}, "leave out fixed_exposure_us"),
    ],
)
def test_what_the_camera_cannot_be_is_refused_and_it_is_closed(sdk, changed, words) -> None:
    with pytest.raises(InputError, match=r"rig\.yaml:7: camera") as raised:
        opened(sdk, **changed)
    assert words in str(raised.value)
    assert sdk.log[-1] == "close"


@pytest.mark.parametrize(("feature", "held"), [("Width", 8), ("Gain", 12.0), ("TriggerMode", "Off"), ("OffsetX", 0)])
def test_what_does_not_take_is_refused(feature, held) -> None:
    sdk = Sdk()
    sdk.stuck[feature] = held
    with pytest.raises(HardwareError, match=f"{feature} was set to .*, and the camera holds {held}"):
        opened(sdk, gain=3.0)


def test_a_camera_without_trigger_or_exposure_is_said_to_be_so() -> None:
    sdk = Sdk()
    sdk.choices["TriggerSource"] = ("Line0",)
    with pytest.raises(InputError, match="write trigger: none"):
        opened(sdk, trigger="software")
    assert not opened(sdk)[0].triggered
    del sdk.features["ExposureTime"]
    with pytest.raises(InputError, match="write fixed_exposure_us"):
        opened(sdk)
    camera, _, _ = opened(sdk, fixed_exposure_us=500.0)
    assert camera.exposure_range_us == (500.0, 500.0)
    assert camera.set_exposure(500.0) == 500.0
    with pytest.raises(InputError, match="500 to 500"):
        camera.set_exposure(400.0)


def test_an_exposure_beyond_the_bounds_is_not_sent() -> None:
    camera, sdk, _ = opened()
    sdk.log.clear()
    for wrong in (19.0, 1.1e6):
        with pytest.raises(InputError, match="an exposure of 20 to"):
            camera.set_exposure(wrong)
    assert sdk.log == []
    sdk.stuck["ExposureTime"] = 100.0
    assert camera.set_exposure(200.0) == 100.0  # the run refuses what does not take


def exposing(feature: str, bounds: tuple[float, float], unit: str = "", **features: Any) -> Sdk:
    sdk = Sdk(**{feature: bounds[0]}, **features)
    if feature != "ExposureTime":
        del sdk.features["ExposureTime"]
    sdk.limits[feature] = (*bounds, 1.0)
    sdk.units[feature] = unit
    return sdk


@pytest.mark.parametrize(
    ("sdk", "written", "range_us"),
    [
        (exposing("ExposureTime", (20.0, 1e6)), "ExposureTime=800", (20.0, 1e6)),
        (exposing("ExposureTime", (0.02, 1e3), "ms"), "ExposureTime=0.8", (20.0, 1e6)),
        (exposing("ExposureTime", (20.0, 1e6), "\u03bcs"), "ExposureTime=800", (20.0, 1e6)),
        (exposing("ExposureTimeAbs", (20.0, 1e6)), "ExposureTimeAbs=800", (20.0, 1e6)),
        (exposing("ExposureTimeRaw", (20.0, 1e6), "us"), "ExposureTimeRaw=800", (20.0, 1e6)),
        (exposing("ExposureTimeRaw", (1.0, 4095.0), ExposureTimeBaseAbs=20.0), "ExposureTimeRaw=40", (20.0, 81_900.0)),
    ],
)
def test_an_exposure_is_microseconds_whatever_the_camera_counts(sdk, written, range_us) -> None:
    camera, _, _ = opened(sdk)
    assert camera.exposure_range_us == pytest.approx(range_us)
    sdk.log.clear()
    assert camera.set_exposure(800.0) == pytest.approx(800.0)
    assert sdk.log == [written]
    assert camera.grab(timeout_s=1).exposure_us == pytest.approx(800.0)


@pytest.mark.parametrize(
    "sdk", [exposing("ExposureTimeRaw", (1.0, 4095.0)), exposing("ExposureTime", (1.0, 4095.0), "lines")]
)
def test_an_exposure_in_units_that_nobody_knows_is_not_reported(sdk) -> None:
    with pytest.raises(InputError, match="in units of unknown length; write fixed"):
        opened(sdk)
    camera, _, _ = opened(sdk, fixed_exposure_us=500.0)
    assert camera.set_exposure(500.0) == 500.0
    assert camera.grab(timeout_s=1).exposure_us == 500.0
    assert not any(line.startswith("ExposureTime") for line in sdk.log)


def test_a_frame_is_requested_once_there_can_be_one() -> None:
    sdk = Sdk()
    camera = MachineCamera("aravis", sdk, SETTINGS, wait_ready=lambda _: sdk.log.append("ready"))
    sdk.log.clear()
    camera.grab(timeout_s=1)
    assert sdk.log == ["ready", "start", "TriggerSoftware"]


def test_each_grab_is_one_trigger() -> None:
    camera, sdk, reported = opened()
    frames = [camera.grab(timeout_s=1) for _ in range(3)]
    assert [f.number for f in frames] == [1, 2, 3]
    assert [f.timestamp_ns for f in frames] == [1000, 2000, 3000]
    assert frames[1].levels.tolist() == [[2] * 4] * 2
    assert sdk.log.count("TriggerSoftware") == 3
    assert sdk.log.count("start") == 1
    assert reported == []


BAD = {
    "nothing came": (lambda n: [], "no frame came within"),
    "incomplete": (lambda n: [frame(n, problem="missing packets")], "frame 2 is incomplete: missing packets"),
    "again": (lambda n: [frame(1, timestamp_ns=5000)], "frame 1 came a second time"),
    "backwards": (lambda n: [frame(0, timestamp_ns=5000)], "frame 0 came after frame 1"),
    "stale": (lambda n: [frame(n, timestamp_ns=500)], "frame 2 is stale: it was taken 0.0005 ms before frame 1"),
    "old stamp": (lambda n: [frame(n, timestamp_ns=1000)], "frame 2 is stale"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_frame_that_is_not_sound_is_taken_again_and_reported(name: str) -> None:
    step, words = BAD[name]
    camera, sdk, reported = opened()
    camera.grab(timeout_s=1)
    sdk.script = [step]
    found = camera.grab(timeout_s=0.3)
    assert found.number == 3
    assert [event.retry for event in reported] == [True]
    assert "taken again (1 of 2) after: rig.yaml:7: camera: " in reported[0].what
    assert words in reported[0].what
    assert camera.events == reported
    assert sdk.log.count("stop") == 1  # what is under way is not taken for the next


@pytest.mark.parametrize("name", BAD)
def test_attempts_are_bounded_and_so_is_the_time(name: str) -> None:
    step, words = BAD[name]
    camera, sdk, _ = opened()
    camera.grab(timeout_s=1)
    sdk.script = [step, *[lambda n: [frame(n, problem="missing packets")] if "came within" not in words else []] * 5]
    begun = time.monotonic()
    with pytest.raises(HardwareError, match="taken 3 times"):
        camera.grab(timeout_s=0.6)
    assert time.monotonic() - begun < 1.5  # not three times as long
    assert sdk.log.count("TriggerSoftware") == 4
    with pytest.raises(HardwareError):  # a camera that failed gets one attempt at a time until it delivers
        camera.grab(timeout_s=0.3)
    assert sdk.log.count("TriggerSoftware") == 5


class Slow(Sdk):
    """A camera of which frames come when they have been exposed; the first so many never."""

    def __init__(self, lost: int) -> None:
        super().__init__()
        self.lost = lost
        self.done = float("inf")

    def execute(self, feature: str) -> None:
        self.log.append(feature)
        self.count += 1
        self.done = time.monotonic() + self.features["ExposureTime"] / 1e6
        if self.count <= self.lost:
            self.done = float("inf")

    def pop(self, timeout_s: float) -> RawFrame | None:
        late = self.done > time.monotonic() + timeout_s
        time.sleep(timeout_s if late else max(0.0, self.done - time.monotonic()))
        if late:
            return None
        self.done = float("inf")
        return frame(self.count)


def test_each_attempt_has_time_for_its_exposure() -> None:
    camera, sdk, reported = opened(Slow(2))
    limit_s = frame_limit_s(camera.set_exposure(400_000.0), 0.6)
    begun = time.monotonic()
    assert camera.grab(timeout_s=limit_s).number == 3
    assert [event.retry for event in reported] == [True, True]
    sdk.lost = 9
    begun = time.monotonic()
    with pytest.raises(HardwareError, match="taken 3 times"):
        camera.grab(timeout_s=limit_s)
    assert limit_s - 0.01 < time.monotonic() - begun < 2.0 * limit_s  # all attempts together
    sdk.lost = 0
    assert camera.grab(timeout_s=0.5).number == 7  # there is time for one


def test_frames_that_never_end_are_not_thrown_away_for_ever() -> None:
    sdk = Sdk()
    camera, _, _ = opened(sdk, trigger="none")
    numbers = count(1)
    sdk.pop = lambda timeout_s: frame(next(numbers))
    with pytest.raises(HardwareError, match=r"frames come faster .* \(taken 3 times\)"):
        camera.grab(timeout_s=0.3)


def test_a_frame_that_nobody_requested_is_thrown_away_and_reported() -> None:
    camera, sdk, reported = opened()
    camera.grab(timeout_s=1)
    sdk.queue = [frame(2)]
    sdk.count = 2
    assert camera.grab(timeout_s=1).number == 3
    assert ["discarded" in event.what and not event.retry for event in reported] == [True]


def test_frames_that_the_camera_counted_and_that_never_came_are_reported() -> None:
    camera, sdk, reported = opened()
    camera.grab(timeout_s=1)
    sdk.count = 3
    assert camera.grab(timeout_s=1).details["frames_lost"] == 2
    assert "and 2 before it never did" in reported[0].what


def test_a_freely_running_camera_delivers_what_comes_after_the_question() -> None:
    sdk = Sdk()
    camera, _, reported = opened(sdk, trigger="none")
    assert sdk.features["TriggerMode"] == "Off"
    sdk.start()
    waiting = [frame(1), frame(2)]

    def pop(timeout_s: float) -> RawFrame | None:
        if timeout_s == 0.0:
            return waiting.pop(0) if waiting else None
        return frame(3)

    sdk.pop = pop
    assert camera.grab(timeout_s=1).number == 3
    assert reported == []
    assert "TriggerSoftware" not in sdk.log


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"width": 2}, "set to 4 × 2 pixels, and frame 1 has 2 × 2"),
        ({"code": 0x01100007}, "set to Mono8 .* another pixel format"),
        ({"data": np.zeros(7, np.uint8)}, "takes 8 bytes, and the camera delivered 7"),
    ],
)
def test_a_frame_of_another_form_ends_it(changed, words) -> None:
    camera, sdk, reported = opened()
    sdk.script = [lambda n: [frame(n, **changed)]]
    with pytest.raises(HardwareError, match=words):
        camera.grab(timeout_s=1)
    assert reported == []


def test_a_camera_that_is_gone_is_not_queried_again_and_closes_silently() -> None:
    camera, sdk, reported = opened()
    camera.grab(timeout_s=1)

    def gone(*_: object) -> None:
        raise LinkLostError("gone")

    sdk.execute = sdk.stop = gone
    with pytest.raises(LinkLostError):
        camera.grab(timeout_s=1)
    assert reported == []
    camera.close()
    assert sdk.log[-1] == "close"


def test_the_count_may_wrap_and_begin_anew() -> None:
    order = FrameOrder()
    for number in (65534, 65535, 1, 2):
        order.check(frame(number, timestamp_ns=None))
    assert order.lost == 0
    order.last = None
    order.check(frame(1))


@pytest.mark.parametrize("none", [None, 0])
def test_frames_of_a_camera_that_does_not_number_them_are_distinguished_by_their_time(none: int | None) -> None:
    camera, sdk, reported = opened()
    sdk.script = [lambda n: [replace(frame(n), number=none)]] * 3
    assert [camera.grab(timeout_s=1).number for _ in range(3)] == [none] * 3
    assert reported == []
    stale = replace(frame(1), number=none)
    sdk.script = [lambda n: [stale], lambda n: [replace(frame(n), number=none)]]
    camera.grab(timeout_s=1)
    assert ["is stale" in event.what for event in reported] == [True]


HERE = [
    CameraInfo(driver="aravis", identifier="A-1", serial="1", address="10.0.0.1"),
    CameraInfo(driver="aravis", identifier="B-2", serial="2"),
]


@pytest.mark.parametrize(("port", "found"), [("1", 0), ("10.0.0.1", 0), ("A-1", 0), ("2", 1)])
def test_a_camera_is_found_by_any_of_its_names(port: str, found: int) -> None:
    assert choose_camera(HERE, replace(SETTINGS, port=port)) is HERE[found]


@pytest.mark.parametrize(
    ("here", "port", "words"),
    [(HERE, None, "which of the cameras"), ([], None, "no camera answers"), (HERE, "3", "no camera 3; there is")],
)
def test_a_camera_that_is_not_clear_is_refused(here, port, words) -> None:
    with pytest.raises(InputError, match=words):
        choose_camera(here, replace(SETTINGS, port=port))
    assert choose_camera(HERE[:1], SETTINGS) is HERE[0]
