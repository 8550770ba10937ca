"""The process of a virtual bench: serves simulated devices on their wires until whoever started it is gone.

It takes requests on standard input, and answers on standard output. Each request is a line ``{"do": name, …}``; each
answer is a line ``{"ok": true, …, "bytes": n}`` followed by n bytes, or ``{"ok": false, "error": text, "bytes": 0}``.
"""

import contextlib
import json
import os
import select
import socket
import threading
import time
from collections.abc import Mapping
from typing import Any, BinaryIO

from lightopt.core.errors import error_text
from lightopt.rig.simulated._bench_process import CAMERA, CameraSetup
from lightopt.rig.simulated._camera import BenchCamera
from lightopt.rig.simulated._camera_gige import GigeCamera
from lightopt.rig.simulated._devices import Handler, Response, SimulatedDevices


def run(spec: Mapping[str, Any]) -> None:
    """Serve devices and camera of a :class:`BenchProcess`: first answer their ports; end with standard input."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    devices = SimulatedDevices(spec["devices"])
    requests, ports = devices.requests(), devices.ports()
    gige: GigeCamera | None = None
    if "camera" in spec:
        camera = BenchCamera(CameraSetup.of(spec["camera"]), devices)
        requests |= camera.requests()
        if spec["camera"].get("gige"):
            resolution_px, bit_depth = camera.sensor()
            gige = GigeCamera(camera.expose, resolution_px=resolution_px, bit_depth=bit_depth)
            ports[CAMERA] = gige.serial
    answers.write(json.dumps({"ports": ports, "bytes": 0}).encode() + b"\n")
    answers.flush()
    ours, theirs = socket.socketpair()
    threading.Thread(target=_answer_requests, args=(requests, answers, theirs), daemon=True).start()
    try:
        _serve(devices, ours)
    finally:
        devices.close()
        if gige is not None:
            gige.close()


def _answer_requests(handlers: Mapping[str, Handler], answers: BinaryIO, bell: socket.socket) -> None:
    """Ring when standard input ends: whoever held its other end has closed it, or is dead."""
    with bell, contextlib.suppress(OSError), os.fdopen(0, "rb", closefd=False) as requests:
        for line in requests:
            answer, data = _answer(handlers, line)
            answers.write(json.dumps({**answer, "bytes": len(data)}).encode() + b"\n" + data)
            answers.flush()


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


def _answer(handlers: Mapping[str, Handler], line: bytes) -> Response:
    try:
        request: dict[str, Any] = json.loads(line)
        name = request["do"]
        if name not in handlers:
            raise ValueError(f'no request called "{name}"; there is {", ".join(handlers)}')
        answer, data = handlers[name](request)
    except (ValueError, KeyError, TypeError) as error:
        return {"ok": False, "error": error_text(error)}, b""
    return {"ok": True, **answer}, data
