"""Capturing: executes a plan and puts each image on disk and into the manifest before the next is exposed."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.capture._connect import connect_devices
from lightopt.capture._devices import Devices, check_camera
from lightopt.capture._frames import Exposed
from lightopt.capture._judge import Judge
from lightopt.capture._lock import locked
from lightopt.capture._options import CaptureOptions
from lightopt.capture._plan import Plan, PostureTask, make_plan
from lightopt.capture._records import CapturedSet, open_set
from lightopt.capture._shoot import Shooter, Shot
from lightopt.capture._timing import Timing
from lightopt.config import PartConfig, RigConfig
from lightopt.errors import LightoptError, counted
from lightopt.scene import Scene, build_scene
from lightopt.transforms import Posture

__all__ = ["CaptureReport", "Captured", "Connect", "capture"]

Dark = dict[float, NDArray[np.float32]]
"""Frames without light of a posture by relative exposure."""

CaptureReport = Callable[[str, float], None]
"""Called with what is being done and the share of the images that is there (0 to 1)."""

Connect = Callable[[Plan], Devices]
"""Opens the devices of a plan."""


@dataclass(frozen=True, kw_only=True)
class Captured:
    """What a capture did.

    Attributes
    ----------
    folder
        The image set.
    images
        Number of images of the plan.
    taken
        Number of those taken now; the others were there.
    replaced
        Files of another set that were removed.
    retries
        Commands that were sent again.
    timing
        Where the time went.
    warnings
        What was noticed, also in the manifest.
    """

    folder: Path
    images: int
    taken: int
    replaced: int
    retries: int
    timing: Timing
    warnings: tuple[str, ...]


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
    warn: Callable[[str], None] | None = None,
    report: CaptureReport | None = None,
) -> Captured:
    """Capture an image set: every light in every posture at every exposure.

    Parameters
    ----------
    rig, part
        The rig and the part on it.
    folder
        Of the image set; made where it does not exist.
    options
        Which images.
    resume
        Continue the set that is there: only what is missing is taken.
    force
        Replace the set that is there.
    connect
        Opens the devices; those of the rig's file if not given.
    serial_log
        File that gets every byte on the wires with its time.
    warn, report
        Called with warnings and with progress.

    Raises
    ------
    InputError
        When the plan cannot be, the folder holds something else, or the disk refuses; before anything is opened
        wherever that can be known.
    HardwareError
        When a device fails or an image is not lit by its light; the message says in which step and what state things
        are in. The lights are off then, or it says which may not be.
    """
    folder, timing, begun = Path(folder), Timing(), time.monotonic()
    with timing.spent("opening_s"):
        plan = make_plan(rig, part, options)
        scene = build_scene(rig, part, postures=[task.posture for task in plan.tasks])
    # the devices are made safe first, then what is still being written is finished
    with locked(folder), ExitStack() as after, ExitStack() as safe:

        def begin() -> _Run:
            records = open_set(folder, rig, part, scene, plan, resume=resume, force=force)
            return after.enter_context(_Run(plan, scene, records, timing, warn, report))

        def open_devices() -> Devices:
            devices = safe.enter_context((connect or _connecting(rig, part, serial_log))(plan))
            check_camera(
                devices,
                resolution_px=rig.camera.resolution_px,
                bit_depth=scene.sensor.bit_depth,
                where=rig.source.at("camera"),
            )
            return devices

        with timing.spent("opening_s"):
            # a set that is there is removed only once the devices that are to replace it are open and dark
            devices = open_devices() if force else None
            run = begin()
            run.warn(*scene.warnings)
            if devices is None and run.todo():
                devices = open_devices()
        if devices is not None:
            run.execute(devices)
            with timing.spent("closing_s"):
                safe.close()
        run.flush()
    timing.whole_s = time.monotonic() - begun
    return Captured(
        folder=folder,
        images=len(plan.keys),
        taken=run.taken,
        replaced=run.replaced,
        retries=0 if devices is None else devices.retries,
        timing=timing,
        warnings=run.warnings,
    )


def _connecting(rig: RigConfig, part: PartConfig, serial_log: Path | None) -> Connect:
    return lambda plan: connect_devices(rig, plan.wiring, part=part, plan=plan, serial_log=serial_log)


class _Run:
    """A plan on its way to disk.

    One worker checks and writes images, one merges and writes linear ones, while the stage moves and lights settle. An
    exposure waits for the image before it, not for linear ones, which can be made from the images at any time.
    """

    def __init__(
        self,
        plan: Plan,
        scene: Scene,
        records: CapturedSet,
        timing: Timing,
        warn: Callable[[str], None] | None,
        report: CaptureReport | None,
    ) -> None:
        self._plan = plan
        self._records = records
        self._timing = timing
        self._warn = warn
        self._report = report
        self._disk = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._linear = ThreadPoolExecutor(1, thread_name_prefix="linear")
        self._writing: list[Future[Any]] = []
        self._last_image: Future[Any] | None = None
        self._judge = Judge(scene, check=plan.options.check, with_dark=plan.options.dark)
        self._there = len(plan.keys) - sum(
            len(records.missing(light, task.posture)) for task in plan.tasks for light in task.lights
        )
        self._devices: Devices | None = None
        self._shooter: Shooter | None = None
        self.taken = 0
        self.warnings: tuple[str, ...] = ()

    def __enter__(self) -> _Run:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish what is being written, and say where an interrupted run stands; its devices are closed already."""
        del kind, trace
        self.finish()
        if error is None:
            return
        with contextlib.suppress(LightoptError):  # the error that ends the run is told, not a second one
            self._note_events()
        if isinstance(error, KeyboardInterrupt) and self._devices is not None:
            there = len(self._records.writer.manifest.images)
            raise KeyboardInterrupt(
                f"all lights are off; {there} of {counted(len(self._plan.keys), 'image')} are on disk; "
                "go on with --resume"
            ) from error

    @property
    def replaced(self) -> int:
        """Files of another set that were removed."""
        return self._records.writer.replaced

    def warn(self, *texts: str) -> None:
        """Say something once, and note it for the manifest."""
        for text in texts:
            if text not in self.warnings:
                self.warnings += (text,)
                if self._warn is not None:
                    self._warn(text)

    def todo(self) -> tuple[PostureTask, ...]:
        """Postures in which something is missing."""
        return tuple(
            task
            for task in self._plan.tasks
            if self._records.todo(task)
            or any(not self._records.dark_kept(task.posture, e) for e in task.dark_exposures)
        )

    def execute(self, devices: Devices) -> None:
        """Take all that is missing."""
        self._devices = devices
        devices.step = "asking the devices who they are"
        with self._timing.spent("opening_s"):
            shooter = self._shooter = Shooter(
                devices,
                self._plan,
                sensor=self._judge.sensor,
                identities=devices.identities(),
                timing=self._timing,
            )
        if self._plan.home:
            self._tell("homing the stage")
            shooter.home()
        for task in self.todo():
            self._posture(devices, shooter, task)
        devices.step = "checking and writing the last images"
        self._wait(self._writing)

    def flush(self) -> None:
        """Put what was noticed into the manifest."""
        self._records.writer.add_warnings(self.warnings)
        self._note_events()
        self.finish()

    def _note_events(self) -> None:
        """Put what was out of the ordinary on the links, and is not in the entry of an image, into the manifest."""
        events = (
            self._shooter.events_since() if self._shooter else self._devices.events() if self._devices else ()
        )
        self._records.note_events([event.as_dict() for event in events])

    def finish(self) -> None:
        """Let what is being written be finished, whatever else happened."""
        self._disk.shutdown(wait=True)
        self._linear.shutdown(wait=True)
        self._judge.close()

    def _posture(self, devices: Devices, shooter: Shooter, task: PostureTask) -> None:
        self._judge.begin(task.posture)
        self._tell(f"moving to {task.posture}")
        shooter.move(task.posture)
        dark = self._dark(devices, shooter, task)
        for light in self._records.todo(task):
            self._light(devices, shooter, task, light, dark)
        if self._plan.options.check:
            exposure = self._plan.exposures[0]
            shot = self._expose(devices, shooter, task, None, exposure)
            self._write(self._judge.dark, shot, exposure, self.warn)

    def _dark(self, devices: Devices, shooter: Shooter, task: PostureTask) -> Dark:
        dark: Dark = {}
        for exposure in task.dark_exposures:
            if not self._records.dark_missing(task.posture, exposure):
                dark[exposure] = self._records.dark_there(task.posture, exposure)
                continue
            shot = self._expose(devices, shooter, task, None, exposure)
            self._write(self._keep_dark, task.posture, exposure, shot)
            dark[exposure] = shot.image.mean
        for exposure in self._plan.exposures if self._plan.reference else ():
            if not self._judge.has_reference(exposure):
                self._write(
                    self._judge.dark,
                    self._expose(devices, shooter, task, None, exposure),
                    exposure,
                    self.warn,
                )
        return dark

    def _light(self, devices: Devices, shooter: Shooter, task: PostureTask, light: str, dark: Dark) -> None:
        missing = self._records.missing(light, task.posture)
        taken: dict[float, Exposed] = {}
        if missing:
            shooter.set_exposure(missing[0])
            shooter.light_on(light)
        for exposure in missing:
            shot = self._expose(devices, shooter, task, light, exposure)
            if exposure == missing[-1]:
                shooter.light_off()
            self._write(self._keep, light, task.posture, exposure, shot, dark, dict(taken))
            taken[exposure] = shot.image
            self.taken += 1
        self._writing.append(
            self._linear.submit(self._merge, self._last_image, light, task.posture, taken, dark)
        )

    def _keep(
        self,
        light: str,
        posture: Posture,
        exposure: float,
        shot: Shot,
        dark: Dark,
        others: dict[float, Exposed],
    ) -> None:
        """Check that the image is lit by its light, as those of its other exposures were, and put it on disk."""
        shot.facts["lit"] = self._judge.judge(light, posture, exposure, shot, dark, others, self.warn)
        self._records.add(light, posture, exposure, shot)

    def _keep_dark(self, posture: Posture, exposure: float, shot: Shot) -> None:
        """Check that no light burns, and put the frame on disk."""
        self._judge.dark(shot, exposure, self.warn)
        self._records.add_dark(posture, exposure, shot)

    def _merge(
        self, last: Future[Any] | None, light: str, posture: Posture, taken: dict[float, Exposed], dark: Dark
    ) -> None:
        """Put the linear image on disk, once all its exposures are there."""
        if last is not None:
            last.result()
        self._records.add_linear(light, posture, taken, dark)

    def _expose(
        self, devices: Devices, shooter: Shooter, task: PostureTask, light: str | None, exposure: float
    ) -> Shot:
        self._tell(f"{light or 'dark'} {task.posture} exposure {exposure:g}")
        shooter.set_exposure(exposure)
        shooter.settle()
        if self._last_image is not None:
            devices.step = "checking and writing the image before"
            self._wait([self._last_image])
        return shooter.expose(task.posture, exposure)

    def _write(self, write: Callable[..., None], *arguments: object) -> None:
        self._last_image = self._disk.submit(write, *arguments)
        self._writing.append(self._last_image)

    def _wait(self, futures: list[Future[Any]]) -> None:
        with self._timing.spent("writing_s"):
            for future in futures:
                future.result()
        self._writing = [future for future in self._writing if not future.done() or future.exception()]

    def _tell(self, what: str) -> None:
        if self._report is not None:
            self._report(what, (self._there + self.taken) / len(self._plan.keys))
