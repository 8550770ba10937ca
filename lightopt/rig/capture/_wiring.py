"""Which device plays which role on a rig: those of its file, or those of a virtual bench, which is started here."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lightopt import config
from lightopt.config import HardwareConfig, PartConfig, RigConfig, load_rig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, refuse
from lightopt.rig.devices import Axis
from lightopt.rig.simulated import AxisWire, BenchProcess, BenchTruth, CameraSetup, LightWire
from lightopt.scene import VIRTUAL_DEG_PER_S, display_picture

STAGE = "stage"  # name of the stage among the devices of a virtual bench; controllers have the names of the rig file
VIRTUAL = "virtual"  # port of a device that is simulated on this computer
VIRTUAL_EXPOSURE_US = 10_000.0  # exposure time of exposure 1 where all is virtual and the rig does not give one
_CHANNELS_EACH, _VIRTUAL_LEVEL = 4, 200
_LEVEL_TOLERANCE = 0.005  # how far a whole level may be from the weight of an image, as a share
_VIRTUAL_TILT = config.AxisConfig(axis="1", steps_per_deg=1000.0, speed_deg_per_s=VIRTUAL_DEG_PER_S)
_VIRTUAL_ROTATION = config.AxisConfig(axis="2", steps_per_deg=200.0, speed_deg_per_s=VIRTUAL_DEG_PER_S)


@dataclass(frozen=True)
class Wiring:
    hardware: HardwareConfig  # from the rig file, or the virtual bench
    given: bool  # whether the rig file has it
    exposure_us: float  # exposure time of exposure 1 [µs]
    # levels of the lights of each image of the rig's programme; none where each image is of one light
    images: Mapping[str, Mapping[str, int]] = field(default_factory=dict[str, Mapping[str, int]])
    # lights of displays by name, for their pictures; none where the rig's file cannot be read as a whole
    displays: Mapping[str, config.LightConfig] = field(default_factory=dict[str, config.LightConfig])
    folder: Path = Path()  # of the rig's file, where commands of displays are run

    def light(self, name: str) -> config.ChannelConfig:
        return self.hardware.lights[name]

    def levels(self, image: str) -> Mapping[str, int]:
        """Lights that are on together for an image, and their levels; of a light alone, that light."""
        return self.images.get(image) or {image: self.light(image).level}

    def settle_s(self, name: str) -> float:
        """How long a light takes to be on, or off, once it is sent, beside `timing.light_ms` [s]: that of a screen."""
        picture = self.hardware.controllers[self.light(name).controller].picture
        return 0.0 if picture is None else picture.settle_ms / 1e3

    def pictures(self, controller: str) -> dict[int, Callable[[], Float64]]:
        """Picture of each channel of a display, made when it is needed."""
        if (screen := self.hardware.controllers[controller].picture) is None:
            return {}
        own = {name: self.hardware.lights[name] for name in self.displays if name in self.hardware.lights}
        return {
            channel.channel: partial(display_picture, self.displays[name], screen.seen_px, folder=self.folder)
            for name, channel in own.items()
            if channel.controller == controller
        }

    def top_level(self, name: str) -> int:
        channel = self.light(name)
        top = self.hardware.controllers[channel.controller].top_level
        return min(top, channel.max_level or top)

    @property
    def stage_is_virtual(self) -> bool:
        """Whether there is a stage and it is simulated, hence always just switched on."""
        return self.hardware.stage is not None and self.hardware.stage.port == VIRTUAL

    @property
    def needs_bench(self) -> bool:
        ports = [controller.port for controller in self.hardware.controllers.values()]
        return VIRTUAL in ports or self.stage_is_virtual or self.camera_is_virtual

    @property
    def camera_is_gige(self) -> bool:
        """Whether the camera is the simulated one on the loopback, behind its real driver."""
        return self.hardware.camera.driver == "aravis" and self.hardware.camera.port == VIRTUAL

    @property
    def camera_is_virtual(self) -> bool:
        """Whether frames are rendered: what lies on the bench has to be known."""
        return self.hardware.camera.is_simulated


def wiring_of(rig: RigConfig) -> Wiring:
    """The devices of a rig, or the virtual bench: CCS controllers of four channels, a SHOT stage, a virtual camera."""
    hardware = rig.hardware or _virtual_hardware(rig)
    wiring = Wiring(
        hardware,
        given=rig.hardware is not None,
        exposure_us=rig.camera.exposure_us or VIRTUAL_EXPOSURE_US,
        images=_image_levels(rig, hardware),
        displays={light.name: light for light in rig.channels if light.kind == "display"},
        folder=rig.source.resolve("."),
    )
    refuse(_too_bright(rig, wiring))
    return wiring


def _virtual_hardware(rig: RigConfig) -> HardwareConfig:
    controllers: dict[str, config.ControllerConfig] = {}
    lights: dict[str, config.ChannelConfig] = {}
    for i, light in enumerate(rig.channels):
        name = f"bench{i // _CHANNELS_EACH + 1}"
        controllers.setdefault(name, config.ControllerConfig(driver="ccs", port=VIRTUAL, channels=_CHANNELS_EACH))
        channel = i % _CHANNELS_EACH + 1
        lights[light.name] = config.ChannelConfig(controller=name, channel=channel, level=_VIRTUAL_LEVEL)
    stage = config.StageDeviceConfig(driver="shot", port=VIRTUAL, elevation=_VIRTUAL_TILT, rotation=_VIRTUAL_ROTATION)
    camera = config.CameraDeviceConfig(driver="virtual")
    return HardwareConfig(controllers=controllers, lights=lights, stage=stage, camera=camera)


def _image_levels(rig: RigConfig, hardware: HardwareConfig) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    problems: list[str] = []
    for i, image in enumerate(rig.programme or ()):
        found[image.name] = own = {}
        for light, weight in image.lights.items():
            wanted = weight * hardware.lights[light].level
            own[light] = round(wanted)
            if abs(own[light] - wanted) > _LEVEL_TOLERANCE * wanted:
                where, level = rig.source.at("programme", i, "lights", light), hardware.lights[light].level
                problems.append(
                    f"{where}: weight {weight:g} of level {level} is {wanted:g}, and the controller has whole levels; "
                    "choose a weight that gives one, or another level of the light"
                )
    refuse(problems)
    return found


def _too_bright(rig: RigConfig, wiring: Wiring) -> Iterator[str]:
    """Images of a programme that need more than the full radiance of a display."""
    for i, image in enumerate(rig.programme or ()):
        levels = wiring.images[image.name]
        channels = {name: wiring.light(name) for name in levels}
        for controller in dict.fromkeys(channel.controller for channel in channels.values()):
            device = wiring.hardware.controllers[controller]
            here = ((name, c.channel) for name, c in channels.items() if c.controller == controller)
            own = {channel: levels[name] / device.top_level for name, channel in here}
            if device.picture is None or sum(own.values()) <= 1.0:
                continue
            pictures = wiring.pictures(controller)
            most = float(np.sum([share * pictures[channel]() for channel, share in own.items()], axis=0).max())
            if most > 1.0 + 1e-9:
                where, full = rig.source.at("programme", i, "lights"), f"the full radiance of the display {controller}"
                yield f"{where}: the pictures together need {most:.3g} times {full}; lower the weights, or the levels"


def stage_axes(rig: RigConfig, stage: config.StageDeviceConfig) -> list[Axis]:
    ranges = rig.stage.elevation_range_deg, rig.stage.rotation_range_deg
    axes = zip(("elevation", "rotation"), (stage.elevation, stage.rotation), ranges, strict=True)
    return [
        Axis(name, axis.axis, range_deg, **axis.model_dump(exclude={"axis"}))
        for name, axis, range_deg in axes
        if axis is not None
    ]


def start_bench(
    rig: RigConfig, wiring: Wiring, *, part: PartConfig | None = None, truth: BenchTruth | None = None
) -> BenchProcess:
    """Start a virtual bench with the virtual devices of a rig, and with a camera where there is a part.

    truth: Where the bench differs from the files; as the rig file has it by default.
    Raises HardwareError: its process does not start.
    Raises InputError: the true rig that the rig file names does not fit it.
    """
    hardware = wiring.hardware
    true = rig if part is None else _true_rig(rig)  # which only the camera sees
    devices = simulated_controllers(wiring, true)
    axes: list[Axis] = []
    if wiring.stage_is_virtual and hardware.stage is not None:
        axes = stage_axes(rig, hardware.stage)
        devices[STAGE] = {"kind": hardware.stage.driver, "options": _stage_options(hardware.stage.driver, axes)}
    if part is None:
        return BenchProcess(devices)
    lights: list[LightWire] = []
    for name, plug in hardware.lights.items():
        if plug.controller in devices:
            share = plug.level / hardware.controllers[plug.controller].top_level
            lights.append(LightWire(name, plug.controller, plug.channel, share))
    setup = CameraSetup(
        rig=str(true.source.path.resolve()),
        part=str(part.source.path.resolve()),
        exposure_us=wiring.exposure_us,
        lights=tuple(lights),
        axes={axis.name: AxisWire(STAGE, axis.device, axis.steps_per_deg, axis.zero) for axis in axes},
        truth=truth or bench_truth(rig),
        gige=wiring.camera_is_gige,
    )
    return BenchProcess(devices, camera=asdict(setup))


def bench_truth(rig: RigConfig, seed: int | None = None) -> BenchTruth:
    """How the virtual bench differs from a rig's file, apart from the rig that it follows; `seed` as in the file."""
    truth = BenchTruth()
    if (own := rig.virtual_bench) is not None:
        x, y, z = map(math.radians, own.part_rotation_vector_deg)
        same = own.model_dump(include={"seed", "rays", "bounces", "part_offset_mm"})
        truth = BenchTruth(**same, part_rotation=(x, y, z))
    return truth if seed is None else replace(truth, seed=seed)


