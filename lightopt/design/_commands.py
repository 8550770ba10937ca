"""The commands that carry a plan out, and the way that the stage goes in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._rig_file import degrees_text
from lightopt.design.exposures._brackets import Brackets
from lightopt.scene import travel_order, travel_s

HOME = Posture(0.0, 0.0)
"""Where the stage's way begins."""


@dataclass(frozen=True, kw_only=True)
class Way:
    """The way of the stage through postures.

    Attributes
    ----------
    order
        That takes least time from (0°, 0°).
    seconds
        Of the travel.
    """

    order: tuple[Posture, ...]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of a plan, to be run in the folder of its files.

    Attributes
    ----------
    text
        The command.
    way
        Of the stage while it captures; None of a command that renders.
    """

    text: str
    way: Way | None = None


def way_through(rig: RigConfig, postures: Sequence[Posture]) -> Way:
    """The way from (0°, 0°) through postures, at the speed of the rig's stage or of the virtual bench's.

    Parameters
    ----------
    rig
        With the stage.
    postures
        In the order that counts where times are equal.
    """

    def time(start: Posture, end: Posture) -> float:
        if rig.hardware is None:
            return travel_s(None, start, end)
        return 0.0 if rig.hardware.stage is None else travel_s(rig.hardware.stage, start, end)

    order = travel_order(postures, start=HOME, time=time)
    return Way(order=order, seconds=sum(time(a, b) for a, b in zip((HOME, *order), order, strict=False)))


def commands(
    rig: RigConfig,
    files: Mapping[Posture, str],
    part: str,
    brackets: Brackets | None,
    rendered: Sequence[str] = (),
) -> tuple[Command, ...]:
    """Commands that carry a plan out, in the folder of its files: those that capture it, then those that render it.

    One of each kind for all postures of the same rig file and exposures, into an image set of their own.

    Parameters
    ----------
    rig
        Whose stage travels.
    files
        Rig file of each posture.
    part
        Part file.
    brackets
        Further exposures; None for exposure 1 alone.
    rendered
        Options of the commands that render.
    """
    groups: dict[tuple[str, tuple[float, ...]], list[Posture]] = {}
    for posture, file in files.items():
        groups.setdefault((file, brackets.of(posture) if brackets else (1.0,)), []).append(posture)
    captures: list[Command] = []
    renders: list[Command] = []
    for number, ((file, exposures), some) in enumerate(groups.items(), start=1):
        end = "" if len(groups) == 1 else f"-{number}"
        chosen = [
            f"--posture={degrees_text(p.elevation_deg)},{degrees_text(p.rotation_deg)}"
            for p in some
            if len(groups) > 1
        ]
        levels = [f"{exposure:.9g}" for exposure in exposures]
        taken = [
            "lightopt capture",
            file,
            part,
            *chosen,
            f"--exposures {','.join(levels)}",
            f"-o captured{end}",
        ]
        captures.append(Command(text=" ".join(taken), way=way_through(rig, some)))
        each = (f"--exposure {level}" for level in levels)
        words = ["lightopt render", file, part, *chosen, *each, *rendered, f"-o rendered{end}"]
        renders.append(Command(text=" ".join(words)))
    return (*captures, *renders)
