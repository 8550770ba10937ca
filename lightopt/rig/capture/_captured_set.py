"""The captured image set on disk: which images exist, which are missing, and how they are written in background."""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt import images
from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float32
from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.rendering import set_manifest
from lightopt.rig.capture._acquisition import AcquiredImage, ExposureImage, FrameMean, merge_exposures
from lightopt.rig.capture._capture_plan import CapturePlan
from lightopt.scene import Scene, build_scene


def open_set(
    folder: Path, rig: RigConfig, part: PartConfig, scene: Scene, plan: CapturePlan, *, resume: bool, force: bool
) -> "CapturedSet":
    """Begin a captured set or continue one; InputError for another set, or without `resume` or `force`."""
    _refuse_set(folder, resume=resume, force=force)
    header = set_manifest("captured", rig, part, scene, options=plan.as_dict())
    if not (resume or force) and _lists_nothing(folder):
        try:  # of this plan: a killed run may have left a file that it did not list
            images.resumable_manifest(folder, header)
        except InputError:
            images.remove_file(folder / images.MANIFEST_NAME)
    return CapturedSet(images.ImageSetWriter(folder, header, force=force, plan=plan.keys), scene, plan)


def check_folder(
    folder: Path, rig: RigConfig, part: PartConfig, plan: CapturePlan, *, resume: bool, force: bool
) -> None:
    """Check whether a set could be begun or continued in a folder; errors as :func:`open_set`."""
    if folder.exists() and not folder.is_dir():
        images.make_folder(folder)  # raises with the reason
    _refuse_set(folder, resume=resume, force=force)
    if resume and (folder / images.MANIFEST_NAME).exists():
        scene = build_scene(rig, part, postures=plan.postures, defects=False)
        images.resumable_manifest(folder, set_manifest("captured", rig, part, scene, options=plan.as_dict()))


def _refuse_set(folder: Path, *, resume: bool, force: bool) -> None:
    if (folder / images.MANIFEST_NAME).exists() and not (resume or force or _lists_nothing(folder)):
        advice = "use option 'resume' to complete it, option 'force' to replace it, or choose another output folder"
        raise InputError(f"{folder}: holds an image set; {advice}")


def _lists_nothing(folder: Path) -> bool:
    """Whether a capture was begun in a folder and ended before its first image."""
    try:
        manifest = images.read_manifest(folder / images.MANIFEST_NAME)
    except InputError:
        return False
    return manifest.kind == "captured" and not (manifest.images or manifest.files)


class CapturedSet:
    """The image set of a plan, partly on disk."""

    def __init__(self, writer: images.ImageSetWriter, scene: Scene, plan: CapturePlan) -> None:
        self.writer = writer
        self._scene = scene
        self._plan = plan
        angles = ((light.name, np.degrees((light.elevation, light.azimuth)).tolist()) for light in scene.lights)
        self._angles = {name: (round(elevation, 9), round(azimuth, 9)) for name, (elevation, azimuth) in angles}

    def missing(self, light: str, posture: Posture) -> tuple[float, ...]:
        """Exposures to take: all of them where one is missing, because the brightness of the lamp may have changed.

        The images of a posture count once a frame at its end has shown that no light stayed on. Means of frames are
        not on disk, only rounded, so that no linear image is made of them.
        """
        exposures = self._plan.exposures_of[light]
        if self._plan.options.check and not self.dark_checked(posture):
            return exposures
        if not all(self.writer.done(light, posture, exposure) for exposure in exposures):
            return exposures
        lacks_means = self._plan.options.average > 1 and not self.writer.linear_done(light, posture)
        return exposures if lacks_means else ()

    def todo(self, posture: Posture) -> dict[str, tuple[float, ...]]:
        """Incomplete lights of a posture, each with its exposures to take: none if only the linear image is missing."""
        missing = {light: self.missing(light, posture) for light in self._plan.lights}
        return {light: some for light, some in missing.items() if some or not self.writer.linear_done(light, posture)}

    def dark_checked(self, posture: Posture) -> bool:
        return posture.as_dict() in self._dark_checks

    def record_dark_check(self, posture: Posture) -> None:
        """Record that a frame after the images of a posture showed that no light stayed on."""
        self.writer.add_extra(images.DARK_CHECKED_KEY, [*self._dark_checks, posture.as_dict()])

    def discard(self, posture: Posture, lights: Iterable[str]) -> None:
        """Remove images of a posture, to take them again or because they are in doubt, and its final dark check."""
        others = [checked for checked in self._dark_checks if checked != posture.as_dict()]
        changed = {images.DARK_CHECKED_KEY: others} if others != self._dark_checks else None
        self.writer.drop(images=[(light, posture) for light in lights], extra=changed)

    @property
    def in_doubt(self) -> int:
        """Number of images on disk that no frame without light followed, so that they are taken again."""
        entries = self.writer.manifest.images if self._plan.options.check else ()
        return sum(not self.dark_checked(entry.posture) for entry in entries)

    @property
    def _dark_checks(self) -> list[dict[str, float]]:
        return list(self.writer.manifest.extra.get(images.DARK_CHECKED_KEY, ()))

    def has_dark(self, posture: Posture, exposure: float) -> bool:
        return self.writer.file_done(images.dark_name(posture, exposure))

    def read_dark(self, posture: Posture, exposure: float) -> Float32:
        """A dark frame that is on disk [sensor level]."""
        return images.read_png(self.writer.folder / images.dark_name(posture, exposure)).astype(np.float32)

    def add_dark(self, acquired: AcquiredImage) -> None:
        posture, exposure = acquired.posture, acquired.exposure
        facts = {"light": None, "posture": posture.as_dict(), "exposure": exposure, "capture": _facts(acquired)}
        facts["mean_level"] = float(acquired.image.mean.mean(dtype=np.float64))
        name = images.dark_name(posture, exposure)
        self.writer.drop(files=[name])
        self.writer.add_levels(name, acquired.image.png, metadata=facts)

    def add(self, acquired: AcquiredImage) -> None:
        assert acquired.light is not None
        angles = self._angles[acquired.light]
        extra = {"capture": _facts(acquired)}
        entry = images.ImageEntry(acquired.light, *angles, acquired.posture, acquired.exposure, extra=extra)
        self.writer.add_image(entry, png=acquired.image.png)

    def read_levels(self, light: str, posture: Posture, exposure: float) -> NDArray[Any]:
        """An image that is on disk [sensor level]."""
        return images.read_png(self._png(light, posture, exposure))

    def _png(self, light: str, posture: Posture, exposure: float) -> Path:
        entry = next(e for e in self.writer.manifest.images if e.key == (light, posture, exposure))
        return self.writer.folder / (entry.png or "")

    def add_linear(
        self, light: str, posture: Posture, captured: Mapping[float, ExposureImage], dark: Mapping[float, Float32]
    ) -> None:
        """Merge the exposures of a light, those of this run and those on disk, and write the linear image."""
        exposures = self._plan.exposures_of[light]
        taken = [captured.get(exposure) or self._read_exposure(light, posture, exposure) for exposure in exposures]
        frames = [dark[exposure] for exposure in exposures] if dark else None
        sensor, full_scale = self._scene.sensor, self._scene.reflectance.full_scale
        channels = merge_exposures(taken, sensor=sensor, full_scale=full_scale, dark=frames)
        self.writer.add_linear(light, posture, channels)

    def _read_exposure(self, light: str, posture: Posture, exposure: float) -> ExposureImage:
        path = self._png(light, posture, exposure)
        facts: dict[str, Any] = images.read_metadata(path).get("capture", {})
        held = facts.get("exposure_us", {}).get("read", self._plan.exposure_us(exposure))
        frame = FrameMean(self._scene.sensor)
        frame.add(images.read_png(path))
        return frame.image(held / self._plan.wiring.exposure_us)


