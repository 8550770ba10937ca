"""The simulated CCS firmware against a client that its author never saw: PyPI's vstlight, for VS Technology's VLP.

It reads no replies, so it checks what the firmware understands.
"""

from __future__ import annotations

import socket
import time

import pytest

from lightopt.core.errors import HardwareError
from lightopt.rig.devices._serial_link import SerialLink
from lightopt.rig.simulated import BenchProcess

VSTLight = pytest.importorskip("VSTLight", reason="vstlight comes with the extra dev")


class Unhurried:
    """The client's socket, which waits for the replies before it is closed.

    Closed with replies unread, a connection is reset, and what a busy firmware has not read by then is lost.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def __getattr__(self, name: str) -> object:
        return getattr(self._connection, name)

    def close(self) -> None:
        self._connection.shutdown(socket.SHUT_WR)
        self._connection.settimeout(10.0)
        while self._connection.recv(4096):
            pass
        self._connection.close()


def client_of(bench: BenchProcess):
    client = VSTLight.NetworkController(4, "127.0.0.1", int(bench.ports["vlp"].rpartition(":")[2]))
    client._NetworkController__sock = Unhurried(client._NetworkController__sock)
    return client


def reopened(bench: BenchProcess) -> SerialLink:
    """A link, once the firmware has seen the client leave: it serves one at a time."""
    for _ in range(100):
        try:
            return SerialLink(bench.ports["vlp"], device="vlp", baud=38400, gap_s=0.006)
        except HardwareError:  # noqa: PERF203
            time.sleep(0.02)
    raise AssertionError("the firmware takes no other client")


def test_an_independent_client_is_understood() -> None:
    # It leaves 5 ms between commands by its own clock, which a busy computer may deliver closer together.
    options = {"levels": {"1": 255, "4": 255}}
    with BenchProcess({"vlp": {"kind": "ccs", "options": options, "tcp": True}}) as bench:
        client = client_of(bench)
        client.set_intensity(2, 125)
        client.set_on(2)
        client.set_on(3)
        client.set_intensity(3, 255)
        client.set_strobe_mode(3, 10)
        client.set_off(3)
        client.set_intensity(1, 7)
        client.toggle(1)
        # It leaves without destroy(), which would darken all.
        client._NetworkController__sock.close()

        link = reopened(bench)
        held = []
        for channel, checksum in enumerate((b"ED", b"EE", b"EF", b"F0")):
            reply = link.query(b"@%02dM" % channel + checksum + b"\r\n", end=b"\r\n")
            assert reply[-4:-2] == b"%02X" % (sum(reply[:-4]) % 256)
            held.append(reply[3:-4])
        link.close()
        assert held == [b"OF007.S01.L1", b"OF125.S01.L1", b"OF000.S10.L1", b"OF000.S01.L1"]


def test_destroy_darkens_all() -> None:
    options = {"levels": {"1": 255, "4": 9}}
    with BenchProcess({"vlp": {"kind": "ccs", "options": options, "tcp": True}}) as bench:
        client = client_of(bench)
        client.set_on(4)
        client.set_intensity(4, 99)
        client.destroy()
        link = reopened(bench)
        assert link.query(b"@03MF0\r\n", end=b"\r\n")[3:-4] == b"OF000.S01.L1"
        link.close()
