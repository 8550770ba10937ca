"""A report as a person sees it: opened in Chromium, turned, printed, without WebGL; silent, and alone in the world."""

from __future__ import annotations

import io
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from browsers import opened
from PIL import Image

from lightopt.report._page import Answer, Page, Section, SurfaceView, page_html
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer

BLUE, ORANGE, GREY = "#56b4e9", "#d55e00", "#c9ced6"


def octahedron() -> ColouredSurface:
    """Its four upper faces blue and orange by turns, or all of them orange; its lower ones grey."""
    corners = 20.0 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    faces = [[k, (k + 1) % 4, 4] for k in range(4)] + [[(k + 1) % 4, k, 5] for k in range(4)]
    kinds = (
        SurfaceClass(label="covered <b>", colour=BLUE, amount="50 %"),
        SurfaceClass(label="saturated", colour=ORANGE),
        SurfaceClass(label="not seen", colour=GREY),
    )
    return ColouredSurface(
        vertices=corners + np.array([100.0, 0.0, 5.0]),
        triangles=np.array(faces, np.int32),
        layers=(
            SurfaceLayer(name="all postures", classes=kinds, of_face=np.array([0, 1, 0, 1, 2, 2, 2, 2], np.uint8)),
            SurfaceLayer(name="(0°, 82°)", classes=kinds, of_face=np.array([1, 1, 1, 1, 2, 2, 2, 2], np.uint8)),
        ),
        up=np.array([0.0, 0.0, 1.0]),
        toward=np.array([0.6, 0.0, 0.8]),
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    page = Page(
        title="knob on rig",
        subtitle="nothing else",
        lead=[Answer(figure="92.1 %", text="is covered")],
        sections=[Section(heading="The part", blocks=[SurfaceView(surface=octahedron(), alt="The part")])],
    )
    path = tmp_path_factory.mktemp("report") / "a report.html"
    path.write_text(page_html(page), encoding="utf-8")
    return path


def colours(png: bytes) -> Counter[str]:
    """How many pixels are nearest to each of the legend's colours at some brightness, or white."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.float64).reshape(-1, 3)
    names = {"blue": (86, 180, 233), "orange": (213, 94, 0), "grey": (201, 206, 214)}
    lit = pixels[(pixels < 250).any(axis=1)]
    units = np.array(list(names.values()), np.float64)
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    nearest = (lit @ units.T).argmax(axis=1)
    return Counter({name: int((nearest == k).sum()) for k, name in enumerate(names)})


@pytest.mark.slow
def test_it_turns_and_changes_colours_and_asks_for_nothing(report):
    with opened(report) as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=live]")
        assert page.inner_text("p.answer") == "92.1 % is covered"
        legend = page.inner_text(".legend:not([hidden])")
        assert "covered <b>" in legend
        assert "50 %" in legend
        canvas = page.locator("canvas")
        first = canvas.screenshot()
        found = colours(first)
        assert found["blue"] > 5000
        assert found["orange"] > 5000
        box = canvas.bounding_box()
        assert box["width"] / box["height"] == pytest.approx(1.5, abs=0.01)
        page.get_by_role("radio", name="(0°, 82°)").check()
        assert colours(canvas.screenshot())["blue"] == 0
        assert page.locator(".legend:not([hidden])").get_attribute("data-layer") == "1"
        page.get_by_role("radio", name="all postures").check()
        # by mouse, and back by the button
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 120, middle[1] + 40, steps=4)
        page.mouse.up()
        assert canvas.screenshot() != first
        page.get_by_role("button", name="First view").click()
        assert colours(canvas.screenshot()) == found
        # from below by keys
        canvas.focus()
        for _ in range(24):
            page.keyboard.press("ArrowDown")
        below = colours(canvas.screenshot())
        assert below["grey"] > 20 * (below["blue"] + below["orange"])
        page.keyboard.press("Home")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("ArrowRight")
        canvas.blur()  # the frame around what has the keyboard is blue
        turned = colours(canvas.screenshot())
        assert all(abs(turned[name] - found[name]) < 200 for name in found)
        assert seen.said == []
        assert [url for url in seen.requested if not url.startswith(("data:", "blob:"))] == [report.resolve().as_uri()]


@pytest.mark.slow
def test_paper_gets_a_still_picture_as_it_was_turned(report):
    with opened(report) as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=live]")
        page.get_by_role("radio", name="(0°, 82°)").check()
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        page.emulate_media(media="print")
        assert not page.locator("canvas").is_visible()
        assert not any(control.is_visible() for control in page.locator(".controls").all())
        still = page.locator("img.still")
        assert still.is_visible()
        found = colours(still.screenshot())
        assert found["orange"] > 5000
        assert found["blue"] == 0
        assert len(page.pdf()) > 10_000
        assert seen.said == []


def test_without_webgl_the_still_picture_stays_and_says_so(report):
    with opened(report, webgl=False) as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=still]")
        still = page.locator("img.still")
        assert still.is_visible()
        found = colours(still.screenshot())
        assert found["blue"] > 5000
        assert found["orange"] > 5000
        assert "no WebGL" in page.inner_text(".fallback")
        assert not page.locator("canvas").is_visible()


@pytest.mark.slow
def test_the_still_picture_shows_what_the_view_shows_first(report):
    with opened(report) as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=live]")
        live = Image.open(io.BytesIO(page.locator("canvas").screenshot())).convert("RGB")
        page.evaluate("document.querySelector('figure.surface').classList.remove('live')")
        still = Image.open(io.BytesIO(page.locator("img.still").screenshot())).convert("RGB")
        size = (300, 200)
        a, b = (np.asarray(image.resize(size), np.float64) for image in (live, still))
        # but for the edges
        assert np.quantile(np.abs(a - b), 0.97) < 12.0


@pytest.mark.slow
@pytest.mark.parametrize("images", [True, False])
def test_the_report_of_an_optimisation(bench, cli, images):
    text = bench.rig.read_text(encoding="utf-8").replace("azimuth_deg: 45}", "azimuth_deg: 45, RANGE}")
    text = text.replace("azimuth_deg: 225,", "azimuth_deg: 225, RANGE,")
    bench.rig.write_text(text.replace("RANGE", "elevation_range_deg: [40, 60]"), encoding="utf-8")
    bench.edit("part.yaml", "name: knob", "name: '<b>knob</b> & \"co\"'")
    options = [] if images else ["--no-images", "--posture", "0,0"]
    few = ("--patches", "800", "--step", "10", "-q")
    ran = cli("optimize", bench.rig, bench.part, "-o", bench.out, *few, *options)
    assert (ran.status, ran.out) == (0, "")
    result = json.loads((bench.out / "result.json").read_text(encoding="utf-8"))
    with opened(bench.out / "report.html") as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=live]")
        assert page.inner_text("h1") == 'Light positions: <b>knob</b> & "co"'
        answers = page.locator("p.answer").all_inner_texts()
        shares = [100 * one["objectives"][0]["share_of_inspectable_area"] for one in result["results"]]
        # so few patches tell no tenths
        assert all(one["grain"] >= 0.01 for one in result["results"])
        assert [text.split(" %")[0] for text in answers] == [f"{share:.0f}" for share in shares]
        found = colours(page.locator("canvas").screenshot())
        assert sum(found.values()) > 20_000
        legend = page.locator(".legend:not([hidden]) li")
        assert legend.count() == 6
        assert all(item.is_visible() for item in legend.all())
        pictures = page.locator("img").all()
        assert len(pictures) >= (1 + 2 * 3 + 1 + 1 if images else 3)
        assert all(picture.evaluate("image => image.complete && image.naturalWidth > 1") for picture in pictures)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        page.set_viewport_size({"width": 420, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), "nor on a telephone"
        assert seen.said == []
        assert [url for url in seen.requested if not url.startswith(("data:", "blob:"))] == [
            (bench.out / "report.html").resolve().as_uri()
        ]


STAIN_AND_DENT = """\
defects:
  - {name: stain, kind: stain, size_mm: 3.5, R_d_factor: 0.6,
     at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [58, 60]}}
  - {name: dent, kind: dent, size_mm: 5, slope_deg: 12,
     at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [92, 72]}}
