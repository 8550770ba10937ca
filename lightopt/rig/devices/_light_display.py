"""Displays as light controllers: each channel is a picture, and what is lit is shown together.

The screen shows the sum of the pictures of its lit channels, each times its level's share of the highest; black where
none is lit. Nothing shows what is on the glass: levels cannot be read back.

``screen`` is a window on a monitor of this computer, in a process of its own (``_screen_window.py``), or its simulated
counterpart: both take pictures on a wire, as ``SHOW width height bytes`` CR LF and the levels row by row as zlib packs
them, and answer ``OK`` or ``NG`` and why. ``command`` hands each picture to a program of the user's, as a PNG.
"""

import json
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np

from lightopt.config import PictureConfig
from lightopt.core.arrays import Float64, UInt8
from lightopt.core.errors import HardwareError, InputError
from lightopt.core.interrupts import start_apart
from lightopt.images import write_png
from lightopt.rig.devices._device import RefusedError, ReplyError
from lightopt.rig.devices._light import LightController, LightSettings
from lightopt.rig.devices._serial_link import Link, SerialLink, SerialLog

_START_S, _END_S = 30.0, 5.0
_WINDOW = Path(__file__).with_name("_screen_window.py")
_SLICE_S = 0.02  # longest single wait for a command
_MOST_STDERR = 500  # characters of what a command printed that a message has
_ROUNDING = 1e-9


def check_display(command: Sequence[str] | None, folder: Path) -> None:
    """Check that the program of a command, or without one the library of windows, is there, or raise an InputError."""
    if command is None:
        if find_spec("pygame") is None:
            raise InputError("driver: screen needs pygame-ce; install it: pip install 'lightopt[screen]'")
    elif program_path(command[0], folder) is None:
        where = "on the PATH" if Path(command[0]).name == command[0] else f"in {folder}"
        raise InputError(f"no program {command[0]} {where} that can be run; expected a program's name or path")


