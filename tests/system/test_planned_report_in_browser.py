"""The reports of a search for defects and of a plan as a person sees them in Chromium: on a screen and on paper."""

from __future__ import annotations

import io
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from browsers import Opened, opened
from PIL import Image
from planned import made_once, prepared

from lightopt.cli._main import run
from lightopt.design import share_text
from lightopt.report._page import Page, Table, page_html


@pytest.fixture(scope="module")
def inspected(shared_bench, tmp_path_factory) -> Path:
    """The report of a search for defects, of a small rig whose lights move."""
    bench = prepared(type(shared_bench).make(tmp_path_factory.mktemp("inspected") / "bench"))
    command = ["optimize", str(bench.rig), str(bench.part), "-o", str(bench.out), "-q"]
    few = ("--patches", "80", "--step", "10")
    assert run([*command, *few, "--objective", "detectability", "--objective", "coverage"]) == 0
    return bench.out / "report.html"


@pytest.fixture(scope="module")
def planned(shared_bench, tmp_path_factory) -> Path:
    return made_once(tmp_path_factory, type(shared_bench)).out / "report.html"


def result_of(report: Path):
    return json.loads((report.parent / "result.json").read_text(encoding="utf-8"))


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.float64).reshape(-1, 3)


def shown_colours(seen: Opened, png: bytes) -> set[str]:
    """Labels of the visible legend whose colours, at some brightness, a picture shows."""
    found = pixels(png)
    found = found[(found < 250).any(axis=1)]
    found /= np.linalg.norm(found, axis=1, keepdims=True) + 1e-9
    labels = set[str]()
    for item in seen.page.locator(".legend:not([hidden]) li").all():
        style = item.locator(".swatch").get_attribute("style")
        assert style is not None
        red, green, blue = (int(style[style.index("#") + k :][:2], 16) for k in (1, 3, 5))
        colour = np.array([red, green, blue], float)
        if (found @ (colour / np.linalg.norm(colour)) > 0.9995).sum() > 200:
            labels.add(item.locator("span").nth(1).inner_text())
    return labels


def table_under(seen: Opened, heading: str, number: int = 0) -> list[list[str]]:
    """Header and rows of a table in the section of a heading, with plain spaces."""
    section = seen.page.locator("section").filter(has=seen.page.get_by_role("heading", name=heading, exact=True))
    rows = section.locator("table").nth(number).locator("tr").all()
    return [[text.replace("\u00a0", " ") for text in row.locator("th, td").all_inner_texts()] for row in rows]


def check_once_and_silent(seen: Opened, report: Path) -> None:
    """One surface, one legend, all pictures there, nothing wider than a screen or a telephone, nobody asked."""
    page = seen.page
    page.wait_for_selector("figure[data-state=live]")
    assert page.locator("figure.surface").count() == 1
    assert page.locator("canvas").count() == 1
    assert sum(legend.is_visible() for legend in page.locator(".legend").all()) == 1
    assert page.locator("fieldset legend").all_inner_texts() == ["Defects", "Levels of the images"]
    for picture in page.locator("img").all():
        assert picture.evaluate("image => image.complete && image.naturalWidth > 1")
    for width in (1200, 420):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), width
    page.set_viewport_size({"width": 1200, "height": 900})
    own = [report.resolve().as_uri()]
    assert [url for url in seen.requested if not url.startswith(("data:", "blob:"))] == own
    assert seen.said == []


def check_surface(seen: Opened) -> None:
    """The part is there in the colours of its legend, and other layers have other colours and legends."""
    page, canvas = seen.page, seen.page.locator("canvas")
    shares = canvas.screenshot()
    assert len(shown_colours(seen, shares)) >= 2
    page.get_by_role("radio", name="all postures, why not", exact=True).check()
    reasons = canvas.screenshot()
    assert reasons != shares
    assert any(label.startswith("contrast under noise") for label in shown_colours(seen, reasons))
    page.get_by_role("radio", name="the best of all postures").check()
    assert "saturated in two images or more" in page.inner_text(".legend:not([hidden])")
    assert canvas.screenshot() != reasons
    page.get_by_role("radio", name="all postures, how many defects are seen").check()
    assert canvas.screenshot() == shares


def check_rig_drawing(seen: Opened) -> None:
    """The drawing of the rig is visible and drawn upon."""
    drawing = seen.page.locator("img[alt^='The rig']").first
    assert drawing.is_visible()
    drawn = pixels(drawing.screenshot())
    assert (drawn < 200).any(axis=1).mean() > 0.005
    assert len(np.unique(drawn.astype(np.uint8), axis=0)) > 20


