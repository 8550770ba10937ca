"""The setting sheet of a design, the images of the best set, and the score against the angles."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from lightopt import design
from lightopt.core.errors import InputError, counted
from lightopt.images import ImageEntry, ImageSet, read_image_set, read_png
from lightopt.report import _pictures as pictures
from lightopt.report._contact_sheet import degrees, entry_thumbnail, light_position, saturation_text
from lightopt.report._page import Block, Gallery, Note, Picture, Table
from lightopt.report._rig_drawing import rig_image
from lightopt.report.design._plan import postures_text
from lightopt.rig.capture import cycle_time

SIDE = 300  # longest side of an image in the report [px]


def capture_text(result: design.DesignResult) -> str:
    """How many images and seconds a part takes with the lights of a design, or why that is unknown."""
    answered = [one for one in result.results if one.answers[0].nothing is None]
    exposures = {posture: result.plan.exposures_of(posture) for one in answered for posture in one.postures}
    if len({one.answers[0].found.best.candidates for one in answered}) != 1:
        images = len(result.candidates.names) * sum(map(len, exposures.values()))
        return f"{counted(images, 'image')} per part; the lights have to be moved between postures"
    try:
        return str(cycle_time(result.rig, result.part, exposures))
    except InputError as error:
        return f"these postures and exposures cannot be captured on this rig: {error.messages[0]}"


def setting_blocks(output: design.DesignOutput) -> list[Block]:
    """A table of the lights for each set of positions, and a drawing of the rig with the first set."""
    sets: dict[tuple[int, ...], list[design.SetResult]] = {}
    for result in output.result.results:
        if result.answers[0].nothing is None:
            sets.setdefault(result.answers[0].found.best.candidates, []).append(result)
    text = f"The postures have {len(sets)} different sets of positions: move the lights between the postures."
    blocks: list[Block] = [Note(text=text)] if len(sets) > 1 else []
    blocks += [_setting_table(output.result, results, name_postures=len(sets) > 1) for results in sets.values()]
    return [*blocks, *(_setting_drawing(output.result, results) for results in list(sets.values())[:1])]


def _setting_table(whole: design.DesignResult, results: Sequence[design.SetResult], *, name_postures: bool) -> Table:
    rows: list[list[str]] = []
    best = results[0].answers[0].found.best
    panels, found = whole.candidates.panels_at(best.candidates), design.places_of(whole.candidates, best)
    for panel, place, light in zip(panels, found, whole.rig.lights, strict=True):
        now = design.place_of(light)
        centre = [f"{coordinate:.1f}".replace("-", "−") for coordinate in panel.centre]
        before = "stays" if now == place else design.place_text(now)
        angles = degrees(place[0]), degrees(place[1])
        rows.append([panel.name, *angles, f"{panel.distance:g} mm", ", ".join(centre), before])
    caption = (
        "Elevation from the table plane, azimuth about Z from +X towards +Y, distance from the table's centre to the "
        "panel's centre. Each panel faces the table's centre."
    )
    if name_postures:
        caption = f"For {', '.join(postures_text(result.postures) for result in results)}. {caption}"
    header = ["light", "elevation", "azimuth", "distance", "centre of the panel X, Y, Z [mm]", "now"]
    return Table(header=header, rows=rows, caption=caption)


def _setting_drawing(whole: design.DesignResult, results: Sequence[design.SetResult]) -> Picture:
    best = results[0].answers[0].found.best
    postures = tuple(posture for result in results for posture in result.postures)
    lights = zip(whole.candidates.names, design.places_of(whole.candidates, best), strict=True)
    places = "; ".join(f"{name} {design.place_text(place)}" for name, place in lights)
    scene = replace(whole.scene, lights=whole.candidates.panels_at(best.candidates), postures=postures)
    caption = f"The rig with the lights there, the part in {postures[0]}."
    return Picture(png=pictures.png_bytes(rig_image(scene)), alt=f"The rig: {places}", caption=caption)


def image_blocks(output: design.DesignOutput) -> list[Block]:
    """The images that the camera would deliver, a row for each posture, and where their highlights overlap."""
    sets = [read_image_set(output.result.folder / one["folder"], verify=False) for one in output.document["images"]]
    if not sets:
        return [Note(text="Not rendered: images were switched off.")]
    maps = {
        (overlap.posture, overlap.exposure): _overlap_map(output.result.folder / listed["map"], overlap.pixels)
        for listed, overlap in zip(output.document["overlaps"], output.overlaps, strict=True)
    }
    rows: list[tuple[str, list[Picture | None]]] = []
    for images in sets:
        shots = dict.fromkeys((entry.posture, entry.exposure) for entry in images.images)
        levels = {entry.exposure for entry in images.images}
        for posture, exposure in shots:
            own = [one for one in images.images if (one.posture, one.exposure) == (posture, exposure)]
            each = [_picture(images, one) for one in own]
            # one light has no others for its highlights to overlap with
            together = [maps[posture, exposure]] if maps else []
            at = f", exposure {exposure:.9g}" * (levels != {1.0})
            rows.append((f"posture {posture}{at}", [*each, *together]))
    which = "the planned exposures" if output.document.get("exposures") else "exposure 1"
    right = " On the right: blue where one image is saturated, red where several are." * bool(maps)
    header = [*output.result.candidates.names, *(["highlights together"] if maps else [])]
    caption = (
        f"What the camera would deliver at {which}; red: saturated pixels.{right} Images are averaged down, counts are "
        "of the full ones."
    )
    return [Gallery(header=header, rows=rows, caption=caption)]


def _overlap_map(path: Path, pixels: int) -> Picture:
    png = pictures.png_bytes(pictures.shrunk(read_png(path, colour=True), limit=SIDE))
    return Picture(png=png, alt="Map of the highlights", caption=f"{pixels:,} px saturated in two or more")


def _picture(images: ImageSet, entry: ImageEntry) -> Picture:
    small, at = entry_thumbnail(images, entry, SIDE), light_position(entry)
    png = pictures.png_bytes(small.picture)
    return Picture(png=png, alt=f"{entry.light} at {at}", caption=f"{at}; {saturation_text(small)}")


def curve_blocks(output: design.DesignOutput) -> list[Block]:
    """The score against angles and distances, one chart for each set and axis."""
    charts = [
        _chart(result, axis, curves)
        for result in output.result.results
        for axis in design.AXES
        if (curves := [curve for curve in result.curves if curve.axis == axis])
    ]
    text = (
        "The score as one light moves and all else stays as in the best set; or, where it says so, with all lights "
        "that move at the same elevation. Where a curve stays near the best score the choice is free."
    )
    return [Note(text=text), *charts] if charts else []


@pictures.fixed_style()
def _chart(result: design.SetResult, axis: str, curves: list[design.Curve]) -> Picture:
    best = result.answers[0]
    where = postures_text(result.postures)
    area = best.objective.share_of is not None
    surface = f"inspectable surface{' × defects' * isinstance(best.objective, design.DetectabilityObjective)}"
    label = f"% of the {surface}" if area else best.objective.unit
    figure, (panel,) = pictures.chart(
        title=f"{best.objective.name}, {where}",
        x_label=f"{axis} [{'mm' if axis == 'distance' else '°'}]",
        labels=[f"score [{label}]"],
    )
    for curve, colour in zip(curves, itertools.cycle(pictures.COLOURS)):
        shares = [best.objective.share_of_whole(score, result.area) for score in curve.scores]
        scores = [score if share is None else 100.0 * share for score, share in zip(curve.scores, shares, strict=True)]
        panel.plot(curve.values, scores, ".-", color=colour, label=pictures.printable(curve.name))
    pictures.name_lines(panel)
    names = ", ".join(curve.name for curve in curves)
    png = pictures.png_bytes(pictures.figure_image(figure))
    return Picture(png=png, alt=f"Score against {axis} for {where}: {names}")
