"""Faults that a capture on the virtual bench suffers, one at a time, and a small rig to suffer them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["BEDS", "Case", "driver_cases", "line_cases", "make_rig", "other_cases", "pulled_cases"]

ROOT = Path(__file__).resolve().parents[2]
# a reply that comes at all comes within this [s], however busy the machine; one that is late comes after it
TIMEOUT_S, LATE_S = 1.0, 2.0

_RIG = """\
format: lightopt-rig/1
name: small
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 44
  image_distance_mm: 55
  exposure_us: 2000
  sensor: {{bit_depth: 8, read_noise_levels: 0.8, electrons_per_level: 60}}
light_source: {{size_mm: [60, 60], points: 4}}
lights:
  - {{name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}}
  - {{name: light3, distance_mm: 330, elevation_deg: 45, azimuth_deg: 225, gain: 0.8}}
stage: {{elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}}
hardware:
  controllers:
    lights: {{{lights}, channels: 2, timeout_s: {timeout_s}}}
  lights:
    light1: {{controller: lights, channel: 1, level: 200}}
    light3: {{controller: lights, channel: 2, level: 200}}
  stage:
    {stage}
    timeout_s: {timeout_s}
  camera: {{driver: virtual}}
  timing: {{light_ms: 5, stage_ms: 5}}
"""

LIGHTS = {
    "ccs": "driver: ccs, port: virtual",
    "sa": "driver: sa, port: virtual",
    "template": r"""driver: template, port: virtual, template: {set: "L{channel}{level:03d}\r\n", set_reply: OK,
      read: "?{channel}\r\n", read_reply: 'L[12](?P<level>[0-9]{3})', end: "\r\n"}""",
}

STAGES = {
    "shot": """driver: shot
    port: virtual
    elevation: {axis: "1", steps_per_deg: 100, speed_deg_per_s: 1000}
    rotation: {axis: "2", steps_per_deg: 100, speed_deg_per_s: 1000}""",
    "grbl": """driver: grbl
    port: virtual
    elevation: {axis: X, steps_per_deg: 1, zero: -50, speed_deg_per_s: 1000}
    rotation: {axis: "Y", steps_per_deg: 1, zero: -361, speed_deg_per_s: 1000}""",
    "gsc": """driver: gsc
    port: virtual
    elevation: {axis: "1", steps_per_deg: 100, speed_deg_per_s: 150}
    rotation: {axis: "2", steps_per_deg: 100, speed_deg_per_s: 150}""",
    "zaber": """driver: zaber
    port: virtual
    elevation: {axis: "1", steps_per_deg: 100, zero: 5000, speed_deg_per_s: 1000}
    rotation: {axis: "2", steps_per_deg: 100, speed_deg_per_s: 1000}""",
}

BEDS = {"shot": "ccs", "grbl": "ccs", "gsc": "sa", "zaber": "template"}
"""Which lights a rig has, by its stage."""

_PART = """\
format: lightopt-part/1
name: knob
mesh: {file: knob.stl, units: mm}
postures: [{elevation_deg: 0, rotation_deg: 0}, {elevation_deg: -10, rotation_deg: 170}]
reflectance: {R_d: 45.0, R_s: 12500, sigma_rad: 0.0475}
"""


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes
    ----------
    kind
        What happens, as the table calls it.
    device
        To which device of the bench; None where the whole bench is killed.
    fault, options
        As the bench calls it.
    step
        For a bench that is killed: at which step of the plan, counted from 0.
    stage
        Which stage the rig has, and so which lights (:data:`BEDS`).
    """

    kind: str
    device: str | None = None
    fault: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    step: int | None = None
    stage: str = "shot"


def make_rig(folder: Path, stage: str = "shot") -> tuple[Path, Path]:
    """Write the small rig, its part and the mesh; returns rig and part."""
    folder.mkdir(parents=True, exist_ok=True)
    rig, part = folder / "rig.yaml", folder / "part.yaml"
    text = _RIG.format(stage=STAGES[stage], lights=LIGHTS[BEDS[stage]], timeout_s=TIMEOUT_S)
    rig.write_text(text, encoding="utf-8", newline="\n")
    part.write_text(_PART, encoding="utf-8", newline="\n")
    shutil.copyfile(ROOT / "configs" / "parts" / "cover-knob.stl", folder / "knob.stl")
    return rig, part


