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

from lightopt.rig.simulated._camera import BenchCamera
from lightopt.rig.simulated._camera_setup import CameraSetup
from lightopt.rig.simulated._control import ControlServer, Handler, Response, handlers
from lightopt.rig.simulated._devices import SimulatedDevices
from lightopt.rig.simulated._gige import GigeCamera
from lightopt.rig.simulated._wires import have_ptys

CAMERA = "camera"
"""Name of a GigE camera among the devices."""


def run(spec: Mapping[str, Any]) -> None:
    """Serve a bench: print one JSON line with its ports, and return when standard input ends.

    spec: ``devices`` (see :class:`SimulatedDevices`), ``tcp``, and ``camera`` (see :class:`CameraSetup`).
    """
    devices = SimulatedDevices(spec["devices"], tcp=bool(spec.get("tcp", not have_ptys)))
    requests = handlers(devices)
    gige: GigeCamera | None = None
    if "camera" in spec:
        camera = BenchCamera(
            CameraSetup.of(spec["camera"]),
            lambda device: devices.levels()[device],
            lambda device: devices.positions(time.monotonic())[device],
        )
        requests |= camera.requests()
        if spec["camera"].get("gige"):
            resolution_px, bit_depth = camera.sensor()
            gige = GigeCamera(camera.expose, resolution_px=resolution_px, bit_depth=bit_depth)
            requests |= _camera_faults(dict(requests), gige)
    token = secrets.token_hex(16)
    control = ControlServer(requests, token)
    hello = {"control": control.port, "token": token, "ports": devices.ports()}
    if gige is not None:
        hello["ports"] = {**devices.ports(), CAMERA: gige.serial}
    print(json.dumps(hello), flush=True)  # noqa: T201  (how the ports are handed over)
    ours, theirs = socket.socketpair()
    threading.Thread(target=_await_end, args=(theirs,), daemon=True).start()
    try:
        _serve(devices, ours)
    finally:
        control.close()
        devices.close()
        if gige is not None:
            gige.close()


def _camera_faults(requests: Mapping[str, Handler], gige: GigeCamera) -> dict[str, Handler]:
    """Requests about faults and cables, for the camera as for the devices."""

    def fault(request: Mapping[str, Any]) -> Response:
        if request["device"] != CAMERA:
            return requests["fault"](request)
        gige.inject(request["fault"], dict(request.get("options", {})))
        return {}, b""

    def unplug(request: Mapping[str, Any]) -> Response:
        if request["device"] != CAMERA:
            return requests["unplug"](request)
        gige.unplug()
        return {}, b""

    return {"fault": fault, "unplug": unplug}


def _await_end(bell: socket.socket) -> None:
    """Ring when standard input ends: whoever held its other end has closed it, or is dead."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    bell.close()


def _serve(devices: SimulatedDevices, bell: socket.socket) -> None:
    while True:
        # Which wires there are changes with every client; select alone keeps no memory of closed ones.
        watched = [bell.fileno(), *devices.waiting()]
        try:
            ready, _, _ = select.select(watched, [], [], devices.pause_s(time.monotonic()))
        except OSError:  # a cable was pulled meanwhile
            continue
        if bell.fileno() in ready:
            return
        devices.serve(time.monotonic(), ready)
