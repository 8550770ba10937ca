"""From a rig file's lights to lights in the world frame."""

import math
from collections.abc import Sequence
from typing import Literal

from lightopt.config import RigConfig, points_problem
from lightopt.core.errors import InputError
from lightopt.lights import PanelLight, place_light


def build_lights(
    rig: RigConfig, names: Sequence[str] | None = None, points: int | Literal["auto"] | None = None
) -> tuple[PanelLight, ...]:
    """The rig's panels, world frame.

    names: Of the lights to keep; all by default
    points: Point lights per panel, instead of the rig's
    Raises InputError: A name that the rig does not have
    """
    known = [light.name for light in rig.lights]
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise InputError(*(f'no light "{name}" in {rig.source.path}; it has {", ".join(known)}' for name in unknown))
    lights: list[PanelLight] = []
    for light in (light for light in rig.lights if names is None or light.name in names):
        if points is not None and (problem := points_problem(points)):
            raise InputError(f"points of {light.name}: {problem}")
        shared = rig.light_source
        own = {key: getattr(light, key) for key in type(shared).model_fields if getattr(light, key) is not None}
        source = shared.model_copy(update=own)
        panel = place_light(
            name=light.name,
            distance=light.distance_mm,
            elevation=math.radians(light.elevation_deg),
            azimuth=math.radians(light.azimuth_deg),
            size=source.size_mm,
            points=source.points if points is None else points,
            normalisation=source.normalisation,
            gain=light.gain,
            inverse_square=source.falloff == "inverse_square",
            emission_exponent=source.emission_exponent,
        )
        lights.append(panel)
    return tuple(lights)
