"""Pages, tables and charts of ``lightopt calibrate`` and ``lightopt verify``; printable boards.

A calibration: what was measured and how well, where it does not fit, what would help. A verification: the answer, the
causes, each light, pictures of what differs; runs over time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lightopt.config import BoardTargetConfig
from lightopt.core.arrays import Float32
from lightopt.core.errors import InputError, counted
from lightopt.estimate.rig_calibration import BoardFit, Measured, RigCalibration, white_areas
from lightopt.estimate.verification import Finding, LightComparison, Verification
from lightopt.images import write_bytes_atomic
from lightopt.images.comparison import diverging
from lightopt.report import _page, _pictures as pictures
from lightopt.scene import build_lights

_MM_PER_INCH = 25.4
_PAPERS = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}  # landscape [mm]
_BORDER = 10.0  # that printers leave white [mm]
_CAPTION = 16.0  # height below the board for scale bar and text [mm]
_DPI = 600.0  # of a PNG


def calibration_lines(found: RigCalibration) -> list[tuple[str, str]]:
    """What was measured and how well, one line each: what it is of, and the figures."""
    lines: list[tuple[str, str]] = []
    if (board := found.board) is not None:
        half = {name: 0.5 * (high - low) for name, (low, high) in board.intervals.items()}
        focal, error = found.camera.image_distance / found.camera.pixel_size, half["camera.focal_px"]
        position = math.hypot(half["tilt_axis.position_y"], half["tilt_axis.position_z"])
        lines += [
            ("camera", f"pixels predicted to {board.predicted_rms:.2g} px, focal length {focal:.0f} ± {error:.2g} px"),
            ("stage", f"tilt axis known to {half['tilt_axis.elevation']:.2g}° and {position:.2g} mm"),
        ]
    if (ball := found.ball) is not None:
        place = float(np.linalg.norm(ball.half_widths_95[:, :3], axis=1).max())
        turn = math.degrees(float(np.linalg.norm(ball.half_widths_95[:, 3:5], axis=1).max()))
        lines.append(("panels", f"{counted(len(ball.lights), 'panel')} known to {place:.2g} mm and {turn:.2g}°"))
    if (plate := found.plate) is not None:
        share = 100.0 * max(_half(gain) / gain.value for gain in plate.gains)
        decided = "" if plate.fall_off_decided else " (as filed: not decided)"
        lines.append(("light", f"gains known to {share:.2g} %, fall-off {plate.fall_off}{decided}"))
    if (sensor := found.sensor) is not None:
        electrons, black = sensor.electrons_per_level, sensor.black_level.value
        text = f"{electrons.value:.4g} electrons per level ± {100.0 * _half(electrons) / electrons.value:.2g} %"
        lines.append(("sensor", f"{text}, read noise {sensor.read_noise_levels.value:.3g}, black level {black:.3g}"))
    return lines


def _half(measured: Measured) -> float:
    low, high = measured.interval_95
    return 0.5 * (high - low)


def calibration_report(found: RigCalibration, figures: Mapping[str, Any]) -> str:
    """The page as HTML; `figures` is the content of calibration.json."""
    lead: list[_page.Block] = [
        _page.Answer(figure=f"{what.capitalize()}:", text=text) for what, text in calibration_lines(found)
    ]
    if unobservable := found.unobservable:
        lead.append(
            _page.Warnings(texts=[f"the images do not show {name}; it is near the rig file" for name in unobservable])
        )
    lead.append(_page.Warnings(texts=found.warnings))
    rows = [[name, f"{low:.6g}", f"{high:.6g}"] for name, (low, high) in figures["intervals_95"].items()]
    values = _page.Section(heading="Intervals", blocks=[_page.Table(header=["value", "from", "to"], rows=rows)])
    subtitle = f"{found.rig.source.path.name}; intervals hold with a probability of 95 %"
    title = f"Calibration of {found.rig.name}"
    return _page.page_html(_page.Page(title=title, subtitle=subtitle, lead=lead, sections=[*_sections(found), values]))


def _sections(found: RigCalibration) -> Iterator[_page.Section]:
    if (board := found.board) is not None:
        rows: list[list[str]] = []
        for view in board.residuals:
            pixels = f"{view.median:.3f}", f"{view.rms:.3f}"
            fault = "does not fit" if view.faulty else ""
            rows.append([str(view.posture), str(view.corners), *pixels, str(view.outliers), fault])
        header = ["posture", "corners", "median [px]", "rms [px]", "left out", ""]
        shown = "Found less predicted corners of all views, on the image; a pattern means another lens or a bent board."
        png = pictures.png_bytes(residual_map(board, found.camera.width, found.camera.height))
        picture = _page.Picture(png=png, alt=shown, caption=shown)
        blocks: list[_page.Block] = [picture, _page.Table(header=header, rows=rows)]
        if board.next_posture is not None:
            posture, rms = board.next_posture
            predicted = f"pixels would be predicted to {rms:.2g} px instead of {board.predicted_rms:.2g} px"
            blocks.append(_page.Note(text=f"Of further postures {posture} would help most: {predicted}."))
        yield _page.Section(heading="Camera and stage", blocks=blocks)
    if (ball := found.ball) is not None:
        header = ["light", "centre [mm]", "±", "direction ± [°]", "size [mm]", "moved by [mm]"]
        filed = {light.name: light for light in build_lights(found.rig)}
        rows = []
        for light, width in zip(ball.lights, ball.half_widths_95, strict=True):
            centre, size = ", ".join(f"{c:.2f}" for c in light.centre), " × ".join(f"{side:.2f}" for side in light.size)
            place, turn = float(np.linalg.norm(width[:3])), math.degrees(float(np.linalg.norm(width[3:5])))
            moved = float(np.linalg.norm(light.centre - filed[light.name].centre))
            rows.append([light.name, centre, f"{place:.2f}", f"{turn:.2f}", size, f"{moved:.2f}"])
        texts = [f"Left out, since it fits no pose: {name} at {posture}." for posture, name in ball.left_out]
        left_out = [_page.Note(text=text) for text in texts]
        fit = _page.Note(text=f"Residuals, in the errors claimed: {ball.rms:.2f}.")
        yield _page.Section(heading="Panels", blocks=[_page.Table(header=header, rows=rows), fit, *left_out])
    if (plate := found.plate) is not None:
        rows = [
            [light.name, f"{gain.value:.4f}", f"{_half(gain):.4f}"]
            for light, gain in zip(found.lights, plate.gains, strict=True)
        ]
        exponent = plate.emission_exponent
        v2, v4 = (f"{'−' if term.value < 0.0 else '+'} {abs(term.value):.4f}" for term in plate.vignetting)
        decided = "" if plate.fall_off_decided else ", as filed: not decided"
        facts = [
            ("fall-off", plate.fall_off + decided),
            ("emission exponent", f"{exponent.value:.2f} ± {_half(exponent):.2f}"),
            ("vignetting", f"1 {v2}·ρ² {v4}·ρ⁴"),
            ("residuals, in the errors claimed", f"{plate.rms:.2f}"),
        ]
        yield _page.Section(
            heading="Light", blocks=[_page.Table(header=["light", "gain", "±"], rows=rows), _page.Facts(rows=facts)]
        )
    if (sensor := found.sensor) is not None:
        columns = sensor.exposures, sensor.means, sensor.variances, sensor.fitted
        rows = [
            [f"{exposure:.4g}", f"{mean:.2f}", f"{variance:.3f}", "" if fitted else "left out"]
            for exposure, mean, variance, fitted in zip(*columns, strict=True)
        ]
        header = ["exposure", "level above black", "variance [levels²]", ""]
        facts = [("deviation from a straight line", f"{sensor.linearity_error:.2g} % of the range")]
        yield _page.Section(
            heading="Sensor", blocks=[_page.Table(header=header, rows=rows, numbers_from=0), _page.Facts(rows=facts)]
        )


@pictures.fixed_style()
def residual_map(board: BoardFit, width: int, height: int) -> Image.Image:
    """Found less predicted corners of all views as arrows on the image, with a scale."""
    from matplotlib.figure import Figure

    pixels = np.concatenate([view.pixels for view in board.residuals])
    offsets = np.concatenate([view.offsets for view in board.residuals])
    usual = max(float(np.median(np.hypot(*offsets.T))), 1e-3)
    figure = Figure(figsize=(9.0, 9.0 * height / width + 0.4))
    axes = figure.add_subplot()
    arrows = axes.quiver(
        *pixels.T, offsets[:, 0], -offsets[:, 1], angles="uv", scale=usual * 40.0, width=0.0015, color="#1c1f24"
    )
    axes.quiverkey(arrows, 0.9, 1.03, 2.0 * usual, f"{2.0 * usual:.2g} px", labelpos="E")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="column [px]", ylabel="row [px]")
    return pictures.figure_image(figure)


def board_sheet(target: BoardTargetConfig, path: str | Path, *, paper: str | None = None) -> None:
    """Draw a ChArUco board in true size as PDF or PNG, with a scale bar and its parameters. Needs OpenCV.

    paper: a4, a3 or letter, landscape; by default a sheet just large enough. Print without scaling, and measure the
        bar and both pitches
    Raises InputError: Another kind of file or paper, or the board is larger than the paper
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png"):
        raise InputError(f"{path}: expected a name that ends with .pdf or .png")
    columns, rows = target.squares
    width, height = columns * target.square_mm, rows * target.square_mm
    least = width + 2.0 * _BORDER, height + 2.0 * _BORDER + _CAPTION
    if paper is not None and paper.lower() not in _PAPERS:
        raise InputError(f"paper {paper}: expected {', '.join(_PAPERS)}")
    sheet = least if paper is None else _PAPERS[paper.lower()]
    if sheet[0] < least[0] or sheet[1] < least[1]:
        raise InputError(
            f"the board needs {least[0]:g} × {least[1]:g} mm, and {paper} has {sheet[0]:g} × {sheet[1]:g} mm. Choose "
            "larger paper, or smaller or fewer squares"
        )
    with pictures.fixed_style():
        figure = Figure(figsize=(sheet[0] / _MM_PER_INCH, sheet[1] / _MM_PER_INCH), dpi=_DPI, facecolor="white")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        # board frame in the middle of the sheet above the caption, 1 unit is 1 mm
        below = 0.5 * (sheet[1] + _CAPTION)
        axes.set_xlim(-0.5 * sheet[0], 0.5 * sheet[0])
        axes.set_ylim(-below, sheet[1] - below)
        black: dict[str, Any] = {"color": "black", "linewidth": 0.0, "antialiased": False}
        axes.fill(*_rectangle(-0.5 * width, -0.5 * height, 0.5 * width, 0.5 * height), **black)
        white = [list(zip(*_rectangle(*area), strict=True)) for area in white_areas(target)]
        axes.add_collection(PolyCollection(white, facecolors="white", linewidths=0.0, antialiaseds=False))
        bar = max(length for length in (100.0, 50.0, 20.0, 10.0, 5.0) if length <= max(width, 5.0))
        left, line = -0.5 * width, -0.5 * height - 4.0
        axes.fill(*_rectangle(left, line - 1.0, left + bar, line), **black)
        sides = f"squares {target.square_mm:g} mm, markers {target.marker_mm:g} mm"
        legacy = ", legacy pattern" if target.legacy_pattern else ""
        text = f"The bar is {bar:g} mm long. {columns} × {rows} {sides}, {target.dictionary}{legacy}"
        axes.text(left, line - 3.0, text, fontsize=min(7.0, 0.05 * width), va="top")
        drawn = BytesIO()
        figure.savefig(drawn, format=kind, dpi=_DPI)
    write_bytes_atomic(path, drawn.getvalue())


