"""The defects to plan for where a part names none."""

import math
from dataclasses import dataclass, replace
from typing import Final

from lightopt.defects._shape import DefectShape

SIZES: Final = (0.6, 1.0, 1.6)
"""Sizes that are tested, as multiples of an entry's; the slope stays."""

_SLOPES = 3  # steps of a range of slopes for which inspections are planned


@dataclass(frozen=True)
class CatalogueEntry:
    """A kind of defect that an inspection is planned for: its name, size, steepness and factors."""

    name: str
    shape: DefectShape
    sizes: tuple[float, float] = (1.0, 1.0)  # least and greatest, as multiples of the shape's
    slopes: tuple[float, float] = (1.0, 1.0)  # likewise

    def at(self, size: float, slope: float) -> "CatalogueEntry":
        """One defect of the ranges, from 0 for the least to 1 for the greatest size and slope, in equal ratios."""
        (small, large), (flat, steep) = self.sizes, self.slopes
        scale, steeper = small * (large / small) ** size, flat * (steep / flat) ** slope
        shape = replace(
            self.shape,
            length=scale * self.shape.length,
            width=scale * self.shape.width,
            slope=steeper * self.shape.slope,
        )
        return CatalogueEntry(self.name, shape)

    def in_sizes(self) -> tuple["CatalogueEntry", ...]:
        """Entries of one size that together test all sizes of the range: each tests :data:`SIZES` of its own."""
        small, large = self.sizes
        count = max(1, math.ceil(math.log(large / small) / math.log(SIZES[-1] / SIZES[0]) - 1e-9))
        return tuple(self.at((i + 0.5) / count, 0.5) for i in range(count))

    def in_sizes_and_slopes(self) -> tuple["CatalogueEntry", ...]:
        """Entries of one size and slope that stand for the ranges, equally many of each part of them."""
        count = _SLOPES if self.slopes[0] < self.slopes[1] else 1
        return tuple(
            replace(one, shape=replace(one.shape, slope=self.at(0.5, (i + 0.5) / count).shape.slope))
            for one in self.in_sizes()
            for i in range(count)
        )


BUILT_IN_CATALOGUE = (
    # handling: parts that slide over each other or over a fixture; shallow, since deeper ones are seen without effort
    CatalogueEntry("scratch", DefectShape(kind="scratch", length=5.0, width=0.2, slope=math.radians(4.0))),
    # a knock from a rounded object: wide for its depth of 22 µm, without an edge, so that only a mirror shows it
    CatalogueEntry("dent", DefectShape(kind="dent", length=2.0, width=2.0, slope=math.radians(2.0))),
    # dust or a nodule under the plating, levelled by it to a gentle hill of 17 µm
    CatalogueEntry("bump", DefectShape(kind="bump", length=1.0, width=1.0, slope=math.radians(3.0))),
    # a gas pore or a corroded place that the plating did not close: small and steep
    CatalogueEntry("pit", DefectShape(kind="pit", length=0.3, width=0.3, slope=math.radians(20.0))),
    # plating that came off its base and lifted: a flat top of 20 µm with a wall around it
    CatalogueEntry("blister", DefectShape(kind="blister", length=1.5, width=1.5, slope=math.radians(6.0))),
    # a residue of bath or rinse: the shape is unharmed, the diffuse light is 30 % less
    CatalogueEntry("stain", DefectShape(kind="stain", length=2.0, width=1.5, R_d_factor=0.7)),
    # burnt or porous plating, or a wiped place: the mirror has become half as wide again
    CatalogueEntry("haze", DefectShape(kind="haze", length=3.0, width=3.0, sigma_factor=1.5)),
)
"""Terms as in ISO 8785:1998 (surface imperfections). The figures are those of a part of some centimetres, seen with
pixels of 0.05 to 0.1 mm: from well visible to just visible, none of them so coarse that any light shows it."""
