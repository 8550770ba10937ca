"""What a dataset randomises, and within which limits."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo

from lightopt.config import _fields as fields
from lightopt.config._fields import LIST, Frozen, expecting

_Reach = Annotated[float, Field(ge=0, le=100), expecting("a length from 0 to 100 (mm)")]
_Angle = Annotated[float, Field(ge=0, le=10), expecting("an angle from 0 to 10 (degrees)")]
_FactorEnd = Annotated[float, Field(ge=0.1, le=10)]
_Factors = Annotated[tuple[_FactorEnd, _FactorEnd], LIST, fields.ASCENDING, expecting("[low, high] from 0.1 to 10")]
_CountEnd = Annotated[int, Field(ge=0, le=200)]
_Counts = Annotated[tuple[_CountEnd, _CountEnd], LIST, fields.ASCENDING, expecting("[least, most] from 0 to 200")]
_DefectEnd = Annotated[int, Field(ge=1, le=50)]
_Defects = Annotated[tuple[_DefectEnd, _DefectEnd], LIST, fields.ASCENDING, expecting("[least, most] from 1 to 50")]
_Share = Annotated[float, Field(ge=0, le=1), expecting("a share from 0 to 1")]
_Sizes = Annotated[tuple[fields.Length, fields.Length], LIST, fields.ASCENDING, expecting("[low, high], two lengths")]
_Levels = Annotated[tuple[fields.Coefficient, fields.Coefficient], LIST, fields.ASCENDING, expecting("[low, high]")]


class PoseRangeConfig(Frozen):
    """How far the part may lie from its place: the tolerance of the fixture."""

    shift_mm: _Reach = 0.2
    """Shift along X and along Y, to either side [mm]."""
    rotation_deg: _Angle = 0.5
    """Rotation about the stage's axis, to either side [deg]."""
    lift_mm: _Reach = 0.0
    """Shift along Z, to either side [mm]."""
    tilt_deg: _Angle = 0.0
    """Tilt about X and about Y, to either side [deg]."""


class DustRangeConfig(Frozen):
    """Particles on parts, good or not. They are no defects: no label has them."""

    particles: _Counts = (0, 4)
    """Number in an image."""
    size_mm: _Sizes = (0.05, 0.2)
    """Diameter [mm], evenly by its logarithm."""
    R_d: _Levels = (20.0, 120.0)
    """Diffuse coefficient; a particle hides the surface below it and has no lobe."""


class SplitConfig(Frozen):
    """Shares of the poses whose samples train, validate and test a detector."""

    train: _Share = 0.7
    """For training."""
    val: _Share = 0.1
    """For validation."""
    test: _Share = Field(default=0.2, validate_default=True)
    """For the test; the three shares add up to 1."""

    @fields.rule("test")
    def _whole(cls, test: float, info: ValidationInfo) -> Iterator[fields.Fault]:
        total = test + info.data.get("train", 0.0) + info.data.get("val", 0.0)
        if len(info.data) == 2 and abs(total - 1.0) > 1e-6:
            yield f"expected shares train, val and test that add up to 1, found {total:g}"


class RangesConfig(fields.FileConfig):
    """Limits of a dataset's randomisation; each value is drawn evenly between its limits."""

    format: Literal["lightopt-ranges/1"]
    """Kind and version of this file: lightopt-ranges/1."""
    samples_per_pose: Annotated[int, Field(ge=1, le=1000), expecting("a whole number from 1 to 1000")] = 8
    """Samples that share a rendered pose, and with it the waviness and the width of the lobe. More are faster."""
    defective: _Share = 0.5
    """Probability that a sample has defects."""
    defects: _Defects = (1, 2)
    """Number of defects of such a sample, of the part's defect_catalogue or the built-in one."""
    pose: PoseRangeConfig = PoseRangeConfig()
    """Placement of the part, of each pose."""
    fit: Annotated[fields.Text, fields.file_of()] | None = None
    """A fit.json of fit-specular or fit-diffuse, relative to this file: R_d, R_s, lobe and gains are drawn from its
    95 % intervals, where it has them, instead of the ranges below."""
    R_d: _Factors = (0.95, 1.05)
    """Factor on the diffuse light, of each sample."""
    R_s: _Factors = (0.95, 1.05)
    """Factor on the specular light, of each sample."""
    sigma: _Factors = (0.97, 1.03)
    """Factor on the width of the lobe, of each pose."""
    gain: _Factors = (0.97, 1.03)
    """Factor on the brightness of each light in each sample; a calibrated rig's own 95 % intervals come first."""
    dust: DustRangeConfig = DustRangeConfig()
    """Particles, of each sample."""
    split: SplitConfig = SplitConfig()
    """How samples are divided; those of a pose stay together."""
