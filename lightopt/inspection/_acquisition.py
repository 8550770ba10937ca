"""How a posture was taken: exposures and numbers of frames under each light."""

from __future__ import annotations

from collections.abc import Sequence

from lightopt.estimate.registration import Observation

Shots = dict[str, tuple[tuple[float, int], ...]]
"""By light the exposures and the numbers of frames of its images."""


def shots_of(observations: Sequence[Observation], lights: Sequence[str]) -> Shots:
    """Exposures and numbers of frames of the images of a posture, by light in the order given."""
    return {
        light: tuple(sorted((o.exposure, o.frames) for o in observations if o.light == light))
        for light in lights
    }


def shots_text(shots: Shots) -> str:
    """As a message has them."""

    def one(exposure: float, frames: int) -> str:
        return f"×{exposure:g}" + (f" of {frames} frames" if frames > 1 else "")

    return "; ".join(f"{light} {', '.join(one(*shot) for shot in own)}" for light, own in shots.items())
