"""What the control socket of the virtual bench can be asked, by the name of the request."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import astuple
from typing import Any

from lightopt.rig.simulated._fault_trigger import Trigger
from lightopt.rig.simulated._world import World

Answer = tuple[dict[str, Any], bytes]
"""A JSON object, and bytes that follow it; often none."""

Handler = Callable[[Mapping[str, Any]], Answer]
"""Answers a request; runs in a thread of the asking connection. A ValueError or KeyError becomes the asker's."""


def handlers(world: World) -> dict[str, Handler]:
    """Requests about the devices of a world."""

    def state(_: Mapping[str, Any]) -> Answer:
        now = time.monotonic()
        with world.lock:
            devices = {name: device.deliveries for name, device in world.devices.items()}
            return {
                "pid": os.getpid(),
                "time": now,
                "ports": world.ports(),
                "deliveries": devices,
                "struck": Trigger.struck,
                "levels": world.levels(),
                "positions": world.positions(now),
            }, b""

    def trace(_: Mapping[str, Any]) -> Answer:
        with world.lock:
            return {"changes": [astuple(change) for change in world.trace]}, b""

    def fault(request: Mapping[str, Any]) -> Answer:
        world.inject(request["device"], request["fault"], dict(request.get("options", {})), time.monotonic())
        return {}, b""

    def unplug(request: Mapping[str, Any]) -> Answer:
        world.pull(request["device"])
        return {}, b""

    return {"state": state, "trace": trace, "fault": fault, "unplug": unplug}
