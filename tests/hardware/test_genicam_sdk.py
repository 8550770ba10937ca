"""The driver of GenTL producers against doubles of its library: a camera that goes away, frames without numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from lightopt.core.errors import HardwareError
from lightopt.rig.devices._camera_genicam import GenicamSdk
from lightopt.rig.devices._device import LinkLostError


class IoException(Exception):  # noqa: N818  (the library calls it so)
    """As the library's: the cable is out."""


class InvalidAddressException(Exception):  # noqa: N818  (the library calls it so)
    """As the library's: the camera answers that there is nothing."""


class Port:
    """A camera's registers, which are asked only when something failed."""

    def __init__(self, error: Exception | None) -> None:
        self.error = error
        self.requested = 0

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        self.requested += 1
        if self.error is not None:
            raise self.error
        return length, bytes(length)


def sdk_with(port: Port) -> tuple[GenicamSdk, list[str]]:
    """The driver with a camera of which every feature fails."""
    log: list[str] = []

    def fails(name: str) -> Any:
        log.append(name)
        raise RuntimeError("it failed")

    sdk = GenicamSdk.__new__(GenicamSdk)
    sdk._where, sdk._lost = "rig.yaml:3: camera", None
    sdk._nodes = SimpleNamespace(has_node=lambda name: True, get_node=fails)
    sdk._acquirer = SimpleNamespace(remote_device=SimpleNamespace(port=port), stop=lambda: fails("stop"))
    return sdk, log


def test_a_camera_that_is_gone_is_not_queried_again() -> None:
    sdk, log = sdk_with(port := Port(IoException("no answer")))
    with pytest.raises(LinkLostError, match=r"rig\.yaml:3: camera: executing TriggerSoftware: the camera does not"):
        sdk.execute("TriggerSoftware")
    for again in (sdk.stop, lambda: sdk.read("ExposureTime", float), lambda: sdk.has("Gain")):
        with pytest.raises(LinkLostError):
            again()
    assert log == ["TriggerSoftware"]
    assert port.requested == 1


@pytest.mark.parametrize("error", [None, InvalidAddressException("no such register")])
def test_a_feature_that_fails_on_a_camera_that_answers_is_no_lost_camera(error: Exception | None) -> None:
    sdk, log = sdk_with(Port(error))
    for _ in range(2):
        with pytest.raises(HardwareError, match="reading Gain: it failed") as raised:
            sdk.read("Gain", float)
        assert not isinstance(raised.value, LinkLostError)
    assert log == ["Gain", "Gain"]
    with pytest.raises(HardwareError, match="Gain: it failed"):
        sdk.has("Gain")


def test_a_frame_of_a_producer_that_does_not_number_them_has_no_number() -> None:
    class Module:
        padding_x = 0
        pixel_format = 0x01080001
        timestamp_ns = 5
        raw_buffer = bytes(4)

        @property
        def frame_id(self) -> int:
            raise RuntimeError("not available")

        def is_complete(self) -> bool:
            return True

    part = SimpleNamespace(width=2, height=2, data_offset=0)
    sdk, _ = sdk_with(Port(None))
    raw = sdk._raw(SimpleNamespace(module=Module(), payload=SimpleNamespace(components=[part])))
    assert (raw.number, raw.timestamp_ns, raw.name) == (None, 5, "a frame without a number")
