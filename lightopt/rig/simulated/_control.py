"""The control socket of the virtual bench: JSON lines on the loopback, and the requests that it answers."""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import socketserver
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import astuple
from typing import Any

from lightopt.core.errors import error_text
from lightopt.rig.simulated._devices import SimulatedDevices
from lightopt.rig.simulated._faults import Trigger

Response = tuple[dict[str, Any], bytes]
"""A JSON object, and bytes that follow it; often none."""

Handler = Callable[[Mapping[str, Any]], Response]
"""Responses a request; runs in a thread of the asking connection. A ValueError or KeyError becomes the asker's."""


def handlers(devices: SimulatedDevices) -> dict[str, Handler]:
    """Requests about simulated devices."""

    def state(_: Mapping[str, Any]) -> Response:
        now = time.monotonic()
        with devices.lock:
            return {
                "pid": os.getpid(),
                "time": now,
                "ports": devices.ports(),
                "deliveries": {name: device.deliveries for name, device in devices.devices.items()},
                "struck": Trigger.struck,
                "levels": devices.levels(),
                "positions": devices.positions(now),
            }, b""

    def trace(_: Mapping[str, Any]) -> Response:
        with devices.lock:
            return {"changes": [astuple(change) for change in devices.trace]}, b""

    def fault(request: Mapping[str, Any]) -> Response:
        devices.inject(
            request["device"], request["fault"], dict(request.get("options", {})), time.monotonic()
        )
        return {}, b""

    def unplug(request: Mapping[str, Any]) -> Response:
        devices.pull(request["device"])
        return {}, b""

    return {"state": state, "trace": trace, "fault": fault, "unplug": unplug}


class ControlServer:
    """Answers requests on a loopback port, one thread per connection.

    The first line of a connection is the token. Each request is a line ``{"do": name, …}``; each answer is a line
    ``{"ok": true, …, "bytes": n}`` followed by n bytes, or ``{"ok": false, "error": text, "bytes": 0}``.

    token: Secret that a client must know: other users of the computer reach the loopback too.
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
        """Take no more connections."""
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
