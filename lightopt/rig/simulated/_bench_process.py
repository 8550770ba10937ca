"""The virtual bench from outside: its process, its ports, the requests to it, and what its camera looks at."""

import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from lightopt.core.errors import HardwareError, InputError
from lightopt.core.interrupts import start_apart

_START_S, _REQUEST_S = 120.0, 120.0
_ANSWER_S = 10.0  # a process that has nothing to compute for an answer and takes longer hangs
_LOOK_S = 0.01
WRONG = 2  # exit status of the process where its description is at fault
# What this process finds its modules by, instead of the current folder, which may hold a clone of lightopt.
_START = (
    "import sys; sys.path[:] = sys.argv.pop(1).split(chr(10)); "
    "import runpy; runpy.run_module('lightopt.rig.simulated', run_name='__main__', alter_sys=True)"
)
CAMERA = "camera"  # name of a GigE camera among the devices of a bench
EXPOSURE_RANGE_US = (10.0, 10e6)
"""Shortest and longest exposure time of the virtual camera [µs]; it holds whole microseconds."""


@dataclass(frozen=True, kw_only=True)
class BenchTruth:
    """Where the bench differs from the files: the ground truth of tests."""

    seed: int = 1  # of the noise, and of the waviness of the surface
    gains: Mapping[str, float] = field(default_factory=dict[str, float])  # factors on the lights by name
    part_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from its place, at posture (0, 0) [mm]
    part_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector about the origin before that [rad]
    dark_level: float = 0.0  # added to the sensor's black level [sensor level]
    ambient_level: float = 0.0  # light that is always there, everywhere in the image [grey level at exposure 1]
    # whether frames begin on request; otherwise they follow one another, and the first after a change began before it
    triggered: bool = True
    rays: int = 1  # along each side of a pixel, which shows their mean, as a real camera's does; 1: its centre
    bounces: int = 0  # how often light goes from the part to the part


@dataclass(frozen=True)
class LightWire:
    """Where a light is plugged in, and the share of the highest intensity at which it is as the rig describes."""

    light: str
    device: str
    channel: int
    share: float


@dataclass(frozen=True)
class AxisWire:
    """Which axis of a device is the tilt or the rotation, its units per degree, and where 0° is."""

    device: str
    axis: str
    steps_per_deg: float
    zero: float

    def angle_deg(self, positions: Mapping[str, float]) -> float:
        return (positions[self.axis] - self.zero) / self.steps_per_deg


@dataclass(frozen=True, kw_only=True)
class CameraSetup:
    """What the camera looks at: files of rig and part, the wiring of lights and axes, and where the bench differs."""

    rig: str
    part: str
    exposure_us: float  # exposure time of exposure 1 [µs]
    lights: tuple[LightWire, ...]
    axes: Mapping[str, AxisWire] = field(default_factory=dict[str, AxisWire])  # elevation, rotation; others: fixed at 0
    truth: BenchTruth = field(default_factory=BenchTruth)
    gige: bool = False  # whether it is a GigE Vision camera on the loopback

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> "CameraSetup":
        lights = tuple(LightWire(**wire) for wire in data["lights"])
        axes = {name: AxisWire(**wire) for name, wire in data["axes"].items()}
        parts: dict[str, Any] = {"lights": lights, "axes": axes, "truth": BenchTruth(**data["truth"])}
        return cls(**{**data, **parts})


def start_process(spec: str, errors: BinaryIO) -> subprocess.Popen[bytes]:
    places = "\n".join(place or str(Path.cwd()) for place in sys.path)
    command = [sys.executable, "-c", _START, places, spec]
    return start_apart(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors)


