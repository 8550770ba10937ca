"""The opened devices: dark on every way out, whatever else fails."""

from __future__ import annotations

import pytest
from capture_doubles import Camera, Lights, Stage, World, broken

from lightopt.capture import Devices, wiring_of
from lightopt.config import load_part, load_rig
from lightopt.errors import HardwareError
from lightopt.scene import build_scene
from lightopt.virtualbench import BenchTruth


@pytest.fixture
def world():
    return World()


@pytest.fixture
def rig(bench):
    return load_rig(bench.rig)


@pytest.fixture
def opened(bench, rig, world):
    """Opens the doubles of the small rig; `channel` is what its first light has besides."""

    def opened(channel=None, **options):
        wiring = wiring_of(rig)
        wiring.hardware.lights["light1"] = wiring.light("light1").model_copy(update=channel or {})
        scene = build_scene(rig, load_part(bench.part))
        return Devices(
            wiring=wiring,
            controllers={
                name: Lights(world, name, c.channels) for name, c in wiring.hardware.controllers.items()
            },
            stage=Stage(world),
            camera=Camera(world, wiring, scene, BenchTruth()),
            **options,
        )

    return opened


# --- closing


def test_all_is_closed_even_if_one_cannot_be(opened, world):
    closed = []

    def full():
        raise OSError("No space left on device")

    devices = opened(closing=(full, lambda: closed.append("bench")))
    devices.camera.close = full
    with pytest.raises(HardwareError) as raised, devices:
        devices.light_on("light1")
    assert raised.value.messages == (
        "closing a device failed: No space left on device",
        "closing a device failed: No space left on device",
        "all lights are off",
    )
    assert not world.burning
    assert closed == ["bench"]
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


def test_what_could_not_be_closed_does_not_hide_what_failed(opened, world):
    def full():
        raise OSError("No space left on device")

    world.trouble = broken("grab", error=HardwareError("no frame"))
    with pytest.raises(HardwareError, match="no frame") as raised, opened(closing=(full,)) as devices:
        devices.camera.grab(timeout_s=1.0)
    assert "all lights are off" in raised.value.messages
    assert raised.value.messages[-1] == "closing a device failed: No space left on device"
