"""A long capture on a rig that fails at random: ``python tests/hardware/soak.py`` (docs/validation/reliability.md).

Images are taken with the GigE camera of the virtual bench behind its real driver. At a stated rate each, frames do not
come, come in part, or have an older time stamp, and replies of the light controller and the stage are lost or spoilt. A
run that stops, because the same happened three times in a row, is resumed as a person would. In the end every image has
to be that of a run without faults.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from fault_runs import alike
from faulty_bench import set_fault, with_faults
from rig_faults import gige_rig

from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import HardwareError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, capture, connect_devices
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchProcess

__all__ = ["Soaked", "main", "soak"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "reliability.md"
BEGIN, END = "<!-- soak: begin -->", "<!-- soak: end -->"
FAULTS = (
    ("camera", "lost"),
    ("camera", "incomplete"),
    ("camera", "stale"),
    ("lights", "drop"),
    ("stage", "garbage_before"),
)
MIB = 1 << 20


@dataclass(frozen=True)
class Soaked:
    """Outcome of a soak test.

    Attributes
    ----------
    requested, there
        Images of the plan, and those that are at the end what they are without faults, pixel for pixel.
    struck
        Faults that struck, as the bench counts them.
    retries
        Frames and commands that were requested again.
    stops
        Runs that stopped and were resumed.
    begun_bytes, ended_bytes
        Memory of this process after the first tenth of the images, and at the end.
    seconds
        How long it took.
    """

    requested: int
    there: int
    struck: int
    retries: int
    stops: int
    begun_bytes: int
    ended_bytes: int
    seconds: float


def soak(folder: Path, *, postures: int, rate: float, seed: int, most_stops: int = 20) -> Soaked:
    """Capture four images in each of so many postures, with faults at a rate, until all are there."""
    rig_file, part_file = gige_rig(folder)
    rig, part = load_rig(rig_file), load_part(part_file)
    angles = [Posture(-20.0 + 40.0 * (i % 5) / 4, 360.0 * i / postures % 360) for i in range(postures)]
    options = CaptureOptions(postures=tuple(angles), exposures=(1.0, 1 / 16))
    counts: Counter[str] = Counter()
    memory: list[int] = []
    out = folder / "soaked"
    begun = time.monotonic()

    def connect(plan: CapturePlan) -> Devices:
        with with_faults():
            bench = start_bench(rig, plan.wiring, part=part)
        devices = connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)
        for number, (device, fault) in enumerate(FAULTS):
            chance = {"count": None, "probability": rate, "seed": seed + 100 * counts["runs"] + number}
            set_fault(bench, device, fault, **chance)
        counts["runs"] += 1
        devices._closing = (lambda: _ended(bench, devices, counts),)
        return devices

    def report(_: str, share: float) -> None:
        if share >= 0.1 and not memory:
            memory.append(_resident())

    resume = False
    while True:
        try:
            capture(rig, part, out, options=options, resume=resume, connect=connect, run=RunContext(progress=report))
            break
        except HardwareError:
            counts["stops"] += 1
            resume = (out / "manifest.json").exists()
            if counts["stops"] > most_stops:
                raise
    ended, seconds = _resident(), time.monotonic() - begun
    _undisturbed(rig, part, folder / "truth", options, most_stops)
    return Soaked(
        requested=4 * postures,
        there=alike(out, folder / "truth"),
        struck=counts["struck"],
        retries=counts["retries"],
        stops=counts["stops"],
        begun_bytes=memory[0],
        ended_bytes=ended,
        seconds=seconds,
    )


def _undisturbed(rig: RigConfig, part: PartConfig, folder: Path, options: CaptureOptions, most_stops: int) -> None:
    """What the images are without faults; a busy computer may stop that run, too, by a time-out."""
    resume = (folder / "manifest.json").exists()
    try:
        capture(rig, part, folder, options=options, resume=resume)
    except HardwareError:
        if most_stops == 0:
            raise
        _undisturbed(rig, part, folder, options, most_stops - 1)


def _ended(bench: BenchProcess, devices: Devices, counts: Counter[str]) -> None:
    counts["retries"] += devices.retries
    counts["struck"] += bench.state()["struck"]
    bench.close()


def _resident() -> int:
    """Memory of this process [bytes]; 0 where the system does not say."""
    status = Path("/proc/self/status")
    if not status.exists():
        return 0
    line = next(line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) * 1024


def main(arguments: list[str] | None = None) -> int:
    """Soak and write down what came of it."""
    parser = argparse.ArgumentParser(prog="python tests/hardware/soak.py", description=__doc__)
    parser.add_argument("--postures", type=int, default=125, help="four images in each")
    parser.add_argument("--rate", type=float, default=0.01, help="chance of each fault at each frame or reply")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--page", type=Path, default=PAGE, help="Markdown page that is renewed")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        found = soak(Path(name), postures=chosen.postures, rate=chosen.rate, seed=chosen.seed)
    text = (
        "| images planned | correct at the end | lost | faults that occurred | repeated frames and commands "
        "| runs stopped and resumed | memory after a tenth of the images [MiB] | at the end [MiB] | minutes |\n"
        "|" + "---:|" * 9 + "\n"
        f"| {found.requested} | {found.there} | {found.requested - found.there} | {found.struck} | {found.retries} "
        f"| {found.stops} | {found.begun_bytes / MIB:.0f} | {found.ended_bytes / MIB:.0f} "
        f"| {found.seconds / 60:.1f} |\n"
        f"\n`python tests/hardware/soak.py --postures {chosen.postures} --rate {chosen.rate:g} --seed {chosen.seed}`."
    )
    print(text)
    page = chosen.page.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    chosen.page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8", newline="\n")
    return int(found.there != found.requested)


if __name__ == "__main__":
    sys.exit(main())
