"""Start a virtual bench that simulates the devices of a rig."""

from typing import Any

from lightopt.config import AxisConfig, ControllerConfig, PartConfig, RigConfig
from lightopt.rig.capture._wiring import VIRTUAL, Wiring
from lightopt.rig.simulated import AxisWire, BenchProcess, BenchTruth, CameraSetup, LightWire

STAGE = "stage"  # name of the stage among the devices of a virtual bench; controllers have the names of the rig file


def start_bench(
    rig: RigConfig, wiring: Wiring, *, part: PartConfig | None = None, truth: BenchTruth | None = None
) -> BenchProcess:
    """Start a virtual bench with the virtual devices of a rig, and with a camera where there is a part.

    Raises HardwareError: its process does not start.
    """
    hardware = wiring.hardware
    devices = _controllers(wiring)
    if wiring.stage_is_virtual and hardware.stage is not None:
        devices[STAGE] = {"kind": hardware.stage.driver, "options": _stage(rig, wiring)}
    if part is None:
        return BenchProcess(devices)
    setup = CameraSetup(
        rig=str(rig.source.path.resolve()),
        part=str(part.source.path.resolve()),
        exposure_us=wiring.exposure_us,
        lights=tuple(
            LightWire(
                light=name,
                device=channel.controller,
                channel=channel.channel,
                share=channel.level / hardware.controllers[channel.controller].top_level,
            )
            for name, channel in hardware.lights.items()
            if channel.controller in devices
        ),
        elevation=_axis_wire(wiring, "elevation"),
        rotation=_axis_wire(wiring, "rotation"),
        truth=truth or BenchTruth(),
        gige=wiring.camera_is_gige,
    )
    return BenchProcess(devices, camera=setup.as_dict())


def start_lights(wiring: Wiring) -> BenchProcess:
    """Start a virtual bench with the virtual light controllers alone."""
    return BenchProcess(_controllers(wiring))


def _controllers(wiring: Wiring) -> dict[str, dict[str, Any]]:
    return {
        name: {"kind": config.driver, "options": _lights(config)}
        for name, config in wiring.hardware.controllers.items()
        if config.port == VIRTUAL
    }


def _lights(config: ControllerConfig) -> dict[str, Any]:
    """Arguments of the simulated firmware of a light controller."""
    options: dict[str, Any] = {"channels": config.channels, "top_level": config.top_level}
    if config.template is not None:
        options["template"] = config.template.model_dump()
    return options


def _stage(rig: RigConfig, wiring: Wiring) -> dict[str, Any]:
    """Arguments of the simulated firmware of a stage: speeds and ranges of the rig file."""
    stage = wiring.hardware.stage
    assert stage is not None
    axes = [
        (axis, range_deg)
        for axis, range_deg in (
            (stage.elevation, rig.stage.elevation_range_deg),
            (stage.rotation, rig.stage.rotation_range_deg),
        )
        if axis is not None
    ]
    speeds = {axis.axis: axis.speed_deg_per_s * abs(axis.steps_per_deg) for axis, _ in axes}
    options: dict[str, Any] = {"home_speed": max(speeds.values())}
    ends = {
        axis.axis: sorted(axis.zero + angle * axis.steps_per_deg for angle in range_deg) for axis, range_deg in axes
    }
    if stage.driver == "zaber":
        options["limits"] = {name: [int(min(0, low)) - 1, int(high) + 1] for name, (low, high) in ends.items()}
    if stage.driver == "grbl":
        numbers = {"X": 0, "Y": 1, "Z": 2}
        settings: dict[str, float] = {"22": 1.0}
        for name, speed in speeds.items():
            settings[str(110 + numbers[name])] = 60.0 * speed
            settings[str(130 + numbers[name])] = max(1.0, -ends[name][0])
        options["settings"] = settings
    return options


def _axis_wire(wiring: Wiring, name: str) -> AxisWire | None:
    stage = wiring.hardware.stage
    axis: AxisConfig | None = None if stage is None else getattr(stage, name)
    if axis is None or not wiring.stage_is_virtual:
        return None
    return AxisWire(device=STAGE, axis=axis.axis, steps_per_deg=axis.steps_per_deg, zero=axis.zero)
