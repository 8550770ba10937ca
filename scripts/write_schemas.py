"""Write the schemas in configs/schema from the models of lightopt.config."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

from lightopt.config import FileKind, json_schema

FOLDER = Path(__file__).parent.parent / "configs" / "schema"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for kind in get_args(FileKind):
        text = json.dumps(json_schema(kind), indent=2, ensure_ascii=False) + "\n"
        path = FOLDER / f"{kind}.json"
        path.write_text(text, encoding="utf-8", newline="\n")
        print(path)


if __name__ == "__main__":
    main()
