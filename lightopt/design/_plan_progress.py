"""How a plan tells what is going on, and the share of it that is done."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

Share = Callable[[float], None]
"""Called with the share that is done."""

Tell = Callable[[str, float], None]
"""Called with what is going on and the share of that which is done."""


def of_stage(tell: Tell | None, stage: str) -> Share | None:
    """Tells the share of one stage; None where nobody listens."""
    return None if tell is None else partial(tell, stage)


def prefixed(tell: Tell | None, what: str) -> Tell | None:
    """Tells stages of what they are a part of; None where nobody listens."""
    return None if tell is None else lambda stage, share: tell(f"{what}, {stage}", share)
