"""How commands show their options."""

from typing import Any

import typer.core


class HeadedCommand(typer.core.TyperCommand):
    """A command whose ``--help`` has a section for each heading of its options, in plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections: arguments, options without a heading, and the headings as they first occur."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                sections.setdefault(heading(parameter), []).append(record)
        for name, records in sections.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)


def heading(parameter: Any) -> str:
    """Of the section that an argument or option belongs to."""
    if parameter.param_type_name == "argument":
        return "Arguments"
    return getattr(parameter, "rich_help_panel", None) or "Options"