"""


def of_itself_only(seen, path):
    assert seen.said == []
    assert [url for url in seen.requested if not url.startswith(("data:", "blob:"))] == [path.resolve().as_uri()]


@pytest.mark.slow
def test_the_reports_of_inspected_parts(bench, cli):
    bench.edit("part.yaml", "name: knob", "name: '<b>knob</b>'")
    good = bench.part.read_text(encoding="utf-8")
    bad = bench.part.with_name("bad.yaml")
    bad.write_text(good + STAIN_AND_DENT, encoding="utf-8")
    few = ("-q", "--patches", "300", "--posture", "0,0", "--noise", "3")
    assert cli("render", bench.rig, bad, "-o", bench.folder / "bad", *few).status == 0
    assert cli("render", bench.rig, bad, "-o", bench.folder / "worse", *few[:-1], "4").status == 0
    sets = (bench.folder / "bad", bench.folder / "worse")
    ran = cli("inspect", bench.rig, bench.part, *sets, "-o", bench.out, "--no-register", "--evaluate", "-q")
    assert ran.status == 0, ran.err
    ran = cli(
        "inspect", bench.rig, bench.part, sets[0], "-o", bench.folder / "one", "--no-register", "--evaluate", "-q"
    )
    assert ran.status == 0, ran.err
    one = json.loads((bench.folder / "one" / "defects.json").read_text(encoding="utf-8"))
    assert {"report.html", "truth.json"} <= set(one["files"])
    with opened(bench.folder / "one" / "report.html") as seen:
        page = seen.page
        page.wait_for_selector("figure[data-state=live]")
        assert page.inner_text("h1") == "NG: <b>knob</b>"
        assert page.inner_text("p.answer").startswith("NG ")
        found = page.locator("section", has=page.get_by_role("heading", name="Defects", exact=True))
        rows = found.locator("tbody tr")
        assert rows.count() == len(one["defects"]) == 2
        first = rows.nth(0).locator("td").all_inner_texts()
        assert first[:2] == ["1", one["defects"][0]["kind"]]
        assert first[4] == ", ".join(f"{x:.2f}" for x in one["defects"][0]["position_mm"])
        legend = page.locator(".legend:not([hidden]) li .amount").all_inner_texts()
        assert sum(map(int, filter(None, legend))) == 2
        pixels = np.asarray(Image.open(io.BytesIO(page.locator("canvas").screenshot())).convert("RGB"), np.int32)
        assert np.count_nonzero(np.ptp(pixels, axis=2) > 80) > 50, "the balls are coloured, the part is grey"
        pictures = page.locator("img").all()
        assert len(pictures) == 4  # still, overlay, without highlights, its uncertainty
        assert all(p.evaluate("image => image.complete && image.naturalWidth > 1") for p in pictures)
        surface = page.locator("section", has=page.get_by_role("heading", name="Inspected surface"))
        share = one["postures"][0]["surface"]["inspected"]
        assert f"{100 * share:.1f} %" in surface.inner_text().replace("\u00a0", " ")
        assert "2 of 2 defects in view" in page.inner_text("main")
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        of_itself_only(seen, bench.folder / "one" / "report.html")
    batch = json.loads((bench.out / "batch.json").read_text(encoding="utf-8"))
    assert batch["files"] == ["report.html", "truth.json"]
    assert [(row["folder"], row["verdict"]) for row in batch["sets"]] == [("bad", "NG"), ("worse", "NG")]
    with opened(bench.out / "report.html") as seen:
        page = seen.page
        assert page.inner_text("p.answer") == "0 of 2 parts are OK"
        parts = page.locator("section").nth(0).locator("tbody tr")
        assert [row.locator("td").nth(0).inner_text() for row in parts.all()] == ["bad", "worse"]
        assert "4 of 4 defects in view" in page.inner_text("main")
        of_itself_only(seen, bench.out / "report.html")
