"""Progress and warnings of a run."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lightopt.rendering import RenderProgress

Share = Callable[[float], None]
"""Called with the share that is done."""

Tell = Callable[[str, float], None]
"""Called with the stage of the work and the share of it that is done."""


class RunContext:
    """Where a run reports to; nothing is reported where a function is None.

    inform: Called with how much there is to choose from.
    warn: Called with each warning, once.
    rays: Called as the luminance matrices are computed.
    stage: Called with the stage of the work and the share of it that is done.
    """

    def __init__(
        self,
        *,
        inform: Callable[[str], None] | None = None,
        warn: Callable[[str], None] | None = None,
        rays: RenderProgress | None = None,
        stage: Tell | None = None,
    ) -> None:
        self._inform, self._warn = inform, warn
        self.rays, self.stage = rays, stage
        self._warnings: dict[str, None] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings so far."""
        return tuple(self._warnings)

    def inform(self, text: str) -> None:
        """Pass a message on."""
        if self._inform is not None:
            self._inform(text)

    def warn(self, text: str) -> None:
        """Keep a warning and pass it on, unless it is known."""
        if text not in self._warnings:
            self._warnings[text] = None
            if self._warn is not None:
                self._warn(text)


def of_stage(tell: Tell | None, stage: str) -> Share | None:
    """Progress of one stage; None where nobody listens."""
    return None if tell is None else partial(tell, stage)


def prefixed(tell: Tell | None, what: str) -> Tell | None:
    """Progress of the stages of a larger one; None where nobody listens."""
    return None if tell is None else lambda stage, share: tell(f"{what}, {stage}", share)