def _facts(acquired: AcquiredImage) -> dict[str, Any]:
    saturated = acquired.image.saturated
    return {**acquired.facts, "saturated_share": np.count_nonzero(saturated) / saturated.size}


MOST_LINEARS = 2  # linear images that wait or are being written, at most: their exposures are held in memory until then


class BackgroundWriter:
    """One worker checks and writes images, one merges and writes linear ones.

    The next exposure waits for the previous image, not for linear ones, which can be computed from the images at any
    time. After an error no further image is written. A disk that refuses counts as a failed device: an
    :class:`InputError` of the workers is raised here as :class:`HardwareError`.
    """

    def __init__(self) -> None:
        self._images = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._linears = ThreadPoolExecutor(1, thread_name_prefix="linear")
        self._last: Future[None] | None = None
        self._queued: list[Future[None]] = []

    def submit_image(self, work: Callable[..., None], *arguments: object) -> None:
        """Check and write an image, once those before it are done."""
        self._last = self._images.submit(_run_after, self._last, work, *arguments)

    def submit_linear(self, work: Callable[..., None], *arguments: object) -> None:
        """Write a linear image, once its exposures are written; waits while the queue is full."""
        self._wait_for_linears(MOST_LINEARS - 1)
        self._queued.append(self._linears.submit(_run_after, self._last, work, *arguments))

    def wait_for_image(self, longest_s: float | None = None) -> bool:
        """Wait until the last image is on disk, at most so long [s]; returns whether it is, raises its error."""
        if self._last is None:
            return True
        wait([self._last], longest_s)
        if not self._last.done():
            return False
        _result(self._last)
        return True

    def wait(self) -> None:
        self.wait_for_image()
        self._wait_for_linears(0)

    def wait_idle(self, longest_s: float, *, failed: bool) -> bool:
        """Wait at most so long [s]; returns whether all is done. After a failure no further linear image begins."""
        if failed:
            self._linears.shutdown(wait=False, cancel_futures=True)
        last = [self._last] if self._last is not None else []
        return not wait([f for f in (*self._queued, *last) if not f.done()], longest_s).not_done

    def close(self) -> None:
        """Finish all work, whatever fails."""
        self._images.shutdown(wait=True)
        self._linears.shutdown(wait=True)

    def _wait_for_linears(self, most: int) -> None:
        """Wait until at most so many linear images are not written yet; the first error of the others is raised."""
        while True:
            done = [future for future in self._queued if future.done()]
            self._queued = [future for future in self._queued if future not in done]
            for future in done:
                _result(future)
            if len(self._queued) <= most:
                return
            wait(self._queued, return_when=FIRST_COMPLETED)


def _run_after(before: Future[None] | None, work: Callable[..., None], *arguments: object) -> None:
    """Do some work once the work before it has succeeded; its error is raised otherwise."""
    if before is not None:
        before.result()
    work(*arguments)


def _result(future: Future[Any]) -> None:
    try:
        future.result()
    except InputError as error:
        raise HardwareError(*error.messages) from error