def _rectangle(left: float, bottom: float, right: float, top: float) -> tuple[list[float], list[float]]:
    return [left, right, right, left], [bottom, bottom, top, top]


FULL_COLOUR = 10.0  # standard deviations
MOST_PX = 300  # no side of a picture is longer


def findings_table(result: Verification) -> _page.Table:
    """Causes with their sizes and limits, those that exceed them first."""

    def cells(one: Finding) -> list[str]:
        return [one.cause, one.amount, one.limit_text, "beyond" if one.exceeds else "within"]

    return _page.Table(header=["cause", "size", "limit", ""], rows=list(map(cells, result.findings)), numbers_from=4)


def lights_table(result: Verification) -> _page.Table:
    """Predicted against captured, a row for each light."""

    def cells(one: LightComparison) -> list[str]:
        overlap = "-" if one.overlap is None else f"{one.overlap:.3f}"
        rest = (one.offset_px, one.offset_deg, one.residual, one.explained)
        return [one.light, overlap, *("-" if value is None else f"{value:.2f}" for value in rest)]

    return _page.Table(
        header=["light", "overlap (IoU)", "offset [px]", "offset [°]", "residual/noise", "explained"],
        rows=[cells(one) for one in result.lights],
        caption="Overlap of saturated areas; offset of the highlights, in the image and as a direction of light; "
        "residual over noise, and the same with the causes in the prediction.",
    )


