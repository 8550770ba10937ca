"""Faults: when one strikes, and those of the line (replies lost, late, cut short, garbled; cable pulled).

A fault strikes by count or by seeded chance, so that a failed test can be run again.
"""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


class Trigger:
    """Decides at each occasion whether a fault strikes.

    after: Occasions that pass unharmed first.
    count: Occasions that it strikes; None: all that follow.
    probability, seed: Chance that it strikes at an occasion that `after` and `count` leave to it.
    """

    struck = 0
    """How often faults struck in this process, those of all triggers together."""

    def __init__(self, *, after: int = 0, count: int | None = 1, probability: float = 1.0, seed: int = 0) -> None:
        if after < 0 or (count is not None and count < 1) or not 0 <= probability <= 1:
            raise ValueError("after counts from 0, count from 1, and probability lies between 0 and 1")
        self._after = after
        self._left = count
        self._probability = probability
        self._random = random.Random(seed)  # noqa: S311  (chance of a fault, not a secret)

    @property
    def spent(self) -> bool:
        """Whether it will never strike again."""
        return self._left == 0

    def strikes(self) -> bool:
        """Whether the fault strikes at this occasion."""
        if self._after > 0:
            self._after -= 1
            return False
        if self.spent or self._random.random() >= self._probability:
            return False
        if self._left is not None:
            self._left -= 1
        Trigger.struck += 1
        return True


def trigger(fault: str, options: Mapping[str, Any]) -> Trigger:
    """Trigger of a fault from the options of a request; a ValueError names the fault."""
    try:
        return Trigger(**options)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{fault}: {error}") from None


LINE_FAULTS = ("drop", "delay", "truncate", "garbage_before", "garbage_instead", "vanish")


@dataclass(frozen=True)
class Transmission:
    """Bytes on their way to the client, and when [s] they arrive."""

    due: float
    data: bytes


@dataclass
class _Fault:
    kind: str
    trigger: Trigger
    options: dict[str, Any]


class FaultyLine:
    """Transmits the bytes that a device sends, with faults.

    Faults, each with the options of :class:`Trigger`: ``drop``; ``delay`` (by ``delay_s``); ``truncate`` (to ``keep``
    bytes); ``garbage_before`` and ``garbage_instead`` (so many ``bytes``); ``vanish`` (the cable is pulled when a
    command arrives; ``obeyed``: whether the device still hears it). Occasions of ``vanish`` are deliveries of bytes to
    the device, those of the others are replies.
    """

    def __init__(self) -> None:
        self._faults: list[_Fault] = []

    def inject(self, kind: str, options: Mapping[str, Any]) -> None:
        """Set a fault from now on; ``clear`` ends all."""
        if kind == "clear":
            self._faults.clear()
            return
        chosen = dict(options)
        own = {
            "delay": {"delay_s": 0.5},
            "truncate": {"keep": 1},
            "garbage_before": {"bytes": 3},
            "garbage_instead": {"bytes": 5},
            "vanish": {"obeyed": False},
        }.get(kind, {})
        values = {key: chosen.pop(key, value) for key, value in own.items()}
        values["seed"] = chosen.get("seed", 0)
        self._faults.append(_Fault(kind, trigger(kind, chosen), values))

    def pulled(self) -> bool | None:
        """Whether the cable is pulled as bytes arrive at the device: None if not, else whether it still hears them."""
        for fault in self._faults:
            if fault.kind == "vanish" and fault.trigger.strikes():
                return bool(fault.options["obeyed"])
        return None

    def carry(self, data: bytes, now: float) -> list[Transmission]:
        """What arrives at the client of a reply that the device sends at a time [s]."""
        due = now
        for fault in self._faults:
            if fault.kind == "vanish" or not fault.trigger.strikes():
                continue
            if fault.kind == "drop":
                data = b""
            elif fault.kind == "delay":
                due = now + float(fault.options["delay_s"])
            elif fault.kind == "truncate":
                data = data[: int(fault.options["keep"])]
            else:
                noise = _garbage(int(fault.options["bytes"]), int(fault.options["seed"]))
                data = noise + (data if fault.kind == "garbage_before" else b"")
        return [Transmission(due, data)] if data else []


def _garbage(count: int, seed: int) -> bytes:
    """Bytes as a disturbed line has them: any but those that end or begin commands."""
    chance = random.Random(seed)  # noqa: S311  (noise, not a secret)
    return bytes(chance.choice(range(0x80, 0xFF)) for _ in range(count))
