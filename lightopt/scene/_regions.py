"""The regions of a part file, found on the part's mesh."""

import math

import numpy as np

from lightopt import geometry
from lightopt.config import PartConfig, RegionConfig
from lightopt.core.errors import collected, refuse
from lightopt.images import read_png


def mesh_of_regions(loaded: geometry.LoadedMesh, part: PartConfig) -> geometry.TriangleMesh:
    """The mesh of a part in the file's coordinates [mm], with the materials of the part's regions.

    Raises InputError: Regions that the mesh does not have, or whose masks cannot be read
    """

    def place(number: int) -> str:
        return f'{part.source.at("regions", number)}: region "{part.regions[number].name}"'

    problems: list[str] = []
    regions: list[geometry.Region] = []
    for number, own in enumerate(part.regions):
        with collected(problems, where=place(number)):
            regions.append(_region(part, own))
    refuse(problems)
    return geometry.mesh_with_regions(loaded, regions, most=part.mesh.max_triangles, place=place)


def _region(part: PartConfig, own: RegionConfig) -> geometry.Region:
    if own.colour is not None:
        return geometry.ColouredRegion(own.colour)
    if own.group is not None:
        return geometry.NamedRegion(own.group)
    if own.faces_at_mm is not None:
        return geometry.RegionAtPoints(own.faces_at_mm, cad=part.mesh.of_step)
    if own.box_mm is not None:
        return geometry.BoxRegion(own.box_mm.low, own.box_mm.high)
    assert own.mask is not None
    picture = read_png(part.source.resolve(own.mask.file), colour=True)
    levels = picture if picture.ndim == 2 else picture.mean(axis=2)
    return geometry.MaskRegion(
        mask=levels > 0.5 * np.iinfo(picture.dtype).max,
        axis="xyz".index(own.mask.onto[1]),
        positive=own.mask.onto[0] == "+",
        corner=own.mask.corner_mm,
        pixel=own.mask.pixel_mm,
        depth=own.mask.depth_mm or (-math.inf, math.inf),
    )
