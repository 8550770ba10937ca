"""HTML pages of reports: whole, escaped, the same bytes for the same page, surfaces packed to a step."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from lightopt.core.errors import InputError
from lightopt.geometry import TriangleMesh, refine
from lightopt.report._page import (
    Answer,
    Facts,
    Gallery,
    Note,
    Page,
    Picture,
    Section,
    SurfaceView,
    Table,
    Warnings,
    page_html,
)
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer, simplified, surface_data, surface_head

VIEWER = Path(__file__).resolve().parents[2] / "lightopt" / "report" / "viewer"
NASTY = "<script>alert('x')</script> & \"quoted\" ß 日本 </title>"


def png(side: int = 4) -> bytes:
    data = io.BytesIO()
    Image.new("RGB", (side, side), "#123456").save(data, "PNG")
    return data.getvalue()


def surface(faces: int = 3000) -> ColouredSurface:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=25.0)
    mesh = TriangleMesh(vertices=ball.vertices, faces=ball.faces.astype(np.int32))
    patches = refine(mesh, max_edge_mm=190.0 / np.sqrt(faces), max_patches=1 << 20)
    count = len(patches.triangles)
    kinds = (SurfaceClass(label=NASTY, colour="#56b4e9"), SurfaceClass(label="b", colour="#d55e00"))
    return ColouredSurface(
        vertices=patches.vertices + np.array([3.0, -200.0, 7.0]),
        triangles=patches.triangles,
        layers=(
            SurfaceLayer(name=NASTY, classes=kinds, of_face=(patches.centroids[:, 2] > 0).astype(np.uint8)),
            SurfaceLayer(name="zero", classes=kinds, of_face=np.zeros(count, np.uint8)),
        ),
        up=np.array([0.0, 0.0, 1.0]),
        toward=np.array([1.0, 0.0, 0.0]),
    )


def nasty_page() -> Page:
    picture = Picture(png=png(), alt=NASTY, caption=NASTY)
    blocks = [
        Note(text=NASTY),
        Warnings(texts=[NASTY]),
        Warnings(texts=[]),
        Facts(rows=[(NASTY, NASTY)]),
        Table(header=[NASTY, "n"], rows=[[NASTY, "1"]], caption=NASTY),
        picture,
        Gallery(header=[NASTY], rows=[(NASTY, [picture, None])], caption=NASTY),
        SurfaceView(surface=surface(), alt=NASTY, caption=NASTY),
    ]
    return Page(
        title=NASTY,
        subtitle=NASTY,
        lead=[Answer(figure=NASTY, text=NASTY)],
        sections=[Section(heading=NASTY, blocks=blocks)],
    )


class Reader(HTMLParser):
    """Elements, their attributes, and the text outside of scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "input", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.texts.append((self.open[-1], data))


@pytest.fixture(scope="module")
def read() -> Reader:
    reader = Reader()
    reader.feed(page_html(nasty_page()))
    reader.close()
    return reader


def test_names_are_text_and_nothing_else(read):
    assert read.open == [], "every element is closed"
    scripts = [attributes for tag, attributes in read.seen if tag == "script"]
    assert len(scripts) == 4, "head and data of the surface, the library, the viewer"
    joined = "".join(text for _, text in read.texts)
    # title, heading, subtitle, answer (2), contents, section, note, warning, facts (2), table (3), caption, gallery (4)
    assert joined.count(NASTY) >= 18
    titles = [text for tag, text in read.texts if tag == "title"]
    assert "".join(titles) == NASTY
    assert [a["alt"] for tag, a in read.seen if tag == "img"] == [NASTY] * 3


