"""The process of a virtual bench: serves simulated devices on their wires until whoever started it is gone.

It takes requests about the devices over a control socket: JSON lines on the loopback.
"""

import contextlib
import hmac
import json
import os
import secrets
import select
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any

from lightopt.core.errors import error_text
from lightopt.rig.simulated._camera import BenchCamera, Handler, Response
from lightopt.rig.simulated._camera_gige import GigeCamera
from lightopt.rig.simulated._camera_setup import CAMERA, CameraSetup
from lightopt.rig.simulated._devices import SimulatedDevices


def run(spec: Mapping[str, Any]) -> None:
    """Serve devices and camera of a :class:`BenchProcess`: print their ports as JSON; end with standard input."""
    devices = SimulatedDevices(spec["devices"])
    camera: BenchCamera | None = None
    gige: GigeCamera | None = None
    if "camera" in spec:
        camera = BenchCamera(
            CameraSetup.of(spec["camera"]),
            lambda device: devices.levels()[device],
            lambda device: devices.positions(time.monotonic())[device],
        )
        if spec["camera"].get("gige"):
            resolution_px, bit_depth = camera.sensor()
            gige = GigeCamera(camera.expose, resolution_px=resolution_px, bit_depth=bit_depth)
    requests = {**device_requests(devices, gige), **(camera.requests() if camera is not None else {})}
    token = secrets.token_hex(16)
    control = ControlServer(requests, token)
    ports = devices.ports() | ({} if gige is None else {CAMERA: gige.serial})
    hello = {"control": control.port, "token": token, "ports": ports}
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


def device_requests(devices: SimulatedDevices, _gige: GigeCamera | None) -> dict[str, Handler]:
    """Requests about the devices."""

    def state(_: Mapping[str, Any]) -> Response:
        with devices.lock:
            return {"levels": devices.levels(), "positions": devices.positions(time.monotonic())}, b""

    return {"state": state}


class ControlServer:
    """Answers requests on a loopback port, one thread per connection.

    The first line of a connection is the token. Each request is a line ``{"do": name, …}``; each answer is a line
    ``{"ok": true, …, "bytes": n}`` followed by n bytes, or ``{"ok": false, "error": text, "bytes": 0}``. The token is
    a secret, because other users of the computer reach the loopback too.
    """

    def __init__(self, handlers: Mapping[str, Handler], token: str) -> None:
        class Connection(socketserver.StreamRequestHandler):
            disable_nagle_algorithm = True

            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    if not hmac.compare_digest(self.rfile.readline(1000).strip(), token.encode()):
                        return
                    for line in self.rfile:
                        answer, data = _answer(handlers, line)
                        self.wfile.write(json.dumps({**answer, "bytes": len(data)}).encode() + b"\n" + data)

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True

        self._server = Server(("127.0.0.1", 0), Connection)
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


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