def verification_report(result: Verification, *, part: str, rig: str, provenance: Mapping[str, Any]) -> str:
    """The report as HTML; `part` and `rig` are names, `provenance` is that of the result folder."""
    remedies = [f"To tell {f.cause}: {f.remedy}." for f in result.findings if f.remedy]
    unseen = "Not observable in these images: " + (", ".join(result.unseen) or "nothing") + "."
    inputs: Mapping[str, Any] = provenance["inputs"]
    facts = [(name, f"{inputs[name]['file']}, sha256 {inputs[name]['sha256'][:16]}") for name in ("rig", "part")]
    facts.append(("compared with", "a known good set" if "baseline" in inputs else "the model"))
    facts += [(f"limit {name}", f"{value:g}") for name, value in vars(result.limits).items()]
    word = "Within tolerances" if result.within_tolerances else "Out of tolerances"
    causes = findings_table(result) if result.findings else _page.Note(text="Nothing differs.")
    sections = [
        _page.Section(heading="Causes", blocks=[causes, *(_page.Note(text=text) for text in (*remedies, unseen))]),
        _page.Section(heading="Lights", blocks=[lights_table(result)]),
        _page.Section(heading="What differs", blocks=[_gallery(result, 0, "as the rig file has it")]),
        _page.Section(heading="What the causes leave", blocks=[_gallery(result, 1, "with the causes")]),
        _page.Section(heading="Inputs and limits", blocks=[_page.Facts(rows=facts)]),
    ]
    lead = [_page.Answer(figure=word, text=result.answer), _page.Warnings(texts=result.warnings)]
    subtitle = f"{part} on {rig}, lightopt {provenance['lightopt']}"
    return _page.page_html(_page.Page(title=f"{word}: {rig}", subtitle=subtitle, lead=lead, sections=sections))