def line_cases(deliveries: dict[str, int], *, every: int = 1) -> Iterator[Case]:
    """Replies lost and spoilt: each fault once at every so many-th reply, and for good from there on.

    Parameters
    ----------
    deliveries
        Messages that each device gets in an undisturbed run.
    every
        Distance between the replies that are hit.
    """
    faults: tuple[tuple[str, str, dict[str, Any], tuple[str, ...]], ...] = (
        ("reply dropped", "drop", {}, ("lights", "stage")),
        ("reply late", "delay", {"delay_s": LATE_S}, ("lights", "stage")),
        ("reply truncated", "truncate", {"keep": 2}, ("lights", "stage")),
        ("garbage before the reply", "garbage_before", {"bytes": 4}, ("lights", "stage")),
        ("garbage instead of the reply", "garbage_instead", {"bytes": 6}, ("lights", "stage")),
        ("wrong checksum", "checksum", {}, ("lights",)),
        ("NG 01, command", "ng", {"code": 1}, ("lights",)),
        ("NG 02, checksum", "ng", {"code": 2}, ("lights",)),
        ("NG 03, value", "ng", {"code": 3}, ("lights",)),
        ("NG of the stage", "refuse", {}, ("stage",)),
    )
    for kind, fault, options, devices in faults:
        for device in devices:
            for after in range(0, deliveries[device], every):
                yield Case(f"{kind}, once", device, fault, {**options, "after": after})
            for after in range(every // 2, deliveries[device], 4 * every):
                yield Case(f"{kind}, permanently", device, fault, {**options, "after": after, "count": None})


def driver_cases(deliveries: dict[str, dict[str, int]]) -> Iterator[Case]:
    """Each fault of the line for the other drivers: once and for good, early and late in the run.

    Parameters
    ----------
    deliveries
        Messages that each device gets in an undisturbed run, by the rig's stage.
    """
    faults: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("reply dropped", "drop", {}),
        ("reply late", "delay", {"delay_s": LATE_S}),
        ("reply truncated", "truncate", {"keep": 2}),
        ("garbage before the reply", "garbage_before", {"bytes": 4}),
        ("garbage instead of the reply", "garbage_instead", {"bytes": 6}),
        ("cable pulled", "vanish", {}),
    )
    own = {
        "lights": {"sa": ("ng",), "template": ("ng",)},
        "stage": {"gsc": ("refuse",), "zaber": ("refuse", "checksum"), "grbl": ("refuse",)},
    }
    for stage, lights in BEDS.items():
        for device, driver in (("lights", lights), ("stage", stage)):
            if driver in ("ccs", "shot"):
                continue  # which the others are about
            more = [(f"{fault} of the device", fault, {}) for fault in own[device].get(driver, ())]
            for kind, fault, options in (*faults, *more):
                # what is refused are moves, of which there are few
                count = 2 if fault == "refuse" else deliveries[stage][device]
                for after in (count // 4, 3 * count // 4):
                    yield Case(f"{driver}: {kind}, once", device, fault, {**options, "after": after}, stage=stage)
                if fault != "vanish":
                    options = {**options, "after": count // 2, "count": None}
                    yield Case(f"{driver}: {kind}, permanently", device, fault, options, stage=stage)


def pulled_cases(deliveries: dict[str, int], steps: int, *, every: int = 1) -> Iterator[Case]:
    """The cable of each device pulled at every so many-th message to it, and the bench killed at every such step."""
    for device in ("lights", "stage"):
        for after in range(0, deliveries[device], every):
            options = {"after": after, "obeyed": bool(after % 2)}
            yield Case(f"cable of the {device} pulled", device, "vanish", options)
    for step in range(0, steps, every):
        yield Case("firmware killed", step=step)


def other_cases() -> Iterator[Case]:
    """Lights that do not do what they say, and a stage that does not arrive."""
    for channel in (1, 2):
        yield Case("light stays dark", "lights", "dark", {"channel": channel})
        yield Case("light stays on", "lights", "lit", {"channel": channel})
        yield Case("light ignores commands", "lights", "deaf", {"channel": channel})
    for move in (2, 3):  # the first two are the search for the origins
        for share in (0.0, 0.3, 0.9):
            yield Case("stage stalls", "stage", "stall", {"after": move, "share": share})
            yield Case("stage stalls, busy for ever", "stage", "stall", {"after": move, "share": share, "busy": True})
    for move in range(4):
        for share in (0.3, 0.9):
            yield Case("stage meets a limit switch", "stage", "limit", {"after": move, "share": share})
            yield Case("stage meets a limit switch", "stage", "limit", {"after": move, "share": share}, stage="grbl")
    for code in (1, 2, 3, 9):
        yield Case("alarm of the stage", "stage", "alarm", {"code": code}, stage="grbl")
