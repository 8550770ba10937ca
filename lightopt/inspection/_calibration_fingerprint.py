"""What a calibration holds for: all that the scores of an inspection depend on, as hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.provenance import file_sha256
from lightopt.inspection._options import InspectOptions


def made_for(rig: RigConfig, part: PartConfig, options: InspectOptions) -> dict[str, Any]:
    """All that scores depend on, as hashes, and the options: not names, limits of the verdict, or lists of defects."""
    of_part = {
        "name": True,
        "postures": True,
        "mesh": {"file"},
        "inspection": True,
        "defects": True,
        "defect_catalogue": True,
    }
    ranges = {"elevation_range_deg", "azimuth_range_deg"}
    chosen: dict[str, Any] = {
        "detector": options.detector,
        "no_shift": not options.shift,
    }
    chosen |= {"fusion": options.fusion} if options.detector == "template" else {"seen_by": options.seen_by}
    return {
        "rig": _hash(
            {
                "camera": rig.camera.model_dump(mode="json"),
                "light_source": rig.light_source.model_dump(mode="json"),
                "lights": [light.model_dump(mode="json", exclude=ranges) for light in rig.lights],
                "pivot_mm": list(rig.stage.pivot_mm),
            }
        ),
        "part": _hash(part.model_dump(mode="json", exclude=of_part)),
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "options": chosen,
    }


def _hash(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