def check_paper(seen: Opened) -> None:
    """On paper a still picture, the legend of what it shows, all tables, no controls."""
    page = seen.page
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert not page.locator("canvas").is_visible()
    assert not any(control.is_visible() for control in page.locator(".controls").all())
    assert len(shown_colours(seen, page.locator("img.still").screenshot())) >= 2
    assert sum(legend.is_visible() for legend in page.locator(".legend").all()) == 1
    assert all(table.is_visible() for table in page.locator("table").all())
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf())) >= 2
    assert seen.said == []


def check_blind_spots(seen: Opened, report: Path) -> None:
    """The table of blind spots has the result's shares."""
    spots = result_of(report)["blind_spots"]
    header, *rows = table_under(seen, "Blind spots")
    assert header[:3] == ["posture", "lights", "found"]
    for row, side in zip(rows[:2], ("chosen", "any_position"), strict=True):
        assert row[2] == share_text(spots[side]["seen"], spots["grain"])
        for entry in spots[side]["blind"]:
            assert row[header.index(entry["reason"])] == share_text(entry["share"], spots["grain"])


@pytest.mark.slow
def test_the_report_of_a_search_for_defects(inspected):
    with opened(inspected) as seen:
        check_once_and_silent(seen, inspected)
        check_surface(seen)
        check_rig_drawing(seen)
        check_blind_spots(seen, inspected)
        answers = seen.page.locator("p.answer").all_inner_texts()
        shares = [
            share_text(one["objectives"][0]["share_of_inspectable_area"], one["grain"])
            for one in result_of(inspected)["results"]
        ]
        assert [text.split(" of")[0] for text in answers] == shares
        header, *rows = table_under(seen, "Defects")
        best = result_of(inspected)["results"][0]
        first = best["objectives"][0]
        assert [rows[0][header.index(name)] for name in first["defects"]] == [
            share_text(share, best["grain"]) for share in first["defects"].values()
        ]
        check_paper(seen)


def test_the_scores_of_several_objectives_are_no_wider_than_the_page(tmp_path):
    lights = ["50°,\u00a045°", "45°,\u00a0135°", "50°,\u00a0225°", "50°,\u00a0315°"]
    names = [*(f"light{k}" for k in range(1, 5)), "detectability", "paper"]
    first = ["1,339\u00a0mm² (66.3\u00a0%)", "4,717,061", "23.1 %", *["not counted"] * 3]
    other = ["1,157\u00a0mm² (57.3\u00a0%)", "5,994,229", "23.1 %", "−166,197", "0 / 2,299", "2,401"]
    table = Table(
        header=["posture", "best for", *names, "left out", "runner-up", "ties / near best", "combinations"],
        rows=[["all 3 postures", "detectability", *lights, *first], ["all 3 postures", "paper", *lights, *other]],
        numbers_from=2,
    )
    page = Page(title="Scores", subtitle="", lead=[table], sections=[])
    (tmp_path / "page.html").write_text(page_html(page), encoding="utf-8")
    with opened(tmp_path / "page.html", width=1400) as seen:
        wide = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth).length"
        assert seen.page.locator(".scroll").count() == 1
        assert seen.page.evaluate(wide) == 0


@pytest.mark.slow
def test_the_report_of_a_plan(planned):
    result = result_of(planned)
    chosen = result["chosen_postures"]
    text = partial(share_text, grain=chosen["patches"]["grain"])
    with opened(planned) as seen:
        check_once_and_silent(seen, planned)
        check_surface(seen)
        check_rig_drawing(seen)
        check_blind_spots(seen, planned)
        assert seen.page.inner_text("p.answer").startswith(text(chosen["share"]))
        # postures, what each adds
        _, *rows = table_under(seen, "Postures")
        assert sorted(row[1:] for row in rows) == [
            [f"{number}", ", ".join(f"{x:.9g}" for x in one["exposures"]), text(one["gain"]), text(one["share"])]
            for number, one in enumerate(chosen["postures"], start=1)
        ]
        # one order everywhere: that of the capture
        order = [f"({p['elevation_deg']:g}°, {p['rotation_deg']:g}°)" for p in chosen["order_of_travel"]]
        assert [row[0] for row in rows] == order
        assert ", ".join(order) in seen.page.inner_text("p.answer")
        # exposures, whether planned or not
        _, *rows = table_under(seen, "Exposures")
        assert [row[1:] for row in rows] == [
            [f"{one['exposure']:g}", text(one["gain"]), "yes" if one["planned"] else "no"]
            for one in result["exposures"]["shots"]
        ]
        # tolerances, of each posture and of all
        header, worst, *_ = table_under(seen, "Tolerances of the angles")
        assert header[-1] == "all 2 postures"
        assert worst[1:] == [
            share_text(one["worst_corner"]["share_of_score"], one["grain"]) for one in result["tolerances"]
        ]
        # the commands that carry it out
        for command in result["commands"]:
            assert seen.page.get_by_text(command, exact=True).first.is_visible()
        check_paper(seen)
