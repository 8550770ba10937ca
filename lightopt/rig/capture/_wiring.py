"""Which device plays which role on a rig: those of its file, or the virtual bench where the file has none."""

from dataclasses import dataclass

from lightopt.config import (
    AxisConfig,
    CameraDeviceConfig,
    ChannelConfig,
    ControllerConfig,
    HardwareConfig,
    RigConfig,
    StageDeviceConfig,
)
from lightopt.scene import VIRTUAL_DEG_PER_S

VIRTUAL = "virtual"  # port of a device that is simulated on this computer
VIRTUAL_EXPOSURE_US = 10_000.0  # exposure time of exposure 1 where all is virtual and the rig does not give one

_CHANNELS_EACH = 4
_VIRTUAL_LEVEL = 200
_VIRTUAL_TILT = AxisConfig(axis="1", steps_per_deg=1000.0, speed_deg_per_s=VIRTUAL_DEG_PER_S)
_VIRTUAL_ROTATION = AxisConfig(axis="2", steps_per_deg=200.0, speed_deg_per_s=VIRTUAL_DEG_PER_S)


@dataclass(frozen=True)
class Wiring:
    """The devices of a rig.

    hardware: From the rig file, or the virtual bench.
    given: Whether the rig file has it.
    exposure_us: Exposure time of exposure 1 [µs].
    """

    hardware: HardwareConfig
    given: bool
    exposure_us: float

    def light(self, name: str) -> ChannelConfig:
        """Where a light is plugged in."""
        return self.hardware.lights[name]

    def top_level(self, name: str) -> int:
        """Highest level that a light may have."""
        channel = self.light(name)
        top = self.hardware.controllers[channel.controller].top_level
        return min(top, channel.max_level or top)

    @property
    def stage_is_virtual(self) -> bool:
        """Whether there is a stage and it is simulated, hence always just switched on."""
        return self.hardware.stage is not None and self.hardware.stage.port == VIRTUAL

    @property
    def needs_bench(self) -> bool:
        """Whether any device is simulated."""
        ports = [controller.port for controller in self.hardware.controllers.values()]
        return VIRTUAL in ports or self.stage_is_virtual or self.camera_is_virtual

    @property
    def camera_is_gige(self) -> bool:
        """Whether the camera is the simulated one on the loopback, behind its real driver."""
        return self.hardware.camera.driver == "aravis" and self.hardware.camera.port == VIRTUAL

    @property
    def camera_is_virtual(self) -> bool:
        """Whether frames are rendered: what lies on the bench has to be known."""
        return self.hardware.camera.driver == VIRTUAL or self.camera_is_gige


def wiring_of(rig: RigConfig) -> Wiring:
    """The devices of a rig; without a ``hardware`` section the virtual bench.

    The virtual bench has CCS controllers of four channels, a SHOT stage with both axes, and the virtual camera.
    """
    hardware = rig.hardware
    exposure_us = rig.camera.exposure_us or VIRTUAL_EXPOSURE_US
    if hardware is not None:
        return Wiring(hardware, given=True, exposure_us=exposure_us)
    controllers: dict[str, ControllerConfig] = {}
    lights: dict[str, ChannelConfig] = {}
    for i, light in enumerate(rig.lights):
        name = f"bench{i // _CHANNELS_EACH + 1}"
        controllers.setdefault(name, ControllerConfig(driver="ccs", port=VIRTUAL, channels=_CHANNELS_EACH))
        channel = i % _CHANNELS_EACH + 1
        lights[light.name] = ChannelConfig(controller=name, channel=channel, level=_VIRTUAL_LEVEL)
    stage = StageDeviceConfig(driver="shot", port=VIRTUAL, elevation=_VIRTUAL_TILT, rotation=_VIRTUAL_ROTATION)
    camera = CameraDeviceConfig(driver="virtual")
    hardware = HardwareConfig(controllers=controllers, lights=lights, stage=stage, camera=camera)
    return Wiring(hardware, given=False, exposure_us=exposure_us)