class ScreenProcess:
    """A window on a monitor, black until it gets a picture at `port`; it ends when its client has closed that.

    Raises InputError: The library is missing, or the monitor is not there or has another resolution.
    Raises HardwareError: The process does not start.
    """

    def __init__(self, monitor: int, size: tuple[int, int], *, device: str) -> None:
        check_display(None, Path())
        with tempfile.TemporaryFile() as errors:
            # this interpreter, a file of this package
            arguments = [sys.executable, str(_WINDOW), *map(str, (monitor, *size))]
            self._process = start_apart(arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
            watchdog = threading.Timer(_START_S, self._process.kill)
            watchdog.start()
            assert self._process.stdout is not None
            with self._process.stdout as answers:
                line = answers.readline()
            watchdog.cancel()
            errors.seek(0)
            words = errors.read().decode("utf-8", "replace").strip().splitlines()[-1:]
        answer: dict[str, Any] = json.loads(line or "{}")
        if "port" in answer:
            self.port = f"socket://127.0.0.1:{answer['port']}"
            return
        self._process.kill()
        self.close()
        if "problem" in answer:
            raise InputError(f"{device}: {answer['problem']}")
        raise HardwareError(f"{device}: the window's process did not start; its output: {''.join(words) or 'none'}")

    def close(self) -> None:
        """Wait until the window is closed, which it is once its client has gone; never raises."""
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def screen_levels(picture: Float64, settings: PictureConfig) -> UInt8:
    """Levels of the screen's pixels, row 0 at its own upper edge, for shares of full radiance as the part sees it."""
    levels = np.round(255.0 * np.clip(picture, 0.0, 1.0) ** (1.0 / settings.gamma)).astype(np.uint8)
    turned = np.rot90(levels, settings.turn_deg // 90)
    return np.ascontiguousarray(np.fliplr(turned) if settings.mirrored else turned)


class ScreenController(LightController):
    """A display: a full-screen window on a monitor, or a simulated screen at the port of the settings."""

    NAME = "screen"
    BAUD = 115200  # of no meaning on the wire that it has
    _process: ScreenProcess | None = None

    def __init__(self, link: Link, settings: LightSettings) -> None:
        super().__init__(link, settings)
        assert settings.picture is not None
        self._picture = settings.picture
        self._pictures = settings.pictures
        self._lit: dict[int, int] = {}
        self._shown: dict[int, int] | None = None  # levels of what is on the screen; None where that is unknown

    def _send_level(self, channel: int, level: int) -> None:
        lit = {one: held for one, held in {**self._lit, channel: level}.items() if held}
        if not level:
            self._lit = lit  # whatever becomes of it, it is not shown again
        if self._shown != lit:
            levels = screen_levels(self._sum(lit), self._picture)
            self._shown = None
            self._retry.run(lambda: self._show(levels))
            time.sleep(self._picture.settle_ms / 1e3)
            self._shown = lit
        self._lit = lit

    def _query_level(self, channel: int) -> int:
        return self._lit.get(channel, 0)

    def _sum(self, lit: dict[int, int]) -> Float64:
        width, height = self._picture.resolution_px
        total = np.zeros((width, height) if self._picture.turn_deg % 180 else (height, width))
        for channel, level in lit.items():
            if channel not in self._pictures:
                raise InputError(f"{self._link.device}: no light of the rig is on channel {channel}; nothing was shown")
            total += level / self.top_level * self._pictures[channel]()
        if total.max() > 1.0 + _ROUNDING:
            need = f"channels {', '.join(map(str, sorted(lit)))} together need {total.max():.3g} times"
            advice = "lower their levels, or the weights of the programme"
            raise InputError(f"{self._link.device}: {need} the full radiance of the screen; {advice}")
        return total

    @classmethod
    def open(cls, settings: LightSettings, log: SerialLog | None = None) -> LightController:
        if settings.port:
            return super().open(settings, log)
        assert settings.monitor is not None
        assert settings.picture is not None
        device = f"light controller {settings.name} ({cls.NAME}) on monitor {settings.monitor}"
        process = ScreenProcess(settings.monitor, settings.picture.resolution_px, device=device)
        try:
            controller = super().open(replace(settings, port=process.port), log)
        except BaseException:
            process.close()
            raise
        assert isinstance(controller, ScreenController)
        controller._process = process
        controller._link.port = f"monitor {settings.monitor}"
        return controller

    def _show(self, levels: UInt8) -> None:
        link: SerialLink = self._link
        data = zlib.compress(levels.tobytes(), 1)
        head = f"SHOW {levels.shape[1]} {levels.shape[0]} {len(data)}".encode("ascii")
        reply = link.query(head + b"\r\n" + data, end=b"\r\n")
        if reply.startswith(b"NG"):
            raise link.failure("it refuses the picture", sent=head, reply=reply, kind=RefusedError)
        if reply != b"OK\r\n":
            raise link.failure("the reply is no acknowledgement", sent=head, reply=reply, kind=ReplyError)

    def close(self) -> None:
        super().close()
        if self._process is not None:
            self._process.close()


class CommandLink(Link):
    """Runs a command for each picture; it is ended when something that cannot wait needs the screen."""

    def __init__(self, settings: LightSettings, log: SerialLog | None) -> None:
        assert settings.command is not None
        device = f"light controller {settings.name} (command)"
        super().__init__(settings.command[0], device=device, timeout_s=settings.timeout_s, log=log)
        self._command = settings.command
        self._folder = settings.folder
        self._pictures = tempfile.TemporaryDirectory(prefix="lightopt-", ignore_cleanup_errors=True)
        self._number = 0

    def show(self, levels: UInt8) -> None:
        """Write a picture and run the command; the file before stays, for programs that read it late."""
        with self.lock:
            folder = Path(self._pictures.name)
            self._number += 1
            path = folder / f"picture-{self._number}.png"
            try:
                write_png(path, levels, metadata={})
                (folder / f"picture-{self._number - 2}.png").unlink(missing_ok=True)
            except (InputError, OSError) as error:
                raise self.failure(f"the picture cannot be written: {error}") from error
            self._run([argument.replace("{file}", str(path)) for argument in self._command])

    def _run(self, arguments: list[str]) -> None:
        self._log.write(self.port, "note", f"run {arguments}")
        arguments[0] = program_path(arguments[0], self._folder) or arguments[0]
        with tempfile.TemporaryFile() as errors:
            try:
                nothing = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
                process = start_apart(arguments, cwd=self._folder, **nothing, stderr=errors)
            except OSError as error:
                raise self.failure(f"the command cannot be run: {error.strerror or error}") from error
            try:
                problem = self._await(process)
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
            if problem is not None:
                errors.seek(0)
                words = errors.read().decode("utf-8", "replace").strip()[-_MOST_STDERR:]
                raise self.failure(f"{problem}; " + (f"its errors: {words}" if words else "it printed no errors"))

    def _await(self, process: subprocess.Popen[bytes]) -> str | None:
        # what went wrong, if anything
        until = time.monotonic() + self.timeout_s
        while process.poll() is None:
            if self.lock.preempted:
                raise self.preempted()
            if time.monotonic() >= until:
                return f"the command did not end within {self.timeout_s:g} s (timeout_s) and was ended"
            with suppress(subprocess.TimeoutExpired):
                process.wait(_SLICE_S)
        return f"the command failed with exit status {process.returncode}" if process.returncode else None

    def close(self) -> None:
        self._pictures.cleanup()


class CommandController(ScreenController):
    """A display whose pictures a command of the user's shows, or a simulated screen at the port of the settings."""

    NAME = "command"

    @classmethod
    def open(cls, settings: LightSettings, log: SerialLog | None = None) -> LightController:
        if settings.port:
            return super().open(settings, log)
        return cls(CommandLink(settings, log), settings)

    def _show(self, levels: UInt8) -> None:
        if isinstance(self._link, CommandLink):
            self._link.show(levels)
        else:
            super()._show(levels)


def program_path(program: str, folder: Path) -> str | None:
    """Path of a program: relative to `folder` where it has a folder, else found as a shell would; None: none."""
    return which(program if Path(program).name == program else str((folder / program).resolve()))
