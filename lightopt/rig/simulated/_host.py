"""The process of a virtual bench: serves simulated devices on their wires until whoever started it is gone."""

from __future__ import annotations

import json
import os
import secrets
import select
import socket
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._camera import BenchCamera, CameraSetup
from lightopt.rig.simulated._control import Answer, ControlServer, Handler, handlers
from lightopt.rig.simulated._gige import GigeCamera
from lightopt.rig.simulated._wires import have_ptys
from lightopt.rig.simulated._world import World

CAMERA = "camera"
"""Name of a GigE camera among the devices."""


def run(spec: Mapping[str, Any]) -> None:
    """Serve a bench: print one JSON line with its ports, and return when standard input ends.

    spec: ``devices`` (see :class:`World`), ``tcp``, and ``camera`` (see :class:`CameraSetup`).

    Raises ValueError for devices that cannot be built; nothing is served then.
    """
    world = World(spec["devices"], tcp=bool(spec.get("tcp", not have_ptys)))
    requests = handlers(world)
    gige: GigeCamera | None = None
    if "camera" in spec:
        camera = _camera(world, spec["camera"])
        requests |= camera.requests()
        if spec["camera"].get("gige"):
            gige = _gige(camera)
            requests |= _camera_faults(dict(requests), gige)
    token = secrets.token_hex(16)
    control = ControlServer(requests, token)
    hello = {"control": control.port, "token": token, "ports": world.ports()}
    if gige is not None:
        hello["ports"] = {**world.ports(), CAMERA: gige.serial}
    print(json.dumps(hello), flush=True)  # noqa: T201  (how the ports are handed over)
    ours, theirs = socket.socketpair()
    threading.Thread(target=_await_end, args=(theirs,), daemon=True).start()
    try:
        _serve(world, ours)
    finally:
        control.close()
        world.close()
        if gige is not None:
            gige.close()


def _gige(camera: BenchCamera) -> GigeCamera:
    resolution_px, bit_depth = camera.sensor()
    return GigeCamera(camera.look, resolution_px=resolution_px, bit_depth=bit_depth)


def _camera_faults(requests: Mapping[str, Handler], gige: GigeCamera) -> dict[str, Handler]:
    """Requests about faults and cables, for the camera as for the devices."""

    def fault(request: Mapping[str, Any]) -> Answer:
        if request["device"] != CAMERA:
            return requests["fault"](request)
        gige.inject(request["fault"], dict(request.get("options", {})))
        return {}, b""

    def unplug(request: Mapping[str, Any]) -> Answer:
        if request["device"] != CAMERA:
            return requests["unplug"](request)
        gige.unplug()
        return {}, b""

    return {"fault": fault, "unplug": unplug}


def _camera(world: World, setup: Mapping[str, Any]) -> BenchCamera:
    return BenchCamera(
        CameraSetup.of(setup),
        lambda device: world.levels()[device],
        lambda device: world.positions(time.monotonic())[device],
    )


def _await_end(bell: socket.socket) -> None:
    """Ring when standard input ends: whoever held its other end has closed it, or is dead."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    bell.close()


def _serve(world: World, bell: socket.socket) -> None:
    while True:
        # Which wires there are changes with every client; select alone keeps no memory of closed ones.
        watched = [bell.fileno(), *world.waiting()]
        try:
            ready, _, _ = select.select(watched, [], [], world.pause_s(time.monotonic()))
        except OSError:  # a cable was pulled meanwhile
            continue
        if bell.fileno() in ready:
            return
        world.serve(time.monotonic(), ready)
