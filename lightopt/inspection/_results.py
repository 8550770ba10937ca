"""What an inspection found: of each posture, and of the whole set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.estimate.registration import Placement, Registration
from lightopt.inspection._coverage import Coverage
from lightopt.inspection._defect_merging import FoundDefect, Sighting
from lightopt.inspection._posture_view import PostureView
from lightopt.inspection._surface import SurfaceCoverage
from lightopt.inspection._synthetic import SyntheticImage
from lightopt.scene import Scene

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class InspectedPosture:
    """One posture of an inspected part.

    Attributes
    ----------
    view
        Images and prediction.
    make_synthetic
        Makes the image without highlights; None where none was asked for.
    score
        −log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W).
    labels
        Number of the region that each pixel belongs to, 0 for none, shape (H, W).
    threshold
        Score from which a region counts.
    sightings
        One per region.
    coverage
        Of the surface.
    """

    view: PostureView
    make_synthetic: Callable[[], SyntheticImage] | None
    score: Float32
    labels: NDArray[np.int32]
    threshold: float
    sightings: tuple[Sighting, ...]
    coverage: Coverage

    @cached_property
    def synthetic(self) -> SyntheticImage | None:
        """The image without highlights; None where none was asked for.

        It is made when it is first asked for: it takes several times as long as the verdict, which the residual
        detector reaches without it.
        """
        return None if self.make_synthetic is None else self.make_synthetic()

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        photometry = self.view.photometry
        return {
            "posture": self.view.posture.as_dict(),
            "lights": list(self.view.lights),
            "threshold": round(self.threshold, 3),
            "gains": {name: round(photometry.gains[name], 5) for name in self.view.lights},
            "dark_levels": round(photometry.dark, 4),
            **({} if self.synthetic is None else {"filled_px": int(self.synthetic.filled.sum())}),
            "surface": self.coverage.as_dict(),
        }


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What an inspection of one set of images found.

    Attributes
    ----------
    defects
        The highest score first.
    postures
        In the set's order.
    placement
        Where the part lies from where its file has it; None where it was not looked for.
    registration
        The search that found it, or the part of the batch that it lies near; None where there was none.
    words
        What a person should know: missing lights and postures, and so on.
    nominal
        The scene with the part where its file has it.
    surface
        Of the part, each place counted once however many postures show it.
    """

    defects: tuple[FoundDefect, ...]
    postures: tuple[InspectedPosture, ...]
    placement: Placement | None
    registration: Registration | None = None
    words: tuple[str, ...]
    nominal: Scene = field(repr=False, compare=False)
    surface: SurfaceCoverage

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "defects": [defect.as_dict() for defect in self.defects],
            "postures": [posture.as_dict() for posture in self.postures],
            "surface": self.surface.as_dict(),
            "placement": None if self.placement is None else self.placement.as_dict(),
            "registration": None if self.registration is None else self.registration.as_dict(),
            "warnings": list(self.words),
        }