def test_nothing_is_fetched(read):
    for tag, attributes in read.seen:
        assert tag not in ("link", "iframe", "object", "embed", "base"), tag
        for name in ("src", "srcset", "data", "action", "poster"):
            assert str(attributes.get(name, "data:")).startswith("data:"), (tag, name)
        assert str(attributes.get("href", "#")).startswith("#")
        assert "url(" not in str(attributes.get("style", ""))
    policy = next(a["content"] for t, a in read.seen if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy
    assert "url(" not in (VIEWER / "page.css").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_same_page_gives_the_same_text():
    assert page_html(nasty_page()) == page_html(nasty_page())


def test_a_page_without_a_surface_carries_no_viewer():
    page = Page(title="t", subtitle="s", lead=[], sections=[Section(heading="h", blocks=[Note(text="n")])])
    assert len(page_html(page)) < 20_000


def unpack(whole: ColouredSurface):
    head = json.loads(surface_head(whole))
    data = zlib.decompress(base64.b64decode(surface_data(whole)))
    m, n = head["triangles"], head["vertices"]
    assert len(data) == 12 * m + 6 * n + m * len(head["layers"])
    corners = np.cumsum(np.frombuffer(data, "<i4", 3 * m).reshape(3, m), axis=1, dtype=np.int32).T
    steps = np.frombuffer(data, "<i2", 3 * n, 12 * m).reshape(3, n)
    places = np.cumsum(steps, axis=1, dtype=np.int16).T * head["step_mm"]
    layers = np.frombuffer(data, np.uint8, m * len(head["layers"]), 12 * m + 6 * n).reshape(-1, m)
    return head, places, corners, layers


def test_a_packed_surface_is_the_surface_to_a_step():
    whole = surface()
    head, places, corners, layers = unpack(whole)
    middle = 0.5 * (whole.vertices.min(axis=0) + whole.vertices.max(axis=0))
    assert head["step_mm"] == pytest.approx(25.0 / 32767, rel=0.01)
    assert np.abs(places - (whole.vertices - middle)).max() <= 0.51 * head["step_mm"]
    assert np.array_equal(corners, whole.triangles)
    assert np.array_equal(layers[0], whole.layers[0].of_face)
    assert head["layers"] == [["#56b4e9", "#d55e00"]] * 2


def test_surfaces_that_are_too_large_are_simplified_and_say_so():
    whole = surface(20_000)
    small, grid = simplified(whole, most=5000)
    assert 2000 < len(small.triangles) <= 5000
    assert grid > 0
    # what is left lies on the ball, and each face has the class of where it was
    radii = np.linalg.norm(small.vertices - [3.0, -200.0, 7.0], axis=1)
    assert np.abs(radii - 25.0).max() < grid * np.sqrt(3.0) / 2 + 0.05
    heights = small.vertices[small.triangles].mean(axis=1)[:, 2] - 7.0
    clear = np.abs(heights) > grid
    assert np.array_equal((heights > 0)[clear], small.layers[0].of_face[clear] == 1)
    same, none = simplified(whole)
    assert same is whole
    assert none == 0.0


def test_layers_must_fit_their_surface():
    kinds = (SurfaceClass(label="a", colour="#000000"),)
    with pytest.raises(InputError, match="expected uint8 below 1"):
        SurfaceLayer(name="l", classes=kinds, of_face=np.ones(3, np.uint8))
    layer = SurfaceLayer(name="l", classes=kinds, of_face=np.zeros(3, np.uint8))
    with pytest.raises(InputError, match="3 classes for 1 faces"):
        ColouredSurface(
            vertices=np.eye(3),
            triangles=np.array([[0, 1, 2]], np.int32),
            layers=(layer,),
            up=np.array([0.0, 0, 1]),
            toward=np.array([1.0, 0, 0]),
        )


@pytest.mark.slow
def test_two_hundred_thousand_patches_stay_below_eight_megabytes():
    whole = surface(250_000)
    assert len(whole.triangles) > 200_000
    page = Page(
        title="t", subtitle="s", lead=[], sections=[Section(heading="h", blocks=[SurfaceView(surface=whole, alt="a")])]
    )
    assert len(page_html(page).encode()) < 8_000_000


def test_the_bundled_library_is_the_one_that_the_readme_names():
    readme = (VIEWER / "README.md").read_text(encoding="utf-8")
    bundle = (VIEWER / "three.bundle.min.js").read_bytes()
    assert hashlib.sha256(bundle).hexdigest() in readme
    versions = re.search(r"three\.js\]\(\S+\) (\S+) with .* esbuild (\S+);", readme)
    script = (VIEWER.parents[2] / "scripts" / "vendor_three.py").read_text(encoding="utf-8")
    assert f'THREE, ESBUILD = "{versions[1]}", "{versions[2]}"' in script
    license_text = (VIEWER / "LICENSE.three.txt").read_text(encoding="utf-8").strip()
    assert license_text in bundle.decode("utf-8"), "the licence travels with every report"
    assert "</script" not in bundle.decode("utf-8").lower()
