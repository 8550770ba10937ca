"""How to fit: what a user chooses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from lightopt.estimate.reflectance._estimate import FreeParameters
from lightopt.estimate.reflectance._paper import PaperOptions

Points: TypeAlias = "int | Literal['auto']"
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How to fit.

    method: ``"likelihood"`` or ``"paper"``.
    joint: Whether a specular fit fits R_d along instead of keeping the part file's.
    gain, dark, shift: What else is freed; `shift` is the part's place on the stage.
    points: Point lights per panel to try; the rig's own where empty.
    pixels: About how many pixels to look at, over all images.
    validate: Whether to leave each light out in turn.
    write_noise: Whether the noise that the images show belongs into the rig file.
    paper: Of the paper's procedure.
    """

    method: Literal["likelihood", "paper"] = "likelihood"
    joint: bool = False
    gain: bool = False
    dark: bool = False
    shift: bool = False
    points: tuple[Points, ...] = ()
    pixels: int = 1_500_000
    validate: bool = True
    write_noise: bool = False
    paper: PaperOptions = field(default_factory=PaperOptions)
    threads: int | None = None

    @property
    def freed(self) -> FreeParameters:
        """What a specular fit may change."""
        return FreeParameters(diffuse=self.joint, gain=self.gain, dark=self.dark)
