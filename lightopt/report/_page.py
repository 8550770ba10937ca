"""What a page of a report is made of: plain values, no markup. :func:`lightopt.report.page_html` makes it a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lightopt.report._surface import ColouredSurface


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A sentence that stands out: a figure, and what it is of."""

    figure: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Note:
    """A paragraph."""

    text: str


@dataclass(frozen=True, kw_only=True)
class Warnings:
    """What the reader must know before relying on the rest; nothing is shown where there are none."""

    texts: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Names and their values."""

    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Attributes
    ----------
    header
        One text per column.
    rows
        Texts.
    numbers_from
        Columns from this one on are numbers, aligned to the right.
    caption
        Below the table.
    links
        Per row where its first cell leads, a file's name relative to the page with ``/`` between folders, empty for
        nowhere; none at all where there are none.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers_from: int = 1
    caption: str = ""
    links: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture.

    Attributes
    ----------
    png
        The bytes of a PNG file.
    alt
        What it shows, for those who cannot see it.
    caption
        Below the picture.
    """

    png: bytes
    alt: str
    caption: str = ""


@dataclass(frozen=True, kw_only=True)
class Gallery:
    """Pictures in a table: a row's name and its pictures, None where there is none."""

    header: Sequence[str]
    rows: Sequence[tuple[str, Sequence[Picture | None]]]
    caption: str = ""


@dataclass(frozen=True, kw_only=True)
class SurfaceView:
    """A surface to turn, with a legend.

    Attributes
    ----------
    surface
        In the colours of its layers.
    alt
        What it shows.
    caption
        Below it.
    """

    surface: ColouredSurface
    alt: str
    caption: str = ""


Block = Answer | Note | Warnings | Facts | Table | Picture | Gallery | SurfaceView


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading and what is below it."""

    heading: str
    blocks: Sequence[Block]


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page of a report.

    Attributes
    ----------
    title, subtitle
        At the top.
    lead
        Before the first heading: the answer.
    sections
        From top to bottom.
    """

    title: str
    subtitle: str
    lead: Sequence[Block]
    sections: Sequence[Section]