class BenchProcess:
    """A virtual bench in a process of its own, which ends with this object or with this process.

    devices: By name: ``kind`` (ccs, sa, template, screen, shot, gsc, grbl, zaber) and, optionally, ``options`` of the
        firmware, ``tcp`` (whether it is on TCP; so it is where there are no pseudo-terminals).
    camera: What the camera looks at: a :class:`CameraSetup` as a dictionary.

    `ports` is what a driver opens, by device; `pid` its process id. InputError when a device cannot be as described.
    """

    def __init__(self, devices: Mapping[str, Mapping[str, Any]], *, camera: Mapping[str, Any] | None = None) -> None:
        spec = {"devices": devices, **({} if camera is None else {"camera": camera})}
        self._lock = threading.Lock()
        self._answers: queue.Queue[tuple[dict[str, Any], bytes]] = queue.Queue()
        self._usable = True
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as the process)
        self._process = start_process(json.dumps(spec), self._errors)
        self.pid = self._process.pid
        self._reader = threading.Thread(target=self._read_answers, daemon=True)
        try:
            self._reader.start()
            answer: dict[str, Any] = {}
            with suppress(queue.Empty):
                answer, _ = self._answers.get(timeout=_START_S)
            if not answer:
                with suppress(subprocess.TimeoutExpired):
                    if self._process.wait(_ANSWER_S) == WRONG:
                        raise InputError(*self._gone("cannot be as described").messages)
                raise self._gone("did not start")
            self.ports: dict[str, str] = answer["ports"]
        except BaseException:
            self.close()
            raise

    def request(self, do: str, *, timeout_s: float = _REQUEST_S, **arguments: Any) -> tuple[dict[str, Any], bytes]:
        """The bench's answer and its bytes; ValueError for a wrong request, HardwareError for no answer in time."""
        with self._lock:
            assert self._process.stdin is not None
            try:
                if not self._usable:
                    raise OSError("closed")
                self._usable = False  # until the answer is here: a late one must not be taken for the next
                self._process.stdin.write(json.dumps({"do": do, **arguments}).encode() + b"\n")
                self._process.stdin.flush()
                answer, data = self._answers.get(timeout=max(1e-3, timeout_s))
                self._usable = True
            except queue.Empty:
                late = f"did not answer the request {do} within {timeout_s:.3g} s: its process hangs"
                raise self._gone(late) from None
            except (OSError, ValueError) as error:
                raise self._gone(f"cannot take the request {do} ({error})") from None
        if not answer:
            raise self._gone(f"ended during the request {do}")
        if not answer.pop("ok"):
            raise ValueError(answer["error"])
        return answer, data

    def prepare(self, exposure_us: float) -> None:
        """Wait until the camera's view is rendered, however long that takes; meanwhile the bench has to answer."""
        try:
            while not self.request("prepare", timeout_s=_ANSWER_S, exposure_us=exposure_us)[0]["ready"]:
                time.sleep(_LOOK_S)
        except ValueError as error:
            raise self._gone(f"cannot render what its camera sees ({error})") from None

    def state(self) -> dict[str, Any]:
        """State now: ``levels`` and ``positions`` by device."""
        return self.request("state")[0]

    def levels(self, device: str) -> dict[int, float]:
        """Brightness of each channel of a controller, as a share of the highest."""
        return {int(channel): level for channel, level in self.state()["levels"][device].items()}

    def positions(self, device: str) -> dict[str, float]:
        """Where the axes of a stage really stand, in device units."""
        return self.state()["positions"][device]

    def kill(self) -> None:
        """Kill the process, as a power cut would: nothing is cleaned up."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process; never raises."""
        self._usable = False
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):  # of a process that has ended
            self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self.kill()
        self._reader.join()
        self._process.stdout.close()
        self._errors.close()

    def __enter__(self) -> "BenchProcess":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _read_answers(self) -> None:
        """Pass on the answers, each with the bytes that follow it; an empty one when the process has ended."""
        assert self._process.stdout is not None
        with suppress(ValueError):  # nothing more comes, or an answer breaks off
            while True:
                answer: dict[str, Any] = json.loads(self._process.stdout.readline())
                data = self._process.stdout.read(answer["bytes"])
                if len(data) < answer["bytes"]:
                    break
                self._answers.put((answer, data))
        self._answers.put(({}, b""))

    def _gone(self, what: str) -> HardwareError:
        output = ""
        if not self._errors.closed:
            self._errors.seek(0)
            output = self._errors.read().decode("utf-8", "replace").strip()
        if "Traceback (" in output:
            output = output.splitlines()[-1]
        return HardwareError(f"virtual bench: {what}" + (f"; its output: {output[-2000:]}" if output else ""))
