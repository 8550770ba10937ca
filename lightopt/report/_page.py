"""What a page of a report is made of: plain values, no markup. :func:`page_html` makes it a file."""

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
    """A table of texts.

    numbers_from: Columns from this one on are numbers, aligned to the right
    links: Per row the file that its first cell leads to, relative to the page and with ``/`` between folders, empty
        for none; no links at all where no row has one
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers_from: int = 1
    caption: str = ""
    links: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture: the bytes of a PNG file, and what it shows for those who cannot see it."""

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
    """A surface to turn, with a legend."""

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
    """A page of a report; `lead` is what stands before the first heading: the answer."""

    title: str
    subtitle: str
    lead: Sequence[Block]
    sections: Sequence[Section]
