"""The defects to plan for where a part names none."""

import math
from dataclasses import dataclass

from lightopt.defects._shape import DefectShape


@dataclass(frozen=True)
class CatalogueEntry:
    """A kind of defect that an inspection is planned for: its name, size, steepness and factors."""

    name: str
    shape: DefectShape


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
