"""The setting sheet: the angles and distances to set each light to, and one drawing of the rig, on one printed page."""

from dataclasses import replace

from lightopt.core.errors import InputError, counted
from lightopt.design import DesignOutput, DesignResult, SetResult, angles_of
from lightopt.report._contact_sheet import degrees
from lightopt.report._images import png_bytes
from lightopt.report._page import Block, Note, Picture, Table
from lightopt.report._rig_drawing import rig_image
from lightopt.report.design._plan import postures_text
from lightopt.rig.capture import cycle_time


def capture_text(result: DesignResult) -> str:
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


def setting_blocks(output: DesignOutput) -> list[Block]:
    """A table of the lights for each set of positions, and a drawing of the rig with the first set."""
    sets: dict[tuple[int, ...], list[SetResult]] = {}
    for result in output.result.results:
        if result.answers[0].nothing is None:
            sets.setdefault(result.answers[0].found.best.candidates, []).append(result)
    blocks: list[Block] = []
    if len(sets) > 1:
        text = f"The postures have {len(sets)} different sets of positions: move the lights between the postures."
        blocks.append(Note(text=text))
    for best, results in sets.items():
        blocks.append(_table(output, best, results, name_postures=len(sets) > 1))
    blocks += [_drawing(output, best, results) for best, results in list(sets.items())[:1]]
    return blocks


def _table(output: DesignOutput, best: tuple[int, ...], results: list[SetResult], *, name_postures: bool) -> Table:
    rows: list[list[str]] = []
    found = angles_of(output.result.candidates, results[0].answers[0].found.best)
    panels = output.result.candidates.panels_at(best)
    for panel, (elevation, azimuth), light in zip(panels, found, output.result.rig.lights, strict=True):
        now = (light.elevation_deg, light.azimuth_deg)
        centre = [f"{coordinate:.1f}" for coordinate in panel.centre]
        before = "stays" if now == (elevation, azimuth) else f"{degrees(now[0])}, {degrees(now[1])}"
        angles = degrees(elevation), degrees(azimuth)
        rows.append([panel.name, *angles, f"{panel.distance:g} mm", ", ".join(centre), before])
    postures = ", ".join(postures_text(result.postures) for result in results)
    caption = (
        "Elevation from the table plane, azimuth about Z from +X towards +Y, distance from the table's centre to the "
        "panel's centre. Each panel faces the table's centre."
    )
    header = ["light", "elevation", "azimuth", "distance", "centre of the panel X, Y, Z [mm]", "now"]
    return Table(header=header, rows=rows, caption=f"For {postures}. {caption}" if name_postures else caption)


def _drawing(output: DesignOutput, best: tuple[int, ...], results: list[SetResult]) -> Picture:
    panels = output.result.candidates.panels_at(best)
    postures = tuple(posture for result in results for posture in result.postures)
    found = angles_of(output.result.candidates, results[0].answers[0].found.best)
    angles = "; ".join(
        f"{panel.name} {degrees(elevation)}, {degrees(azimuth)}"
        for panel, (elevation, azimuth) in zip(panels, found, strict=True)
    )
    return Picture(
        png=png_bytes(rig_image(replace(output.result.scene, lights=panels, postures=postures))),
        alt=f"The rig: {angles}",
        caption=f"The rig with these angles, the part in {postures[0]}.",
    )
