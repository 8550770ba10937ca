"""JSON schemas of the files, for editors and other programs."""

from __future__ import annotations

from typing import Any, Literal

from lightopt.config._part import PartConfig
from lightopt.config._rig import RigConfig


def json_schema(kind: Literal["rig", "part"]) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of rig or part files, generated from the models.

    Rules that tie keys together are not in it; :func:`load_rig` and :func:`load_part` check those too.

    Raises ValueError: For another kind
    """
    models = {"rig": RigConfig, "part": PartConfig}
    if kind not in models:
        raise ValueError(f"there are schemas of {', '.join(models)}, not of {kind}")
    schema = models[kind].model_json_schema()
    for model in (schema, *schema["$defs"].values()):
        for field in model["properties"].values():
            field.pop("title", None)  # only the key again, in capitals
    schema["title"] = f"lightopt {kind}"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
