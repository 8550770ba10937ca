from __future__ import annotations

import json
from enum import Enum
from typing import Annotated

import typer

from lightopt.cli._terminal import say


class _Kind(str, Enum):
    rig = "rig"
    part = "part"


def schema(
    kind: Annotated[_Kind, typer.Argument(metavar="rig|part", help="Which kind of file.")],
) -> None:
    """Print the JSON schema of a rig or part file, for editors and other programs.

    An editor with the YAML language server uses it after a first line such as
    # yaml-language-server: $schema=rig.json
    """
    from lightopt.config import json_schema

    say(json.dumps(json_schema(kind.value), indent=2, ensure_ascii=False))
