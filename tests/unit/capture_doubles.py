"""Lights, stage and camera of a rig in memory, which notes down what happens, in which order."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from lightopt.core.errors import HardwareError
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CapturePlan, Devices
from lightopt.rig.devices import Frame, StageState
from lightopt.rig.simulated._bench_process import BenchTruth
from lightopt.rig.simulated._optics import BenchOptics


@dataclass
class World:
    """What the devices do; `log` holds it in order, and `trouble` is called before each, to raise from."""

    levels: dict[tuple[str, int], int] = field(default_factory=dict)
    posture: Posture = field(default_factory=lambda: Posture(0.0, 0.0))
    slipped: Posture = field(default_factory=lambda: Posture(0.0, 0.0))
    log: list[tuple] = field(default_factory=list)
    trouble: Callable[[tuple], None] = lambda event: None
    events: list = field(default_factory=list)
    plugs: dict[tuple[str, int], tuple[str, int]] = field(default_factory=dict)

    def note(self, *event):
        self.log.append(event)
        self.trouble(event)

    @property
    def lit(self):
        return {key for key, level in self.levels.items() if level}

    def did(self, kind):
        return [event for event in self.log if event[0] == kind]


class Lights:
    top_level = 255

    def __init__(self, world, name, channels):
        self.world, self.name, self.channels = world, name, channels

    def identify(self):
        return {"driver": "double", "port": self.name}

    def set_level(self, channel, level):
        self.world.note("level", self.name, channel, level)
        self.world.levels[self.name, channel] = level
        self.level_set_s = time.monotonic()
        return self.read_level(channel)

    def read_level(self, channel):
        return self.world.levels.get((self.name, channel), 0)

    def close(self):
        self.world.log.append(("close", self.name))


class Stage:
    def __init__(self, world):
        self.world = world

    def identify(self):
        return {"driver": "double", "port": "stage"}

    def state(self):
        return StageState(posture=self.world.posture, moving=False, referenced=True)

    def home(self):
        self.world.note("home")
        self.world.posture = Posture(0.0, 0.0)

    def move_to(self, posture):
        self.world.note("move", posture)
        self.world.posture = posture
        return self.state()

    def confirm(self):
        self.world.note("confirm")
        return self.state()

    def stop(self):
        self.world.note("stop")

    def close(self):
        self.world.log.append(("close", "stage"))


class Camera:
    exposure_range_us = (10.0, 1e7)

    def __init__(self, world, wiring, scene, truth):
        self.world, self.wiring = world, wiring
        self.optics = BenchOptics(scene, truth)
        self.triggered = truth.triggered
        self.resolution_px = (scene.camera.width, scene.camera.height)
        self.bit_depth = scene.sensor.bit_depth
        self.number, self.held, self.seen = 0, 0.0, None

    def identify(self):
        return {"driver": "double", "port": "camera"}

    def set_exposure(self, exposure_us):
        self.held = float(round(exposure_us))
        return self.held

    def grab(self, *, timeout_s):
        self.world.note("grab", self.held)
        now = self.state()
        shares, posture = now if self.triggered or self.seen is None else self.seen
        levels = self.optics.frame(shares, posture, exposure=self.held / self.wiring.exposure_us)
        self.seen = now
        self.number += 1
        return Frame(levels=levels, exposure_us=self.held, number=self.number, timestamp_ns=time.time_ns())

    def state(self):
        shares = {}
        for name, channel in self.wiring.hardware.lights.items():
            plug = (channel.controller, channel.channel)
            plug = self.world.plugs.get(plug, plug)
            shares[name] = self.world.levels.get(plug, 0) / channel.level
        stands, slipped = self.world.posture, self.world.slipped
        return shares, Posture(stands.elevation_deg + slipped.elevation_deg, stands.rotation_deg + slipped.rotation_deg)

    def close(self):
        self.world.log.append(("close", "camera"))


def connecting(world: World, scene, truth: BenchTruth | None = None) -> Callable[[CapturePlan], Devices]:
    """Open the doubles of a rig."""

    def connect(plan: CapturePlan) -> Devices:
        world.log.append(("open",))
        hardware = plan.wiring.hardware
        return Devices(
            wiring=plan.wiring,
            controllers={name: Lights(world, name, c.channels) for name, c in hardware.controllers.items()},
            stage=Stage(world),
            camera=Camera(world, plan.wiring, scene, truth or BenchTruth()),
            events=lambda: world.events,
        )

    return connect


def broken(kind, *, number=1, error=None):
    """Trouble at the `number`-th event of a kind."""
    count = 0

    def trouble(event):
        nonlocal count
        if event[0] == kind:
            count += 1
            if count == number:
                raise error or HardwareError(f"the double fails at {kind} {number}")

    return trouble


def changing_at(world, grab, change):
    """Do something to the world at the `grab`-th frame."""

    def trouble(event):
        if event[0] == "grab" and len(world.did("grab")) == grab:
            change(world)

    return trouble
