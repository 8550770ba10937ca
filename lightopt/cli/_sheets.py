from collections.abc import Sequence
from pathlib import Path

from lightopt.cli._terminal import echo


def add_sheets(folder: Path, *, exposures: Sequence[float], title: str, force: bool, quiet: bool) -> None:
    """Add a contact sheet per exposure to an image set, and print where they are."""
    from lightopt.report import add_contact_sheets

    sheets = add_contact_sheets(folder, exposures=exposures, title=title, overwrite=force)
    for exposure, path in zip(exposures, sheets, strict=True):
        if not quiet:
            echo(f"contact sheet, exposure {exposure:g}: {path}")
