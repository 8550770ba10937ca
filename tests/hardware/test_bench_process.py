"""The process of the virtual bench: its wires, its life and death, and what it tells."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from faulty_bench import set_fault, trace

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import LIGHT_DRIVERS, LightSettings
from lightopt.rig.devices._device import LinkLostError, ReplyError
from lightopt.rig.devices._serial_link import SerialLink
from lightopt.rig.simulated import BenchProcess, _bench_process

START = _bench_process.start_process
CCS = {"kind": "ccs", "options": {"levels": {"1": 255}}}


@pytest.fixture(autouse=True)
def started_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Benches of this module are not forked, as those of other tests are."""
    monkeypatch.setattr(_bench_process, "start_process", START)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    return True


def eventually(condition: Callable[[], bool], within_s: float = 60.0) -> bool:
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_world_and_trace() -> None:
    with BenchProcess({"top": CCS, "side": {"kind": "sa", "tcp": True}}) as bench:
        assert bench.ports["side"].startswith("socket://127.0.0.1:")
        state = bench.state()
        assert (state["pid"], set(state["levels"]), state["positions"]) == (bench.pid, {"top", "side"}, {})
        controller = LIGHT_DRIVERS["ccs"](LightSettings("top", bench.ports["top"]), None)
        controller.set_level(2, 51)
        controller.set_level(2, 0)
        controller.close()
        changes = trace(bench)
        assert [change[1:] for change in changes] == [("top", 1, 1.0), ("top", 2, 0.2), ("top", 2, 0.0)]
        assert state["time"] <= changes[1][0] <= changes[2][0] <= bench.state()["time"]


def test_a_description_that_cannot_be_served() -> None:
    for devices, words in (
        ({"a": {"kind": "ccz"}}, 'no firmware called "ccz"; there is ccs, sa, template'),
        ({"a": {"kind": "ccs", "options": {"chanels": 3}}}, "chanels"),
        ({"a": {"kind": "ccs", "options": {"levels": {"9": 3}}}}, "no level 3 on channel 9"),
        ({"a": {"kind": "sa", "options": {"ack": "x"}}}, "ack is one of"),
        ({"a": {}}, "lacks 'kind'"),
        ({"a": {"kind": "template", "options": {"template": {"set": "{level}", "set_reply": "(?=x)"}}}}, "make up"),
    ):
        with pytest.raises(InputError, match="virtual bench: cannot be as described; its output: .*" + words):
            BenchProcess(devices)


def test_requests_that_are_none() -> None:
    with BenchProcess({"a": CCS}) as bench:
        for do, arguments, words in (
            ("nothing", {}, "there is state, trace, fault, unplug"),
            ("fault", {"device": "b", "fault": "drop"}, 'no device called "b"; there is a'),
            ("fault", {"device": "a", "fault": "drip"}, 'no fault called "drip"; there are dark, lit, deaf'),
            ("fault", {"device": "a", "fault": "drop", "options": {"cuont": 1}}, "cuont"),
            ("fault", {"device": "a", "fault": "drop", "options": {"count": 0}}, "drop: .*count from 1"),
            ("fault", {"device": "a", "fault": "dark", "options": {"channel": 7}}, "a channel from 1 to 4"),
            ("fault", {"device": "a", "fault": "ng", "options": {"code": 9}}, "code 1, 2 or 3"),
            ("unplug", {}, "device"),
        ):
            with pytest.raises(ValueError, match=words):
                bench.request(do, **arguments)
        assert bench.levels("a")[1] == 1


def test_killed_bench_is_a_pulled_cable() -> None:
    bench = BenchProcess({"a": CCS})
    controller = LIGHT_DRIVERS["ccs"](LightSettings("a", bench.ports["a"]), None)
    bench.kill()
    with pytest.raises(LinkLostError):
        controller.set_level(1, 0)
    with pytest.raises(HardwareError, match=r"virtual bench: .*the request state"):
        bench.state()
    controller.close()
    bench.close()
    bench.close()


def test_closing_ends_the_process_and_removes_its_ports() -> None:
    bench = BenchProcess({"a": CCS})
    bench.close()
    assert not alive(bench.pid)
    with pytest.raises(InputError):
        SerialLink(bench.ports["a"], device="a", baud=9600)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")
def test_the_bench_dies_with_whoever_started_it() -> None:
    """No orphan, even after kill -9."""
    program = (
        "import sys, time\nfrom lightopt.rig.simulated import BenchProcess\n"
        f"bench = BenchProcess({{'a': {CCS!r}}})\nprint(bench.pid, flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert alive(pid)
        parent.kill()
        parent.wait()
    assert eventually(lambda: not alive(pid))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")
def test_ctrl_c_is_for_the_client() -> None:
    """All processes of a terminal get it, and lights can only be darkened by a bench that is still there."""
    with BenchProcess({"a": CCS}) as bench:
        assert os.getpgid(bench.pid) != os.getpgid(0)
        assert os.getsid(bench.pid) != os.getsid(0)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")
def test_ctrl_c_of_a_bench_started_by_hand() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "lightopt.rig.simulated", json.dumps({"devices": {"a": CCS}})],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    with process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(5) == 130
        assert process.stderr.read() == b""


