"""The page and the tables of ``lightopt optimize --from-images``."""

import numpy as np

from lightopt.core.errors import percent
from lightopt.design import FromImagesResult, agreement_text, from_images_answer, synthesise
from lightopt.report import _page

_SIDE = 360  # longest side of an image [px]
_SETS = 6  # shown, defective samples first
_DEFECTS = 500  # rows


def chosen_table(result: FromImagesResult) -> _page.Table:
    rows = [
        [image.name, result.lights_text(image), f"{image.exposure:.3g}", str(found)]
        for image, found in zip(result.images, result.found_alone, strict=True)
    ]
    return _page.Table(
        header=["image", "lights", "exposure", "found alone"],
        rows=rows,
        numbers_from=2,
        caption="Lights with their brightness relative to the samples' images; exposure: relative time, as long as "
        "saturation allows; found alone: defects that the image shows without the others.",
    )


def scores_table(result: FromImagesResult) -> _page.Table:
    choice, mixture = result.choice, result.mixture
    rows = [
        ["one light per image", percent(choice.score, 2), percent(choice.bound, 2), f"{choice.scored:,}"],
        ["several lights per image", percent(mixture.score, 2), percent(mixture.bound, 2), "-"],
        ["one light, with the same noise", percent(mixture.single_score, 2), "-", "-"],
    ]
    return _page.Table(
        header=["images", "score", "at most", "choices scored"],
        rows=rows,
        caption="Score: 90 % for defects found (in part for those below the threshold), 10 % for margin. At most: no "
        f"choice exceeds it. Choices of single lights in all: {choice.total:,}. Several lights are scored with the "
        "noise of the exposures that are taken, and the last row has one light per image scored alike.",
    )


def defects_table(result: FromImagesResult, most: int = _DEFECTS) -> _page.Table:
    """The defects, the least visible first."""
    gains = result.gains
    order = np.argsort(gains, kind="stable")[:most]
    rows = [
        [*result.evidence.defects[j], f"{np.sqrt(gains[j]) * result.evidence.z:.3g}", "yes" if gains[j] >= 1.0 else ""]
        for j in order
    ]
    more = f" The first {most} of {len(gains)}." if len(gains) > most else ""
    caption = f"Z: by how much a defect stands out; it is found from {result.evidence.z:.3g} on, the least first.{more}"
    return _page.Table(header=["set", "defect", "Z", "found"], rows=rows, numbers_from=2, caption=caption)


def from_images_report(result: FromImagesResult) -> str:
    figure, text = from_images_answer(result)
    lead = [_page.Answer(figure=figure, text=f"{text}."), _page.Warnings(texts=result.warnings)]
    sections = [
        _page.Section(heading="Images to take", blocks=[chosen_table(result), scores_table(result)]),
        _page.Section(heading="Defects", blocks=[defects_table(result)]),
        _page.Section(heading="Synthesised images", blocks=[_gallery(result)]),
    ]
    if result.agreement is not None:
        name, found = result.agreement
        rows = [
            [one.image, str(one.posture), f"{one.exposure:g}", f"{one.pixels:,}"]
            + [f"{rms:.2f}" for rms in (one.rms, one.noise, one.means_rms)]
            for one in found
        ]
        header = ["image", "posture", "exposure", "pixels", "rms [levels]", "of noise", "rms of means"]
        note = _page.Note(text=f"{agreement_text(name, found)}.")
        blocks = [note, _page.Table(header=header, rows=rows, numbers_from=2)]
        sections.append(_page.Section(heading="Against captured images", blocks=blocks))
    title = "Lights chosen from images"
    subtitle = f"{len(result.samples.sets)} image sets, {len(result.samples.channels)} lights"
    return _page.page_html(_page.Page(title=title, subtitle=subtitle, lead=lead, sections=sections))


def _gallery(result: FromImagesResult) -> _page.Gallery:
    samples = result.samples
    order = sorted(range(len(samples.sets)), key=lambda i: (not samples.defects[i], i))[:_SETS]
    posture, manifest = samples.postures[0], samples.manifest

    def picture(number: int, place: int) -> _page.Picture:
        image = result.images[place]
        levels, _ = synthesise(samples, number, image, posture)
        texts = {"alt": f"{samples.names[number]}, {image.name}", "caption": image.name}
        shown = levels / manifest.max_level, levels >= manifest.saturated_from
        return _page.camera_picture(*shown, limit=_SIDE, **texts)

    rows = [
        (samples.names[number], [picture(number, place) for place in range(len(result.images))]) for number in order
    ]
    caption = f"Posture {posture}; red: saturated pixels."
    return _page.Gallery(header=[image.name for image in result.images], rows=rows, caption=caption)