def _gallery(result: Verification, number: int, what: str) -> _page.Gallery:
    lights = list(dict.fromkeys(light for _, light, _ in result.differences))
    rows = dict.fromkeys((posture, exposure) for posture, _, exposure in result.differences)
    several = len({exposure for _, exposure in rows}) > 1
    table: list[tuple[str, list[_page.Picture | None]]] = []
    for posture, exposure in rows:
        found = [result.differences.get((posture, light, exposure)) for light in lights]
        pictures = [_picture(one, number, light) for one, light in zip(found, lights, strict=True)]
        table.append((f"posture {posture}{f' ×{exposure:g}' if several else ''}", pictures))
    return _page.Gallery(
        header=lights,
        rows=table,
        caption=f"Captured minus predicted {what}: blue darker, red brighter, full colour at {FULL_COLOUR:g} standard "
        "deviations of noise and model; white where equal, saturated or off the part.",
    )


def _picture(difference: Float32 | None, number: int, light: str) -> _page.Picture | None:
    if difference is None:
        return None
    pixels = pictures.shrunk(diverging(np.clip(difference[number] / FULL_COLOUR, -1.0, 1.0)), limit=MOST_PX)
    return _page.Picture(png=pictures.png_bytes(pixels), alt=f"captured minus predicted, {light}")


@pictures.fixed_style()
def history_chart(rows: Sequence[Mapping[str, str]], path: Path) -> Path:
    """Draw the rows of ``append_history``: faults as shares of their limits, offset and residual of each light."""
    labels = ("size of each fault over its limit", "offset of the highlights [px]", "residual over noise")
    figure, panels = pictures.chart(title="Verifications of the rig", x_label="run", labels=labels)
    kinds = (("/limit", 0.0), (" offset_px", math.nan), (" residual", math.nan))
    for panel, (suffix, missing) in zip(panels, kinds, strict=True):
        names = list(dict.fromkeys(name for row in rows for name in row if name.endswith(suffix)))
        for number, name in enumerate(names):
            values = [float(row.get(name) or missing) for row in rows]
            label, color = name.removesuffix(suffix), pictures.COLOURS[number % len(pictures.COLOURS)]
            panel.plot(range(1, len(rows) + 1), values, ".-", color=color, label=label)
        if names:
            pictures.name_lines(panel)
    panels[0].axhline(1.0, color=pictures.MARK, linestyle="--")
    pictures.label_whole_numbers(panels[-1].xaxis)
    return pictures.write_picture(path, pictures.figure_image(figure))
