"""What a page of a report is made of: plain values, no markup; and the page as one HTML file.

Style, scripts, pictures and surfaces are in the file, and it asks the network for nothing.
"""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from itertools import groupby
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightopt.core.arrays import Bool
from lightopt.report import _surface as surfaces
from lightopt.report._pictures import png_bytes, thumbnail
from lightopt.report._surface import ColouredSurface, SurfaceLayer

# the browser itself then refuses every request
POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
KEYS = "Drag to turn, wheel to zoom, right button to move; keys on the picture: arrows, + and −, Home."
WIDE = 8  # tables of more columns have narrow margins, and their cells may take several lines


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A sentence that stands out: a figure, and what it is of."""

    figure: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Note:
    text: str


@dataclass(frozen=True, kw_only=True)
class Warnings:
    """What the reader must know before relying on the rest; nothing is shown where there are none."""

    texts: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class Facts:
    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, kw_only=True)
class Table:
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers_from: int = 1  # columns from this one on are numbers, aligned to the right
    caption: str = ""
    # per row the file that its first cell leads to, relative to the page and with / between folders, empty for none; no
    # links at all where no row has one
    links: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture: the bytes of a PNG file, and what it shows for those who cannot see it."""

    png: bytes
    alt: str
    caption: str = ""


def camera_picture(level: NDArray[np.floating], saturated: Bool, *, limit: int, alt: str, caption: str) -> Picture:
    """An image of the camera as :func:`lightopt.report._pictures.thumbnail` makes it small."""
    small = thumbnail(level, saturated, limit=limit)
    return Picture(png=png_bytes(small.picture), alt=alt, caption=caption)


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
    """A heading and what is below it; on paper with `own_page` it has a page of its own."""

    heading: str
    blocks: Sequence[Block]
    own_page: bool = False


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page of a report; `lead` is what stands before the first heading: the answer."""

    title: str
    subtitle: str
    lead: Sequence[Block]
    sections: Sequence[Section]


def page_html(page: Page) -> str:
    """The page as HTML, the same for the same page, without empty sections; escaped, as names may contain anything."""
    sections = [section for section in page.sections if section.blocks]
    links = [f'<a href="#s{i}">{escape(section.heading)}</a>' for i, section in enumerate(sections, start=1)]
    parts = [*map(_block, page.lead), f'<nav aria-label="Contents">{" ".join(links)}</nav>']
    for i, section in enumerate(sections, start=1):
        own = ' class="own-page"' * section.own_page
        heading = f'<section id="s{i}"{own}>', f"<h2>{escape(section.heading)}</h2>"
        parts += [*heading, *map(_block, section.blocks), "</section>"]
    parts += ["</main>"]
    blocks = (*page.lead, *(block for section in sections for block in section.blocks))
    if any(isinstance(block, SurfaceView) for block in blocks):
        parts += [f"<script>\n{_asset(name)}</script>" for name in ("three.bundle.min.js", "viewer.js")]
    body = "\n".join(parts)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(page.title)}</title>
<style>
{_asset("page.css")}</style>
</head>
<body>
<header>
<h1>{escape(page.title)}</h1>
<p class="subtitle">{escape(page.subtitle)}</p>
</header>
<main>
{body}
</body>
</html>
"""


def _asset(name: str) -> str:
    return files("lightopt.report").joinpath("viewer").joinpath(name).read_text(encoding="utf-8")


def _block(block: Block) -> str:
    match block:
        case Answer(figure=figure, text=text):
            return f'<p class="answer"><strong>{escape(figure)}</strong> {escape(text)}</p>'
        case Note(text=text):
            return f"<p>{escape(text)}</p>"
        case Warnings(texts=texts):
            items = "".join(f"<li>{escape(text)}</li>" for text in texts)
            return f'<div class="warnings" role="note"><strong>Warnings</strong><ul>{items}</ul></div>' if items else ""
        case Facts(rows=rows):
            cells = (f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>' for name, value in rows)
            return f'<table class="facts"><tbody>{"".join(cells)}</tbody></table>'
        case Table():
            return _table(block)
        case Picture():
            return f'<figure class="picture">{_image(block)}{_optional("figcaption", block.caption)}</figure>'
        case Gallery():
            return _gallery(block)
        case SurfaceView():
            return _surface(block)


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str, href: str = "") -> str:
        # a line does not end before a unit of one character, or after a sign
        texts = [escape(cell).replace(" %", "\u00a0%").replace("&lt; ", "&lt;\u00a0") for cell in cells]
        if href:
            texts[0] = f'<a href="{quote(href)}">{texts[0]}</a>'
        begins = [f"<{tag}{' class=number' if i >= table.numbers_from else ''}>" for i in range(len(texts))]
        return f"<tr>{''.join(f'{begin}{text}</{tag}>' for begin, text in zip(begins, texts, strict=True))}</tr>"

    links = table.links or [""] * len(table.rows)
    body = "\n".join(row(cells, "td", href) for cells, href in zip(table.rows, links, strict=True))
    wide = ' class="wide"' if len(table.header) > WIDE else ""
    return _scrolling(wide, table.caption, row(table.header, "th"), body)


