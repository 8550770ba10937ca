"""The programme of a rig file: which lights, how bright, make which image."""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Annotated

from pydantic import BeforeValidator, Field

from lightopt.config import _fields as fields
from lightopt.config._light import RANGE_KEYS, LightConfig


def _fraction(value: object) -> object:
    # "1/16" is text in YAML
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ZeroDivisionError):
        return value


_Weight = Annotated[float, Field(gt=0, le=1), fields.expecting("a weight above 0 up to 1 (full brightness)")]
_Exposure = Annotated[
    float, Field(gt=0, le=1e6), BeforeValidator(_fraction), fields.expecting("a number above 0, such as 1 or 1/16")
]


class ProgrammeImageConfig(fields.Frozen):
    """An image of the programme."""

    name: fields.FileName
    """Name of the image; it becomes a file name and takes the place of the light's name in every command."""
    lights: Annotated[dict[str, _Weight], Field(min_length=1)]
    """Lights that are on together (name-1, name-2, ... of lights of several channels), each with its weight on the
    brightness that the file gives it, above 0 up to 1."""
    exposures: Annotated[tuple[_Exposure, ...], Field(strict=False, min_length=1, max_length=16)] | None = None
    """Exposures of this image, whatever a command's option says; those of the command if absent."""


def programme_misfits(programme: object, lights: Sequence[LightConfig]) -> Iterator[fields.Complaint]:
    """What does not fit together, by the path under ``programme``."""
    images, known = fields.entries(programme), {light.name: light for light in lights}
    yield from fields.same_names(images, "programme", str.lower)
    for i, image in enumerate(images):
        name, weights = fields.value_of(image, "name"), fields.mapping(fields.value_of(image, "lights"))
        clash = {light.lower(): light for light in known}.get(str(name).lower())
        if clash is not None and set(weights) != {clash}:
            reason = f'"{clash}" is a light of the rig, and this image is not of that light alone; choose another name'
            yield (i, "name"), name, fields.complaint(reason)
        for light in weights:
            if light not in known:
                reason = f'no light "{light}"; the rig has {", ".join(known)}'
                yield (i, "lights", light), weights[light], fields.complaint(reason)
                continue
            if any(getattr(known[light], key) is not None for key in RANGE_KEYS):
                reason = f'"{light}" has a range, and lights of a programme are fixed; leave the range out'
                yield (i, "lights", light), weights[light], fields.complaint(reason)
            others = [one for one in weights if one in known and known[one].entry != known[light].entry]
            if known[light].pattern is not None and others:
                reason = f'"{light}" is of a display with stripes, which images show without other lights; leave it or'
                yield (i, "lights", light), weights[light], fields.complaint(f"{reason} {', '.join(others)} out")
            if known[light].direct_level is not None and others:
                reason = f'"{light}" has a direct_level, and images show it without other lights; leave it or'
                yield (i, "lights", light), weights[light], fields.complaint(f"{reason} {', '.join(others)} out")
            if known[light].kind == "panel" and len(weights) > 1:
                reason = f'"{light}" is a panel, which images show alone; write kind: bar, which has an area, or split'
                yield (i, "lights", light), weights[light], fields.complaint(f"{reason} the image")
        exposures = [
            str(_fraction(one)).removesuffix(".0") for one in fields.entries(fields.value_of(image, "exposures"))
        ]
        if any(fields.repeated(exposures)):
            yield (i, "exposures"), exposures, fields.complaint("the same exposure was given twice")


def programme_lights(
    programme: Sequence[ProgrammeImageConfig], lights: Sequence[LightConfig]
) -> tuple[LightConfig, ...]:
    """Each image of a programme as a light."""
    known: Mapping[str, LightConfig] = {light.name: light for light in lights}
    return tuple(
        known[next(iter(image.lights))].mixed(
            image.name, [(known[name], weight) for name, weight in image.lights.items()], image.exposures
        )
        for image in programme
    )
