"""Capture an image set: plan, open set and devices in the order that keeps both safe, take what is missing."""

import os
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.images import make_folder
from lightopt.rig.capture._acquisition import Timing
from lightopt.rig.capture._capture_plan import CaptureOptions, CapturePlan, make_plan
from lightopt.rig.capture._captured_set import open_set
from lightopt.rig.capture._connect import connect_devices
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._session import CaptureSession
from lightopt.scene import build_scene

Connect = Callable[[CapturePlan], Devices]  # opens the devices of a plan

LOCK_NAME = ".capture.lock"

_FAR = 1 << 20  # Windows keeps others from reading what is locked, so that a byte behind the text is


@dataclass(frozen=True, kw_only=True)
class CaptureResult:
    """Result of a capture."""

    folder: Path
    images: int  # of the plan
    taken: int  # by this run; the others existed before
    replaced: int  # files of another set that were removed
    retries: int  # commands that were sent again
    virtual_bench: bool  # whether the rig has no hardware section, so that all devices were simulated
    timing: Timing
    warnings: tuple[str, ...]  # also in the manifest


def capture(
    rig: RigConfig,
    part: PartConfig,
    folder: Path,
    *,
    options: CaptureOptions | None = None,
    resume: bool = False,
    force: bool = False,
    connect: Connect | None = None,
    serial_log: Path | None = None,
    run: RunContext | None = None,
) -> CaptureResult:
    """Capture an image set: every light in every posture at every exposure.

    resume: Continue the set that is there: only what is missing is taken.
    force: Replace the set that is there.
    connect: Opens the devices; by default those of the rig file.
    serial_log: File that gets every byte on the wires with its time.
    run: Gets warnings, also of irregularities on the wires, and for each step the share of images on disk.
    Raises InputError: The plan is impossible, the folder holds something else, or the disk refuses; before anything is
        opened wherever that can be known.
    Raises HardwareError: A device fails or an image is not lit by its light; the message names the step and the state
        of the devices. The lights are off then, or those that may not be are named.
    Raises Interrupted: After Ctrl-C and the signals that end a program, once the lights are off; the message says what
        is on disk.
    """
    run = run or RunContext()
    folder, timing, begun = Path(folder), Timing(), time.monotonic()
    with timing.spent("opening_s"):
        plan = make_plan(rig, part, options)
        scene = build_scene(rig, part, postures=plan.postures, defects=False)
    # on the way out the devices are made safe first, then pending images are written
    with lock_folder(folder), ExitStack() as finishing, ExitStack() as safe:

        def open_devices() -> Devices:
            if connect is not None:
                opened = connect(plan)
            else:
                opened = connect_devices(rig, plan.wiring, part=part, plan=plan, serial_log=serial_log, run=run)
            devices = safe.enter_context(opened)
            camera, (width, height), bits = devices.camera, rig.camera.resolution_px, rig.camera.sensor.bit_depth
            if camera.resolution_px != (width, height) or camera.bit_depth != bits:  # nothing is lit or moved yet
                raise InputError(
                    f"{rig.source.at('camera')}: the rig has {width} × {height} pixels of {bits} bits, the camera "
                    f"delivers {camera.resolution_px[0]} × {camera.resolution_px[1]} of {camera.bit_depth}; set the "
                    "camera or the rig"
                )
            return devices

        with timing.spent("opening_s"):
            # a set that is there is removed only once the devices that are to replace it are open and dark
            devices = open_devices() if force else None
            records = open_set(folder, rig, part, scene, plan, resume=resume, force=force)
            session = finishing.enter_context(CaptureSession(plan, scene, records, timing, run))
            session.warn(*scene.warnings)
            if devices is None and session.todo():
                devices = open_devices()
        if devices is not None:
            session.execute(devices)
            with timing.spent("closing_s"):
                safe.close()
        session.flush()
    timing.whole_s = time.monotonic() - begun
    return CaptureResult(
        folder=folder,
        images=len(plan.keys),
        taken=session.taken,
        replaced=records.writer.replaced,
        retries=0 if devices is None else devices.retries,
        virtual_bench=not plan.wiring.given,
        timing=timing,
        warnings=session.warnings,
    )


@contextmanager
def lock_folder(folder: Path) -> Generator[None]:
    """Keep other captures out of a folder, which is created if it does not exist.

    The operating system holds the lock: that of a killed process is gone, even if its file still exists.
    InputError when another process captures into the folder, or it cannot be written.
    """
    path = folder / LOCK_NAME
    while True:
        file = _open_locked(path)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # its previous owner has just removed it
    try:
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
    finally:
        if sys.platform != "win32":  # which removes no open file
            with suppress(OSError):
                path.unlink()
        file.close()


def _open_locked(path: Path) -> IO[str]:
    make_folder(path.parent)
    try:
        file = path.open("a+", encoding="ascii")
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot be written: {error.strerror or error}; choose another output folder"
        ) from error
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(_FAR)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.seek(0)
        owner = file.read(20).strip()
        file.close()
        raise InputError(
            f"{path.parent}: another capture writes into this folder{f' (process {owner})' if owner else ''}; wait for "
            "it to end, or choose another output folder"
        ) from error
    return file