def _true_rig(rig: RigConfig) -> RigConfig:
    if rig.virtual_bench is None or rig.virtual_bench.rig is None:
        return rig
    true = load_rig(rig.source.resolve(rig.virtual_bench.rig))
    own, there = (
        {
            "lights": {light.name for light in one.channels},
            "resolution_px": one.camera.resolution_px,
            "bit_depth": one.camera.sensor.bit_depth,
        }
        for one in (rig, true)
    )
    for what in own:
        if own[what] != there[what]:
            where = f"{rig.source.at('virtual_bench', 'rig')}: {true.source.path}"
            raise InputError(f"{where} has other {what} than this file; the bench's true rig must have the same")
    return true


def simulated_controllers(wiring: Wiring, true: RigConfig | None = None) -> dict[str, dict[str, Any]]:
    """Devices of a :class:`BenchProcess`: the virtual light controllers, with screens mounted as on the true rig."""
    found: dict[str, dict[str, Any]] = {}
    there = {} if true is None or true.hardware is None else true.hardware.controllers
    for name, controller in wiring.hardware.controllers.items():
        if controller.port != VIRTUAL:
            continue
        if controller.picture is None:
            options = controller.model_dump(include={"channels", "top_level", "template"}, exclude_none=True)
            found[name] = {"kind": controller.driver, "options": options}
        else:
            picture = (there[name].picture if name in there else None) or controller.picture
            options = picture.model_dump(mode="json", exclude={"settle_ms"})
            found[name] = {"kind": "screen", "tcp": True, "options": options}
    return found


def _stage_options(driver: str, axes: Sequence[Axis]) -> dict[str, Any]:
    """Arguments of the simulated firmware of a stage: speeds and ranges of the rig file."""
    options: dict[str, Any] = {"home_speed": max(axis.speed_units() for axis in axes)}
    ends = {axis.device: sorted(map(axis.units_of, axis.range_deg)) for axis in axes}
    if driver == "zaber":
        options["limits"] = {name: [int(min(0, low)) - 1, int(high) + 1] for name, (low, high) in ends.items()}
    if driver == "grbl":
        settings: dict[str, float] = {"22": 1.0}
        for axis in axes:
            number = "XYZ".index(axis.device)
            settings[str(110 + number)] = 60.0 * axis.speed_units()
            settings[str(130 + number)] = max(1.0, -ends[axis.device][0])
        options["settings"] = settings
    return options
