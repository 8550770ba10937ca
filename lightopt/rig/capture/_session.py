"""Taking the images of a plan: the order of things between the devices and the disk."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import HardwareError, InputError, Interrupted, LightoptError, counted
from lightopt.core.transforms import Posture
from lightopt.rig.capture._acquisition import Shooter, Shot
from lightopt.rig.capture._background_writer import DiskWork
from lightopt.rig.capture._devices import Devices
from lightopt.rig.capture._exposures import Exposed
from lightopt.rig.capture._image_checks import Judge
from lightopt.rig.capture._image_records import CapturedSet
from lightopt.rig.capture._plan import Plan, PostureTask
from lightopt.rig.capture._repeatability import came_back
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._timing import Timing
from lightopt.scene import Scene

SILENT_S = 1.0
"""The disk is waited for so long at the end before a word is said of it."""

Dark = dict[float, NDArray[np.float32]]
"""Frames without light of a posture by relative exposure."""

CaptureReport = Callable[[str, float], None]
"""Called with what is being done and the share of the images that is there (0 to 1)."""


class Taking:
    """Takes the missing images of a plan, and reports where an interrupted run stands.

    `taken` is the number of images taken so far, `warnings` what was noticed so far.
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
        self._scene = scene
        self._records = records
        self._timing = timing
        self._warn = warn
        self._report = report
        self._disk = DiskWork(timing)
        self._judge = Judge(scene, check=plan.options.check, with_dark=plan.options.dark)
        self._there = len(plan.keys) - sum(
            len(records.missing(light, task.posture)) for task in plan.tasks for light in task.lights
        )
        self._devices: Devices | None = None
        self._shooter: Shooter | None = None
        self._in_doubt: tuple[Posture, Sequence[str]] | None = None
        self.taken = 0
        self.warnings: tuple[str, ...] = ()

    def __enter__(self) -> Taking:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish what is being written, and say where an interrupted run stands; its devices are closed already."""
        del kind, trace
        stopped = isinstance(error, KeyboardInterrupt)
        signalled = self._finish(failed=error is not None, lights="all lights are off; " if stopped else "")
        if error is None and not signalled:
            return
        with contextlib.suppress(LightoptError):  # the error that ends the run is told, not a second one
            if self._in_doubt is not None:
                self._records.forget(*self._in_doubt)
            self._records.writer.add_warnings(self.warnings)
            self._note_events()
        if (stopped or error is None) and self._devices is not None:
            raise Interrupted(f"all lights are off; {self._standing()}") from error

    def _standing(self) -> str:
        """What is on disk and how to go on, in words."""
        there, planned = len(self._records.writer.manifest.images), len(self._plan.keys)
        on_disk = f"{there} of {counted(planned, 'image')} {'is' if planned == 1 else 'are'} on disk"
        if not self.todo():
            return f"{on_disk}; the set is complete"
        again = self._records.in_doubt
        if not again:
            return f"{on_disk}; go on with --resume"
        return (
            f"{on_disk}; go on with --resume, which takes {again} of them anew, because no frame without light "
            "followed them"
        )

    @property
    def replaced(self) -> int:
        """Files of another set that were removed."""
        return self._records.writer.replaced

    def warn(self, *texts: str) -> None:
        """Issue a warning once, and keep it for the manifest."""
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
        self._refer_to_darks()
        for task in self.todo():
            self._posture(devices, shooter, task)
        if self._plan.options.come_back:
            self._come_back(devices, shooter)
        devices.step = "checking and writing the last images"
        self._disk.wait()

    def _come_back(self, devices: Devices, shooter: Shooter) -> None:
        """Take the first posture once more: a stage that lost steps since then shows another image."""
        task, exposure = self._plan.tasks[0], self._plan.exposures[0]
        light, posture = task.lights[0], task.posture
        devices.step = "checking and writing the image before"
        self._disk.wait()
        first = self._records.levels_there(light, posture, exposure)
        self._tell(f"coming back to {posture}")
        shooter.move(posture)
        shooter.set_exposure(exposure)
        shooter.light_on(light)
        shot = self._expose(devices, shooter, task, exposure, light=light, rest=(exposure,))
        shooter.light_off()
        devices.step = f"comparing the images of {posture}"
        found = came_back(first, shot.image.mean, light=light, posture=posture, scene=self._scene)
        told = f"came back to {posture}: "
        if found is None:
            self.warn(f"{told}{light} shows too little of the part to tell whether the stage lost steps")
            return
        self._records.note_came_back({"light": light, "posture": posture.as_dict(), **found.as_dict()})
        if not found.converged:
            self.warn(
                f"{told}the comparison of its two images did not converge: nothing tells whether steps were lost"
            )
        elif found.off is not None:
            self.warn(
                f"{told}the part has turned since the first image there, {found.off}, and the stage does not know: "
                "it lost steps, or the part slipped; home the stage and capture again"
            )
        elif found.unseen:
            self.warn(f"{told}images cannot tell whether its {found.unseen} is what it was")

    def flush(self) -> None:
        """Write warnings and events to the manifest."""
        try:
            self._records.writer.add_warnings(self.warnings)
            self._note_events()
        except InputError as error:
            if self._devices is None:
                raise
            first, *others = error.messages
            raise HardwareError(
                f"while completing the manifest: {first}", *others, "all lights are off"
            ) from error

    def _note_events(self) -> None:
        """Write irregularities on the links that are not in the entry of an image to the manifest."""
        events = (
            self._shooter.events_since() if self._shooter else self._devices.events() if self._devices else ()
        )
        self._records.note_events([event.as_dict() for event in events])

    def _finish(self, *, failed: bool, lights: str) -> bool:
        """Let what is being written be finished, whatever happens; whether a signal came meanwhile.

        Signals are held back: what writes into the folder must have ended before another capture may.
        """
        signals = EndSignals()
        signals.install()
        try:
            with signals.shielded():
                if failed:
                    self._disk.give_up_linears()
                if not self._disk.idle(SILENT_S) and self._warn is not None:
                    self._warn(
                        f"{lights}waiting for the disk to take what was exposed; Ctrl-C waits for it, too"
                    )
                self._disk.close()
                if self._shooter is not None:
                    self._shooter.close()
                self._judge.close()
        finally:
            signals.restore()
        return signals.pending is not None

    def _posture(self, devices: Devices, shooter: Shooter, task: PostureTask) -> None:
        self._judge.begin(task.posture)
        self._tell(f"moving to {task.posture}")
        shooter.move(task.posture)
        todo = self._records.todo(task)
        anew = [light for light, missing in todo.items() if missing]
        if anew:
            self._disk.image(self._records.forget, task.posture, anew)
        dark = self._dark(devices, shooter, task)
        for light, missing in todo.items():
            self._light(devices, shooter, task, light, missing, dark)
        if anew:
            self._confirm_stage(shooter, task.posture, anew)
        if self._plan.options.check and anew:
            exposure = self._plan.exposures[0]
            shot = self._expose(devices, shooter, task, exposure)
            self._disk.image(self._end_dark, task.posture, anew, exposure, shot)

    def _confirm_stage(self, shooter: Shooter, posture: Posture, lights: Sequence[str]) -> None:
        """Check that the stage stood still for the images of a posture; without that they do not count."""
        try:
            shooter.confirm_stage()
        except HardwareError as error:
            self._in_doubt = (posture, lights)
            raise HardwareError(
                *error.messages,
                f"it may have stood elsewhere for images of {posture}: those taken in this run were not kept; "
                "--resume takes them anew",
            ) from error

    def _refer_to_darks(self) -> None:
        """Let frames without light be compared with those that an earlier run kept."""
        for task in self._plan.tasks:
            for exposure in task.dark_exposures:
                if not self._judge.has_reference(exposure) and self._records.dark_kept(
                    task.posture, exposure
                ):
                    self._judge.refer(self._records.dark_there(task.posture, exposure), exposure)

    def _dark(self, devices: Devices, shooter: Shooter, task: PostureTask) -> Dark:
        dark: Dark = {}
        for exposure in task.dark_exposures:
            if not self._records.dark_missing(task.posture, exposure):
                dark[exposure] = self._records.dark_there(task.posture, exposure)
                continue
            shot = self._expose(devices, shooter, task, exposure)
            self._disk.image(self._keep_dark, task.posture, exposure, shot, dark)
        for exposure in self._plan.exposures if self._plan.reference else ():
            if not self._judge.has_reference(exposure):
                shot = self._expose(devices, shooter, task, exposure)
                self._disk.image(self._judge.dark, shot, task.posture, exposure, self.warn)
        return dark

    def _light(
        self,
        devices: Devices,
        shooter: Shooter,
        task: PostureTask,
        light: str,
        missing: Sequence[float],
        dark: Dark,
    ) -> None:
        taken: dict[float, Exposed] = {}
        if missing:
            shooter.set_exposure(missing[0])
            shooter.light_on(light)
        for i, exposure in enumerate(missing):
            shot = self._expose(devices, shooter, task, exposure, light=light, rest=missing[i:])
            if exposure == missing[-1]:
                shooter.light_off()  # before anything is done with the frames
            self._disk.image(self._keep, light, task.posture, exposure, shot, dark, taken)
            self.taken += 1
        devices.step = "checking and writing the images before"
        self._disk.linear(self._records.add_linear, light, task.posture, taken, dark)

    def _keep(
        self,
        light: str,
        posture: Posture,
        exposure: float,
        shot: Shot,
        dark: Dark,
        taken: dict[float, Exposed],
    ) -> None:
        """Check that the image is lit by its light, as those of its other exposures were, and put it on disk."""
        shot.facts["lit"] = self._judge.judge(light, posture, exposure, shot, dark, taken, self.warn)
        self._records.add(light, posture, exposure, shot)
        taken[exposure] = shot.image

    def _keep_dark(self, posture: Posture, exposure: float, shot: Shot, dark: Dark) -> None:
        """Check that no light burns, and put the frame on disk."""
        self._judge.dark(shot, posture, exposure, self.warn)
        self._records.add_dark(posture, exposure, shot)
        dark[exposure] = shot.image.mean

    def _end_dark(self, posture: Posture, lights: Sequence[str], exposure: float, shot: Shot) -> None:
        """Check that no light stayed on; only then do the images of the posture count."""
        try:
            self._judge.dark(shot, posture, exposure, self.warn)
        except HardwareError as error:
            self._in_doubt = (posture, lights)
            raise HardwareError(
                *error.messages,
                f"it may have burned during images of {posture} as well: those taken since the frame without light "
                "before were not kept; --resume takes them anew",
            ) from error
        self._records.end_dark(posture)

    def _expose(
        self,
        devices: Devices,
        shooter: Shooter,
        task: PostureTask,
        exposure: float,
        *,
        light: str | None = None,
        rest: Sequence[float] = (),
    ) -> Shot:
        """Take an image once everything has settled and the image before it is on disk.

        A light that is on waits for the disk no longer than lighting it anew would take, nor longer than it may be on:
        then it goes dark until the image is there. `rest` are the exposures that it is still needed for.
        """
        self._tell(f"{light or 'dark'} {task.posture} exposure {exposure:g}")
        shooter.set_exposure(exposure)
        shooter.settle()
        devices.step = "checking and writing the image before"
        if light is None:
            self._disk.wait_for_image()
        elif not self._disk.wait_for_image(shooter.patience_s(rest)):
            shooter.light_off()
            devices.step = "checking and writing the image before"
            self._disk.wait_for_image()
            shooter.light_on(light)
            shooter.settle(counted="writing_s")
        return shooter.expose(task.posture, exposure)

    def _tell(self, what: str) -> None:
        if self._report is not None:
            self._report(what, (self._there + self.taken) / len(self._plan.keys))
