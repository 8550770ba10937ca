"""The camera of the virtual bench, in the process of the firmware: it sees what the firmware does.

The pixels of a frame follow the answer to its request row by row, little end first.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.rig.simulated._bench_process import CameraSetup
from lightopt.rig.simulated._devices import Handler, Response, SimulatedDevices

if TYPE_CHECKING:
    from lightopt.rig.simulated._optics import BenchOptics, Levels


# where the part is, the numbers of the pictures that screens show, and the exposure, which blurs a part that moves
_View = tuple[Posture, tuple[int, ...], float]


class BenchCamera:
    def __init__(self, setup: CameraSetup, devices: SimulatedDevices) -> None:
        self._setup = setup
        self._devices = devices
        self._number = 0
        self._seen: tuple[dict[str, float], Posture] | None = None
        self._optics: BenchOptics | None = None
        self._building = threading.Lock()
        self._prepared: _View | None = None
        self._unprepared: str | None = None
        self._renderer: threading.Thread | None = None
        # the mesh is loaded while the client is still opening its ports
        threading.Thread(target=self._build, name="scene", daemon=True).start()

    def requests(self) -> dict[str, Handler]:
        return {"camera": self._identity, "frame": self._frame, "prepare": self._prepare}

    def _build(self) -> "BenchOptics":
        with self._building:
            if self._optics is None:
                from lightopt.config import load_rig
                from lightopt.rig.simulated._optics import BenchOptics
                from lightopt.scene import build_scene

                rig, part = Path(self._setup.rig), Path(self._setup.part)
                try:
                    # postures come from the stage; those of the part's file may be beyond the rig's range
                    alone = load_rig(rig).without_programme()
                    scene = build_scene(alone, part, postures=())
                except InputError as error:
                    raise ValueError(str(error)) from error
                displays = [light for light in alone.lights if light.kind == "display"]
                if scene.waviness is not None:
                    # each part has a surface of its own
                    scene = replace(scene, waviness=replace(scene.waviness, seed=self._setup.truth.seed))
                if scene.motion is not None:
                    scene = replace(scene, motion=replace(scene.motion, exposure_s=1e-6 * self._setup.exposure_us))
                self._optics = BenchOptics(scene, self._setup.truth, displays, folder=rig.parent)
            return self._optics

    def _identity(self, _: Mapping[str, Any]) -> Response:
        resolution_px, bit_depth = self.sensor()
        return {"resolution_px": resolution_px, "bit_depth": bit_depth, "triggered": self._setup.truth.triggered}, b""

    def expose(self, exposure_us: float, gain_db: float, triggered: bool) -> "Levels":
        """Levels of a frame that begins now, or when the one before ended."""
        now = self._state()
        shares, posture = now if triggered or self._seen is None else self._seen
        exposure = exposure_us / self._setup.exposure_us
        pixels = self._build().frame(shares, posture, exposure=exposure, gain_db=gain_db)
        self._seen = self._state()
        return pixels

    def _prepare(self, request: Mapping[str, Any]) -> Response:
        """Whether the view is rendered, which is begun if not: a camera that is silent meanwhile counts as gone."""
        moves = self._optics is None or self._optics.scene.motion is not None
        exposure = float(request["exposure_us"]) / self._setup.exposure_us if moves else 1.0
        view = self._posture(), tuple(picture.number for picture in self._devices.pictures().values()), exposure
        if self._unprepared is not None:
            failed, self._unprepared = self._unprepared, None
            raise ValueError(failed)
        ready = self._prepared == view
        if not ready and (self._renderer is None or not self._renderer.is_alive()):
            self._renderer = threading.Thread(target=self._render, args=(view,), name="render", daemon=True)
            self._renderer.start()
        return {"ready": ready}, b""

    def _render(self, view: _View) -> None:
        try:
            optics = self._build()
            shares, posture = self._state()
            optics.prepare(posture, shares, exposure=view[2])
            self._prepared = view if optics.scene.motion is not None else (*view[:2], 1.0)
        except Exception as error:  # noqa: BLE001  (reported to the next request)
            self._unprepared = str(error) or type(error).__name__

    def sensor(self) -> tuple[tuple[int, int], int]:
        scene = self._build().scene
        return (scene.camera.width, scene.camera.height), scene.sensor.bit_depth

    def _frame(self, request: Mapping[str, Any]) -> Response:
        self._build()
        exposure_us = float(request["exposure_us"])
        begun, begun_ns = time.monotonic(), time.time_ns()
        pixels = self.expose(exposure_us, 0.0, self._setup.truth.triggered)
        time.sleep(max(0.0, exposure_us / 1e6 - (time.monotonic() - begun)))
        self._seen = self._state()
        self._number += 1
        little = pixels.dtype.newbyteorder("<")
        head = {"number": self._number, "timestamp_ns": begun_ns, "exposure_us": exposure_us}
        form = {"shape": list(pixels.shape), "dtype": little.str}
        return {**head, **form}, pixels.astype(little, copy=False).tobytes()

    def _state(self) -> tuple[dict[str, float], Posture]:
        levels, pictures, wires = self._devices.levels(), self._devices.pictures(), self._setup.lights
        shares = {w.light: levels[w.device].get(w.channel, 0.0) / w.share for w in wires if w.device in levels}
        for device, picture in pictures.items():
            own = [wire for wire in wires if wire.device == device]
            shares |= self._build().shares(device, picture, own)
        return shares, self._posture()

    def _posture(self) -> Posture:
        positions = self._devices.positions(time.monotonic())
        angles = {name: axis.angle_deg(positions[axis.device]) for name, axis in self._setup.axes.items()}
        return Posture(angles.get("elevation", 0.0), angles.get("rotation", 0.0))
