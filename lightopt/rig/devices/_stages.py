"""Every stage driver by the name that a rig file calls it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lightopt.core.errors import InputError, LightoptError
from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._dialogue import Dialogue
from lightopt.rig.devices._grbl import GrblDialogue, check_grbl
from lightopt.rig.devices._gsc import GscDialogue, check_gsc
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._log import SerialLog
from lightopt.rig.devices._shot import ShotDialogue, check_shot
from lightopt.rig.devices._stage import Clock, MovingStage
from lightopt.rig.devices._zaber import ZaberDialogue, check_zaber

_Speak = Callable[[SerialLink, Sequence[Axis], float], Dialogue]


@dataclass(frozen=True)
class StageDriver:
    """A language that stages speak.

    Attributes
    ----------
    name
        Its name in a rig file.
    baud
        The protocol's usual baud rate.
    rtscts
        Whether the device paces the line.
    check
        Refuses axes and speeds that it cannot have, as far as that is known without the device.
    speak
        Makes the language's dialogue from link, axes, and the longest time [s] that homing may take.
    """

    name: str
    baud: int
    rtscts: bool
    check: Callable[[Sequence[Axis]], None]
    speak: _Speak


def stage_drivers() -> dict[str, StageDriver]:
    """The stage drivers by name."""
    drivers = (
        StageDriver("shot", 9600, True, check_shot, lambda link, axes, _: ShotDialogue(link, axes)),
        StageDriver("gsc", 9600, False, check_gsc, lambda link, axes, _: GscDialogue(link, axes)),
        StageDriver(
            "grbl",
            115200,
            False,
            check_grbl,
            lambda link, axes, s: GrblDialogue(link, axes, home_timeout_s=s),
        ),
        StageDriver("zaber", 115200, False, check_zaber, lambda link, axes, _: ZaberDialogue(link, axes)),
    )
    return {driver.name: driver for driver in drivers}


def check_stage(driver: str, axes: Sequence[Axis]) -> None:
    """Check what a stage is asked to be against what its driver can say; nothing is opened.

    Raises
    ------
    lightopt.core.errors.InputError
        For an unknown driver, or axes or speeds that it cannot have.
    """
    known = stage_drivers()
    if driver not in known:
        raise InputError(f"unknown stage driver {driver}; there are: {', '.join(known)}")
    if not axes:
        raise InputError("the stage has no axis: hardware.stage needs elevation, rotation, or both")
    known[driver].check(axes)


def open_stage(
    driver: str,
    *,
    port: str,
    axes: Sequence[Axis],
    baud: int | None = None,
    timeout_s: float = 1.0,
    home_timeout_s: float = 180.0,
    log: SerialLog | None = None,
    clock: Clock | None = None,
) -> MovingStage:
    """Open a stage; nothing moves.

    Parameters
    ----------
    driver
        Name of the driver.
    port
        Serial port or pyserial URL.
    axes
        The axes that the device moves, at least one.
    baud
        Baud rate; the protocol's usual one if None.
    timeout_s
        Deadline [s] of a reply.
    home_timeout_s
        Longest time [s] that seeking the origins may take.
    log
        Where every byte is written down.
    clock
        Time between two looks at a moving stage, for tests.

    Raises
    ------
    lightopt.core.errors.InputError
        For an unknown driver, axes that it cannot have, or a port that is not there or in use.
    lightopt.core.errors.HardwareError
        When the device does not answer where the protocol has it speak first.
    """
    check_stage(driver, axes)
    kind = stage_drivers()[driver]
    link = SerialLink(
        port,
        device=f"stage ({driver})",
        baud=kind.baud if baud is None else baud,
        rtscts=kind.rtscts,
        timeout_s=timeout_s,
        log=log,
    )
    try:
        dialogue = kind.speak(link, axes, home_timeout_s)
    except LightoptError:
        link.close()
        raise
    return MovingStage(
        driver=driver, dialogue=dialogue, axes=axes, home_timeout_s=home_timeout_s, clock=clock
    )