def test_usage() -> None:
    for arguments, words in (([], "usage: "), (["{"], "double quotes"), (["{}"], "lacks 'devices'")):
        ran = subprocess.run(
            [sys.executable, "-m", "lightopt.rig.simulated", *arguments], capture_output=True, text=True, check=False
        )
        assert ran.returncode == (2 if arguments else 1)
        assert words in ran.stderr
        assert "Traceback" not in ran.stderr


def test_clients_come_and_go() -> None:
    with BenchProcess({"a": CCS | {"tcp": True, "wedges": True}}) as bench:
        for level in (1, 2, 3):
            controller = LIGHT_DRIVERS["ccs"](LightSettings("a", bench.ports["a"]), None)
            controller.set_level(2, level)
            with pytest.raises(HardwareError, match="its one connection"):
                SerialLink(bench.ports["a"], device="b", baud=9600)
            controller.close()


def test_an_empty_connection_wedges_the_device_that_is_said_to() -> None:
    with BenchProcess({"a": CCS | {"tcp": True, "wedges": True}}) as bench:
        with socket.create_connection(("127.0.0.1", int(bench.ports["a"].rpartition(":")[2]))):
            pass
        time.sleep(0.1)
        with pytest.raises(ReplyError, match="no reply"):
            LIGHT_DRIVERS["ccs"](LightSettings("a", bench.ports["a"], timeout_s=0.05), None)
        assert bench.levels("a")[1] == 1


def silent(link: SerialLink) -> bool:
    try:
        link.query(b"SA#", end=b"a0000")
    except ReplyError:
        return True
    return False


def test_faults_by_count_and_chance() -> None:
    with BenchProcess({"a": {"kind": "sa"}}) as bench:

        def lost(requested: int) -> list[int]:
            link = SerialLink(bench.ports["a"], device="a", baud=19200, timeout_s=0.5)
            missing = [i for i in range(requested) if silent(link)]
            link.close()
            return missing

        set_fault(bench, "a", "drop", after=2, count=3)
        assert lost(7) == [2, 3, 4]
        set_fault(bench, "a", "drop", count=None, probability=0.5, seed=3)
        first = lost(12)
        set_fault(bench, "a", "clear")
        assert lost(3) == []
        set_fault(bench, "a", "drop", count=None, probability=0.5, seed=3)
        assert lost(12) == first
        assert 0 < len(first) < 12


def test_a_late_reply_does_not_hold_up_those_after_it() -> None:
    with BenchProcess({"a": {"kind": "sa"}}) as bench:
        set_fault(bench, "a", "delay", delay_s=0.3)
        link = SerialLink(bench.ports["a"], device="a", baud=19200)
        link.send(b"SB0001#")
        assert eventually(lambda: bench.state()["deliveries"]["a"] == 1)
        assert link.query(b"SA#", end=b"a0000") == b"a0000"
        assert link.read(end=b"b") == b"b"
        link.close()


@pytest.mark.parametrize("module", [None, "raise SystemExit('the wrong lightopt')\n"])
def test_a_folder_called_lightopt_where_the_bench_is_started(tmp_path: Path, module: str | None) -> None:
    """As in the folder in which the repository was cloned, by a program that lies elsewhere."""
    here, program = tmp_path / "here", tmp_path / "bin" / "program.py"
    (here / "lightopt").mkdir(parents=True)
    if module is not None:
        (here / "lightopt" / "__init__.py").write_text(module, encoding="utf-8")
    program.parent.mkdir()
    program.write_text(
        "from lightopt.rig.simulated import BenchProcess\n"
        f"with BenchProcess({{'a': {CCS!r}}}) as bench:\n"
        "    print(bench.levels('a')[1] == 1)\n",
        encoding="utf-8",
    )
    ran = subprocess.run([sys.executable, program], cwd=here, capture_output=True, text=True, timeout=300)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "True\n", "")


def test_a_bench_that_crashes_says_so_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import sys\ndef deep(): raise RuntimeError('no more wires')\ndeep()"
    monkeypatch.setattr("lightopt.rig.simulated._bench_process._START", program)
    with pytest.raises(HardwareError) as raised:
        BenchProcess({"a": CCS})
    assert str(raised.value) == "virtual bench: did not start; its output: RuntimeError: no more wires"
