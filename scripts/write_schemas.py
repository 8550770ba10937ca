"""Write configs/schema/rig.json, part.json and batch.json from the models of lightopt.config."""

from __future__ import annotations

import json
from pathlib import Path

from lightopt.config import json_schema

FOLDER = Path(__file__).parent.parent / "configs" / "schema"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for kind in ("rig", "part", "batch"):
        text = json.dumps(json_schema(kind), indent=2, ensure_ascii=False) + "\n"
        path = FOLDER / f"{kind}.json"
        path.write_text(text, encoding="utf-8", newline="\n")
        print(path)


if __name__ == "__main__":
    main()
