"""Patterns of a light: stripes that move from image to image, or pictures."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from lightopt.config import _fields as fields

MOST_PICTURES = 64

_Picture = Annotated[fields.Text, fields.file_of(".png")]


class PatternConfig(fields.Frozen):
    """Stripes that move by steps of a period, one image for each step and direction; or pictures, each an image."""

    variants = fields.Variants(
        "kind",
        {
            "sine": ((), ("period_mm", "period_deg", "second_period_mm", "phases", "directions")),
            "bars": ((), ("period_mm", "shifts", "duty", "directions")),
            "bitmap": (("files",), ()),
        },
    )

    kind: Literal["sine", "bars", "bitmap"] = "sine"
    """Kind of pattern: sine, of levels from black to full; bars, full or black; bitmap, pictures."""
    period_mm: fields.Length | None = None
    """sine and bars of a display or backlight: length of a period [mm]."""
    period_deg: Annotated[float, Field(gt=0, le=360), fields.expecting("degrees above 0 up to 360")] | None = None
    """sine of a dome: period of azimuth (u) and elevation (v), from its centre; whole numbers make 360 [deg]."""
    second_period_mm: fields.Length | None = None
    """sine: length of the period of as many further images of each direction, longer than period_mm [mm]: both phases
    together give the place on the display; no such images if absent."""
    phases: Annotated[int, Field(ge=3, le=64), fields.expecting("a whole number from 3 to 64: fewer give no phase")] = 4
    """sine: images of each direction, each moved by period / phases."""
    shifts: Annotated[int, Field(ge=1, le=64), fields.expecting("a whole number from 1 to 64")] = 4
    """bars: images of each direction, each moved by period / shifts."""
    duty: Annotated[float, Field(gt=0, lt=1), fields.expecting("a number between 0 and 1")] = 0.5
    """bars: share of a period that is bright."""
    directions: Annotated[tuple[Literal["u", "v"], ...], Field(strict=False, min_length=1, max_length=2)] = ("u", "v")
    """Directions that the stripes change along: u along the azimuth, v along the elevation."""
    files: Annotated[tuple[_Picture, ...], Field(strict=False, min_length=1, max_length=MOST_PICTURES)] | None = None
    """bitmap: grey PNG pictures relative to this file, each an image. Their levels are shares of the full radiance,
    as seen from the part with v upwards."""

    @field_validator("period_deg")
    @classmethod
    def _seamless(cls, period: float | None) -> float | None:
        if period is not None and abs(360.0 / period - round(360.0 / period)) > 1e-9:
            raise fields.complaint(f"a whole number of periods makes 360 degrees, found {360.0 / period:.4g} of them")
        return period

    @fields.rule("second_period_mm")
    def _longer(cls, second: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        first = info.data.get("period_mm")
        if second is not None and first is not None and second <= first:
            yield f"expected more than period_mm, {first:g}"

    @property
    def periods_mm(self) -> tuple[float, ...]:
        """One period, or both [mm]; none of a dome's pattern and of pictures."""
        return tuple(period for period in (self.period_mm, self.second_period_mm) if period is not None)

    @property
    def unambiguous_mm(self) -> float:
        """Length on the display after which the phases repeat, as far as noise lets them differ [mm]."""
        first, last = self.periods_mm[0], self.periods_mm[-1]
        return first if first == last else max(last, first * last / (last - first))

    @property
    def steps(self) -> int:
        """Images of each direction and period."""
        return self.phases if self.kind == "sine" else self.shifts

    @property
    def images(self) -> int:
        if self.files is not None:
            return len(self.files)
        return self.steps * len(self.directions) * max(1, len(self.periods_mm))


def pattern_misfits(kind: str, light: Mapping[str, Any]) -> Iterator[fields.Complaint]:
    """What does not fit together of the pattern of a kind of light, by the path under the light."""
    if light.get("pattern") is None:
        return
    pattern = {key: value for key, value in fields.mapping(light["pattern"]).items() if value is not None}
    of_dome, shape = kind == "dome", pattern.get("kind", "sine")
    if of_dome and shape in ("bars", "bitmap"):
        yield ("pattern", "kind"), "a dome shows stripes of kind sine only"
    needed = "period_deg" if of_dome else "period_mm"
    if needed not in pattern and shape in ("sine", "bars"):
        reason = f'missing key "{needed}", which a pattern of kind {shape} of a {kind} needs'
        yield ("pattern", needed), fields.absent(reason, needed)
    for key in ("period_mm", "second_period_mm") if of_dome else ("period_deg",):
        if key in pattern and shape == "sine":
            other = "period_deg, the period seen from its centre" if of_dome else "period_mm"
            yield ("pattern", key), f"a {kind} has {other}; leave this out"
    for key in ("segments", "leak"):
        if of_dome and light.get(key) is not None:
            yield (key,), "a dome with a pattern has no segments and no leak"
    size = [side for side in fields.entries(light.get("size_mm")) if isinstance(side, (int, float))]
    lengths = [one for key in ("period_mm", "second_period_mm") if isinstance(one := pattern.get(key), (int, float))]
    if len(lengths) == 2 and 0 < lengths[0] < lengths[1] and len(size) == 2:
        unambiguous = PatternConfig(period_mm=lengths[0], second_period_mm=lengths[1]).unambiguous_mm
        if unambiguous < max(size) + lengths[0]:
            reason = f"the phases repeat after {unambiguous:.4g} mm; expected at least the display's longer side and a"
            reason += f" period, {max(size) + lengths[0]:g} mm: a longer second period, or one closer to period_mm"
            yield ("pattern", "second_period_mm"), reason
