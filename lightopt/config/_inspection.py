"""What a part file says of its inspection: from when on a part is no good."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lightopt.config._fields import Frozen, expecting

_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False), expecting("a number from 0 to 1")]


class InspectionConfig(Frozen):
    """Limits that `lightopt inspect` says OK or NG by."""

    most_defects: Annotated[int, Field(ge=0, le=10**6), expecting("a whole number from 0 to 1000000")] = (
        Field(default=0, description="A part with more defects than this is no good.")
    )
    least_size_mm: Annotated[
        float, Field(ge=0, le=1e3, allow_inf_nan=False), expecting("a number from 0 to 1000 (mm)")
    ] = Field(default=0.0, description="Defects shorter than this do not count [mm].")
    least_contrast: _Share = Field(
        default=0.0,
        description="Defects that change the light by less than this share, under the light that shows them best, do "
        "not count.",
    )
    least_inspected: _Share = Field(
        default=0.0,
        description="A part of whose visible surface, over all postures, less than this share could be inspected, if "
        "only for glints, is no good.",
    )
