"""The ways in which the surfaces of a part file are brushed, as fields of directions on the part's mesh."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lightopt import geometry
from lightopt.config import BrushingConfig, PartConfig
from lightopt.core.errors import InputError


def brushings(part: PartConfig) -> Iterator[tuple[str, BrushingConfig | None]]:
    """The place in the part file, and the brushing, of each material of the part."""
    for keys, surface in (((), part), *((("regions", i), region) for i, region in enumerate(part.regions))):
        yield part.source.at(*keys, "reflectance", "brushing"), surface.reflectance.brushing


def with_brushing(loaded: geometry.LoadedMesh, part: PartConfig) -> geometry.LoadedMesh:
    """A mesh in the file's coordinates [mm], brushed as the part file says; InputError without texture coordinates."""
    if not any(own for _, own in brushings(part)):
        return loaded
    fields = tuple(own and _field(own, loaded, f"{where}: {part.mesh.file}") for where, own in brushings(part))
    return replace(loaded, mesh=replace(loaded.mesh, brushing=fields))


def _field(own: BrushingConfig, loaded: geometry.LoadedMesh, place: str) -> geometry.Brushing:
    if own.direction is not None:
        return geometry.StraightBrushing(np.array(own.direction))
    if own.around_axis is not None:
        return geometry.RoundBrushing(np.array(own.around_axis.point_mm), np.array(own.around_axis.direction))
    if own.along_curve_mm is not None:
        return geometry.CurvedBrushing(np.array(own.along_curve_mm))
    assert own.along_texture is not None
    if loaded.texture is None:
        raise InputError(f"{place} has no texture coordinates; .obj, .glb and .ply files may have them")
    return geometry.texture_brushing(loaded, own.along_texture)


def faces_without_direction(mesh: geometry.TriangleMesh, part: PartConfig) -> tuple[str, ...]:
    """Warnings about faces on which the texture has no direction; InputError where these are all of a surface."""
    warnings: list[str] = []
    for number, ((where, _), field) in enumerate(zip(brushings(part), mesh.brushing, strict=False)):
        if not isinstance(field, geometry.TextureBrushing):
            continue
        faces = field.source if mesh.material is None else field.source[mesh.material == number]
        without = ~field.directions[faces].any(axis=(1, 2))
        text = f"{where}: {without.sum()} of {len(faces)} triangles have no texture coordinates, or three on one line"
        if len(faces) and without.all():
            raise InputError(f"{text}: no surface has a direction of brushing")
        if without.any():
            warnings.append(f"{text}: their lobe is the narrow one all round")
    return tuple(warnings)
