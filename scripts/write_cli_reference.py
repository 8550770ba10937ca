"""Write docs/reference/command-line.md from the command line itself."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import typer

from lightopt.cli._common import heading
from lightopt.cli._main import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "command-line.md"
INTRO = """# Command line

Every command leaves with an [exit status](conventions.md#provenance-and-exit-statuses). `--help` shows the same texts
as this page. `python scripts/write_cli_reference.py` writes it.
"""


def page() -> str:
    """The page as Markdown."""
    parts = [INTRO]
    for name, command in sorted(typer.main.get_command(app).commands.items()):  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        if inner is None:
            parts.append(_section(f"lightopt {name}", command))
        else:
            parts.append(f"## lightopt {name}\n\n{_text(command.help)}\n")
            parts += [_section(f"lightopt {name} {sub}", one, "###") for sub, one in sorted(inner.items())]
    return "\n".join(parts)


def _section(name: str, command: Any, mark: str = "##") -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    usage = " ".join([name, *(_metavar(p) for p in arguments), "[OPTIONS]"])
    table = ["| argument or option | meaning |", "|---|---|"]
    table += [f"| `{_metavar(p)}` | {_cell(getattr(p, 'help', '') or '')} |" for p in arguments]
    sections: dict[str, list[str]] = {"Options": []}
    for p in command.params:
        if p not in arguments:
            row = f"| {_option(p)} | {_cell(p.help or '')}{_default(p)} |"
            sections.setdefault(heading(p), []).append(row)
    for title, rows in sections.items():
        if rows:
            table += [f"| **{title}** | |"] if title != "Options" else []
            table += rows
    return f"{mark} {name}\n\n```text\n{usage}\n```\n\n{_text(command.help)}\n\n" + "\n".join(table) + "\n"


def _metavar(parameter: Any) -> str:
    text = (parameter.metavar or parameter.name).upper().strip("[]…")
    text += "..." if parameter.nargs == -1 else ""
    return text if parameter.required else f"[{text}]"


def _option(parameter: Any) -> str:
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    return names if parameter.is_flag else f"{names} {_cell(parameter.metavar)}"


def _default(parameter: Any) -> str:
    if isinstance(parameter.show_default, str):
        return f" Default: {parameter.show_default}."
    if parameter.is_flag and parameter.secondary_opts:
        return f" Default: `{(parameter.opts if parameter.default else parameter.secondary_opts)[0]}`."
    shown = parameter.show_default and parameter.default not in (None, False, ()) and not parameter.is_flag
    return f" Default: {parameter.default}." if shown else ""


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", _escaped(text)).replace("|", "\\|").strip()


def _text(text: str | None) -> str:
    return _escaped((text or "").strip())


def _escaped(text: str) -> str:
    return re.sub(r"([*_<\[])", r"\\\1", text)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8", newline="\n")
    print(PAGE)
