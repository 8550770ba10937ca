"""How far the defects of a catalogue fill a pixel: see :mod:`lightopt.defects._pixel`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from lightopt.defects import DefectShape, pixel_shares
from lightopt.design.responses._defect_hypotheses import Trial

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Fillings:
    """The defects that trials are the walls of, e of them; trials of a defect stand side by side.

    Attributes
    ----------
    first
        Index of each defect's first trial, and the number of trials; shape (e + 1,).
    facing
        Whether only walls that face each other share a pixel, as a scratch's two do; else those of all directions do.
    width
        [mm], shape (e,).
    shares
        From :func:`lightopt.defects.pixel_shares`, shape (e, n, 4).
    """

    first: Int64
    facing: NDArray[np.bool_]
    width: Float64
    shares: Float64


def fillings_of(trials: Sequence[Trial]) -> Fillings:
    """The defects behind trials, in their order."""
    groups = [list(some) for _, some in groupby(trials, key=_defect)]
    shapes = [_shape(some[0]) for some in groups]
    first = np.cumsum([0, *(len(some) for some in groups)]).astype(np.int64)
    return Fillings(
        first=first,
        facing=np.array([shape.kind == "scratch" for shape in shapes], np.bool_),
        width=np.array([shape.width for shape in shapes]),
        shares=np.stack([pixel_shares(shape) for shape in shapes]),
    )


def _defect(trial: Trial) -> tuple[object, ...]:
    size = trial.length, trial.width, trial.slope
    return (trial.name, trial.kind, *size, trial.R_d_factor, trial.sigma_factor)


def _shape(trial: Trial) -> DefectShape:
    return DefectShape(kind=trial.kind, length=trial.length, width=trial.width, slope=trial.slope)
