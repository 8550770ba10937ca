"""Capture an image set: plan, open set and devices in the order that keeps both safe, take what is missing."""

import os
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import IO

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float32
from lightopt.core.errors import HardwareError, InputError, Interrupted, LightoptError, counted
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.images import EVENTS_KEY, REPEATABILITY_KEY, make_folder
from lightopt.rig.capture._acquisition import AcquiredImage, AcquisitionEngine, Dark, ExposureImage
from lightopt.rig.capture._capture_plan import CaptureOptions, CapturePlan, make_plan
from lightopt.rig.capture._captured_set import BackgroundWriter, CapturedSet, open_set
from lightopt.rig.capture._connect import connect_devices
from lightopt.rig.capture._image_checks import ImageChecker, measure_repeatability
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._signals import EndSignals
from lightopt.scene import Scene, build_scene

DISK_WARNING_S = 1.0  # longest silent wait for the disk at the end [s]; then a warning is given


class CaptureSession:
    """Takes the missing images of a plan (`taken` so far), and reports what an interrupted run has on disk."""

    def __init__(self, plan: CapturePlan, scene: Scene, records: CapturedSet, run: RunContext) -> None:
        self._plan = plan
        self._scene = scene
        self._records = records
        self._run = run
        self._writer = BackgroundWriter()
        self._checker = ImageChecker(scene, check=plan.options.check, with_dark=plan.options.dark)
        missing = sum(len(records.missing(light, posture)) for posture in plan.postures for light in plan.lights)
        self._on_disk = len(plan.keys) - missing
        self._devices: Devices | None = None
        self._started: AcquisitionEngine | None = None
        self._in_doubt: tuple[Posture, Sequence[str]] | None = None
        self.taken = 0
        self.warnings: tuple[str, ...] = ()

    def __enter__(self) -> "CaptureSession":
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Finish writing, and report what an interrupted run has on disk; its devices are closed already."""
        stopped = isinstance(error, KeyboardInterrupt)
        signalled = self._finish(failed=error is not None, lights="all lights are off; " if stopped else "")
        if error is None and not signalled:
            return
        with suppress(LightoptError):  # the error that ends the run is reported, not a second one
            if self._in_doubt is not None:
                self._records.discard(*self._in_doubt)
            self._record_events()
        if (stopped or error is None) and self._devices is not None:
            raise Interrupted(f"all lights are off; {self._progress_text()}") from error

    @property
    def _engine(self) -> AcquisitionEngine:
        assert self._started is not None
        return self._started

    def _progress_text(self) -> str:
        there, planned = len(self._records.writer.manifest.images), len(self._plan.keys)
        on_disk = f"{there} of {counted(planned, 'image')} {'is' if planned == 1 else 'are'} on disk"
        if not self.todo():
            return f"{on_disk}; the set is complete"
        again = self._records.in_doubt
        some = f", which captures {again} of them again: no frame without light followed them" if again else ""
        return f"{on_disk}; continue with option 'resume'{some}"

    def warn(self, *texts: str) -> None:
        """Issue a warning once, and record it for the manifest."""
        for text in texts:
            if text not in self.warnings:
                self.warnings += (text,)
        self._run.warn(*texts)

    def todo(self) -> list[Posture]:
        records, darks = self._records, self._plan.dark_exposures
        lack_dark = {p for p in self._plan.postures for exposure in darks if not records.has_dark(p, exposure)}
        return [posture for posture in self._plan.postures if posture in lack_dark or records.todo(posture)]

    def execute(self, devices: Devices) -> None:
        self._devices = devices
        self._started = AcquisitionEngine(devices, self._plan, sensor=self._scene.sensor)
        if self._plan.home:
            self._report_progress("homing the stage")
            self._engine.home()
        # frames without light of a previous run
        for posture, exposure in product(self._plan.postures, self._plan.dark_exposures):
            wanted = not self._checker.has_dark_reference(exposure)
            if wanted and self._records.has_dark(posture, exposure):
                self._checker.set_dark_reference(self._records.read_dark(posture, exposure), exposure)
        for posture in self.todo():
            self._capture_posture(posture)
        if self._plan.options.check_repeatability:
            self._check_repeatability()
        devices.step = "checking and writing the last images"
        self._writer.wait()

    def _check_repeatability(self) -> None:
        """Take the first posture once more: a stage that lost steps since then shows another image."""
        light, posture, exposure = self._plan.keys[0]
        engine = self._engine
        engine.devices.step = "checking and writing the previous image"
        self._writer.wait()
        first = self._records.read_levels(light, posture, exposure)
        self._report_progress(f"returning to {posture}")
        engine.move(posture)
        engine.set_exposure(exposure)
        engine.light_on(light)
        acquired = self._expose(posture, exposure, light=light, rest=(exposure,))
        engine.light_off()
        engine.devices.step = f"comparing the images of {posture}"
        found = measure_repeatability(first, acquired.image.mean, light=light, posture=posture, scene=self._scene)
        prefix = f"repeated image at {posture}: "
        if found is None:
            self.warn(f"{prefix}{light} shows too little of the part to detect lost steps")
            return
        facts = {"light": light, "posture": posture.as_dict(), **found.as_dict()}
        self._records.writer.add_extra(REPEATABILITY_KEY, facts)
        if not found.converged:
            text = "the comparison with the first image did not converge, so lost steps would not be detected"
        elif found.deviation is not None:
            moved = f"the part has rotated since the first image, {found.deviation}, unnoticed by the stage"
            text = f"{moved}: it lost steps, or the part slipped; home the stage and capture again"
        elif found.unobservable:
            text = f"the images do not show whether the part's {found.unobservable} is unchanged"
        else:
            return
        self.warn(prefix + text)

    def flush(self) -> None:
        """Write warnings and events to the manifest."""
        try:
            self._record_events()
        except InputError as error:
            if self._devices is None:
                raise
            first, *others = error.messages
            raise HardwareError(f"while completing the manifest: {first}", *others, "all lights are off") from error

    def _record_events(self) -> None:
        """Write warnings, and irregularities on the links that are not in the entry of an image, to the manifest."""
        writer = self._records.writer
        writer.add_warnings(self.warnings)
        source = self._started.events_since if self._started else self._devices and self._devices.events
        if events := [asdict(event) for event in (source() if source else ())]:
            writer.add_extra(EVENTS_KEY, [*writer.manifest.extra.get(EVENTS_KEY, ()), *events])

    def _finish(self, *, failed: bool, lights: str) -> bool:
        """Finish writing, whatever happens, while signals are held back; returns whether one came."""
        with EndSignals() as signals, signals.shielded():
            if not self._writer.wait_idle(DISK_WARNING_S, failed=failed):
                self._run.warn(f"{lights}waiting until the disk has written the exposed images; Ctrl-C also waits")
            self._writer.close()
            if self._started is not None:
                self._started.close()
            self._checker.close()
        return signals.pending is not None

    def _capture_posture(self, posture: Posture) -> None:
        self._checker.predict(posture)
        self._report_progress(f"moving to {posture}")
        self._engine.move(posture)
        todo = self._records.todo(posture)
        incomplete = [light for light, missing in todo.items() if missing]
        if incomplete:
            self._writer.submit_image(self._records.discard, posture, incomplete)
        dark = self._capture_darks(posture)
        for light, missing in todo.items():
            self._capture_light(posture, light, missing, dark)
        if incomplete:
            elsewhere = f"the stage may have been elsewhere for images of {posture}: those captured in this run"
            with self._doubting(posture, incomplete, elsewhere):
                self._engine.confirm_stage()
        if self._plan.options.check and incomplete:
            acquired = self._expose(posture, self._plan.exposures[0])
            self._writer.submit_image(self._check_final_dark, acquired, incomplete)

    @contextmanager
    def _doubting(self, posture: Posture, lights: Sequence[str], images: str) -> Generator[None]:
        """Drop images of a posture where a check after them fails; the message names them."""
        try:
            yield
        except HardwareError as error:
            self._in_doubt = (posture, lights)
            again = f"{images} were not kept; option 'resume' captures them again"
            raise HardwareError(*error.messages, again) from error

    def _capture_darks(self, posture: Posture) -> Dark:
        dark: dict[float, Float32] = {}
        for exposure in self._plan.dark_exposures:
            # of several frames only the rounded mean is on disk
            if self._records.has_dark(posture, exposure) and self._plan.options.average == 1:
                dark[exposure] = self._records.read_dark(posture, exposure)
            else:
                self._writer.submit_image(self._add_dark, self._expose(posture, exposure), dark)
        for exposure in self._plan.exposures if self._plan.needs_dark_reference else ():
            if not self._checker.has_dark_reference(exposure):
                self._writer.submit_image(self._checker.check_dark, self._expose(posture, exposure), self.warn)
        return dark

    def _capture_light(self, posture: Posture, light: str, missing: Sequence[float], dark: Dark) -> None:
        engine = self._engine
        captured: dict[float, ExposureImage] = {}
        if missing:
            engine.set_exposure(missing[0])
            engine.light_on(light)
        for i, exposure in enumerate(missing):
            acquired = self._expose(posture, exposure, light=light, rest=missing[i:])
            if exposure == missing[-1]:
                engine.light_off()  # before anything is done with the frames
            self._writer.submit_image(self._add, acquired, dark, captured)
            self.taken += 1
        engine.devices.step = "checking and writing the previous images"
        self._writer.submit_linear(self._records.add_linear, light, posture, captured, dark)

    def _add(self, acquired: AcquiredImage, dark: Dark, captured: dict[float, ExposureImage]) -> None:
        """Check that the image is lit by its light, as those of its other exposures were, and write it."""
        acquired.facts["lit"] = self._checker.check(acquired, dark, captured, self.warn)
        self._records.add(acquired)
        captured[acquired.exposure] = acquired.image

    def _add_dark(self, acquired: AcquiredImage, dark: dict[float, Float32]) -> None:
        self._checker.check_dark(acquired, self.warn)
        self._records.add_dark(acquired)
        dark[acquired.exposure] = acquired.image.mean

    def _check_final_dark(self, acquired: AcquiredImage, lights: Sequence[str]) -> None:
        """Check that no light stayed on; otherwise the images of the posture are dropped."""
        on = f"the light may have been on during images of {acquired.posture} as well"
        with self._doubting(acquired.posture, lights, f"{on}: those captured since the previous frame without light"):
            self._checker.check_dark(acquired, self.warn)
        self._records.record_dark_check(acquired.posture)

    def _expose(
        self, posture: Posture, exposure: float, *, light: str | None = None, rest: Sequence[float] = ()
    ) -> AcquiredImage:
        """Take an image once all has settled and the previous one is on disk; a light that waits long goes dark."""
        engine = self._engine
        self._report_progress(f"{light or 'dark'} {posture} exposure {exposure:g}")
        engine.set_exposure(exposure)
        engine.settle()
        engine.devices.step = "checking and writing the previous image"
        if light is None:
            self._writer.wait_for_image()
        elif not self._writer.wait_for_image(engine.max_wait_s(rest)):
            engine.light_off()
            engine.devices.step = "checking and writing the previous image"
            self._writer.wait_for_image()
            engine.light_on(light)
            engine.settle()
        return engine.expose(posture, exposure)

    def _report_progress(self, what: str) -> None:
        self._run.stage(what)((self._on_disk + self.taken) / len(self._plan.keys))


Connect = Callable[[CapturePlan], Devices]  # opens the devices of a plan
LOCK_NAME = ".capture.lock"
_FAR = 1 << 20  # Windows keeps others from reading what is locked, so that a byte behind the text is


@dataclass(frozen=True, kw_only=True)
class CaptureResult:
    folder: Path
    images: int  # of the plan
    taken: int  # by this run; the others existed before
    replaced: int  # files of another set that were removed
    retries: int  # commands that were sent again
    virtual_bench: bool  # whether the rig has no hardware section, so that all devices were simulated
    seconds: float
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
    folder, begun = Path(folder), time.monotonic()
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
            form = "{} × {} pixels of {} bits"
            expected = form.format(*rig.camera.resolution_px, rig.camera.sensor.bit_depth)
            found = form.format(*devices.camera.resolution_px, devices.camera.bit_depth)
            if found != expected:  # nothing is lit or moved yet
                raise InputError(f"{rig.source.at('camera')}: the rig has {expected}, the camera delivers {found}")
            return devices

        # a set that is there is removed only once the devices that are to replace it are open and dark
        devices = open_devices() if force else None
        records = open_set(folder, rig, part, scene, plan, resume=resume, force=force)
        session = finishing.enter_context(CaptureSession(plan, scene, records, run))
        session.warn(*scene.warnings)
        if devices is None and session.todo():
            devices = open_devices()
        if devices is not None:
            session.execute(devices)
            safe.close()
        session.flush()
    return CaptureResult(
        folder=folder,
        images=len(plan.keys),
        taken=session.taken,
        replaced=records.writer.replaced,
        retries=0 if devices is None else devices.retries,
        virtual_bench=not plan.wiring.given,
        seconds=time.monotonic() - begun,
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
        why = error.strerror or error
        raise InputError(f"{path.parent}: cannot be written: {why}; choose another output folder") from error
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
        other = f"another capture writes into this folder{f' (process {owner})' if owner else ''}"
        raise InputError(f"{path.parent}: {other}; wait for it to end, or choose another output folder") from error
    return file