def _scrolling(attributes: str, caption: str, head: str, body: str) -> str:
    return (
        f'<div class="scroll"><table{attributes}>{_optional("caption", caption)}<thead>{head}</thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def _gallery(gallery: Gallery) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in ("", *gallery.header))
    rows: list[str] = []
    for name, pictures in gallery.rows:
        notes = [one and f"{_image(one)}<span class=note>{escape(one.caption)}</span>" for one in pictures]
        cells = "".join(f"<td>{note or ''}</td>" for note in notes)
        rows.append(f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>')
    return _scrolling(' class="gallery"', gallery.caption, f"<tr>{head}</tr>", "\n".join(rows))


def _image(picture: Picture, *, css: str = "") -> str:
    with Image.open(io.BytesIO(picture.png)) as image:
        width, height = image.size
    data = base64.b64encode(picture.png).decode("ascii")
    alt = escape(picture.alt)
    return f'<img{css} width="{width}" height="{height}" alt="{alt}" src="data:image/png;base64,{data}">'


def _optional(tag: str, text: str) -> str:
    return f"<{tag}>{escape(text)}</{tag}>" if text else ""


def _surface(view: SurfaceView) -> str:
    surface, grid = surfaces.simplified(view.surface)
    still = _image(Picture(png=png_bytes(surfaces.surface_still(surface)), alt=view.alt), css=' class="still"')
    caption = view.caption
    if grid:
        caption += (
            f" Drawn with {len(surface.triangles):,} of {len(view.surface.triangles):,} faces, their corners moved "
            f"to a grid of {grid:.3g} mm; areas are of all faces."
        )
    layers = view.surface.layers
    chooser = f"<form>{_chooser(layers)}</form>" if len(layers) > 1 else ""
    legends = "".join(_legend(layer, k) for k, layer in enumerate(layers))
    return f"""<figure class="surface">
<div class="view"><div class="stage">
<canvas tabindex="0" role="img" aria-label="{escape(view.alt)}. {escape(KEYS)}"></canvas>
{still}
<p class="note fallback" hidden>This browser shows no WebGL: the picture is a still one<span class="reason"></span>.</p>
</div><div class="side">
<div class="controls">{chooser}</div>
{legends}
<div class="controls"><button type="button" class="home">First view</button>
<p class="note">{escape(KEYS)}</p></div>
</div></div>
{_optional("figcaption", caption.strip())}
<script type="application/json" class="head">{surfaces.surface_head(surface)}</script>
<script type="application/octet-stream" class="data">{surfaces.surface_data(surface)}</script>
</figure>"""


def _chooser(layers: Sequence[SurfaceLayer]) -> str:
    parts: list[str] = []
    for group, some in groupby(enumerate(layers), key=lambda pair: pair[1].group):
        choices = "".join(
            f'<label><input type="radio" name="layer" value="{k}"{" checked" if k == 0 else ""}> '
            f"{escape(layer.name)}</label>"
            for k, layer in some
        )
        parts.append(f"<fieldset><legend>{escape(group or 'Shown')}</legend>{choices}</fieldset>")
    return "".join(parts)


def _legend(layer: SurfaceLayer, number: int) -> str:
    items = "".join(
        f'<li><span class="swatch" style="background:{escape(kind.colour)}"></span>'
        f'<span>{escape(kind.label)}</span><span class="amount">{escape(kind.amount)}</span></li>'
        for kind in layer.classes
    )
    hidden = " hidden" if number else ""
    name = escape(f"{layer.group}: {layer.name}" if layer.group else layer.name)
    return f'<ul class="legend" data-layer="{number}" aria-label="{name}"{hidden}>{items}</ul>'
