import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli._options import Force, make_folder
from lightopt.cli._terminal import echo
from lightopt.core.errors import InputError


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to write them; made if missing.")],
    force: Force = False,
) -> None:
    """Write a commented rig, part and sample mesh to start from.

    Then: lightopt check DIR/rig.yaml DIR/part.yaml
    """
    import json
    from importlib.resources import files

    from lightopt.config import json_schema
    from lightopt.images import write_bytes_atomic

    samples = files("lightopt.samples")

    def text(name: str) -> bytes:
        content = samples.joinpath(name).read_text(encoding="utf-8")
        return content.replace("$schema=../schema/", "$schema=").encode()

    # the schemas lie beside the files here
    outputs = {
        "rig.yaml": text("rigs/four-panel.yaml"),
        "part.yaml": text("parts/cover-knob.yaml"),
        "cover-knob.step": samples.joinpath("parts/cover-knob.step").read_bytes(),
        "rig.json": (json.dumps(json_schema("rig"), indent=2, ensure_ascii=False) + "\n").encode(),
        "part.json": (json.dumps(json_schema("part"), indent=2, ensure_ascii=False) + "\n").encode(),
    }
    taken = [name for name in outputs if (folder / name).exists()]
    if taken and not force:
        raise InputError(
            f"{folder} already has {', '.join(taken)}; use --force to replace them, or choose another folder"
        )
    make_folder(folder)
    for name, content in outputs.items():
        write_bytes_atomic(folder / name, content)
        echo(f"{folder / name}")
    echo(f"next: lightopt check {folder / 'rig.yaml'} {folder / 'part.yaml'}")


class _Kind(str, Enum):
    rig = "rig"
    part = "part"


def schema(kind: Annotated[_Kind, typer.Argument(metavar="rig|part", help="Which kind of file.")]) -> None:
    """Print the JSON schema of a rig or part file, for editors and other programs.

    An editor with the YAML language server uses it after a first line such as
    # yaml-language-server: $schema=rig.json
    """
    from lightopt.config import json_schema

    echo(json.dumps(json_schema(kind.value), indent=2, ensure_ascii=False))
