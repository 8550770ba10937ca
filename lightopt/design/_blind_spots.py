"""Blind spots: where defects stay invisible under a set of light positions, and why.

A planned defect is found where the evidence of all images is enough, whichever postures they are of; all exposures of
a light count as one image. A patch with defects that are not found gets one reason:

============  ==========================================================================================
camera        the camera sees the patch in no posture
grazing       the camera sees it at an edge or a grazing angle (`lightopt.rendering.GRAZING_DEG`) only
shadowed      light reaches it, neither nought nor saturated, in too few images
saturated     the same, because of saturated lights: the first of them
contrast      enough images show it well, but the defects change the levels by too little for the noise
============  ==========================================================================================

What is seen at a grazing angle or an edge only counts neither as found nor as blind: shares are of the rest of the
surface, and the share left out is given separately.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64, Int32, UInt8
from lightopt.core.run_context import Share, ignore
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design._misalignment import Setup
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import share_text
from lightopt.design.responses._evidence import units_needed
from lightopt.design.responses._image_evaluator import ImageEvaluator, PatchRow
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix, Visibility
from lightopt.design.responses._pairs import Counts, add_counts, add_units
from lightopt.geometry import Patches
from lightopt.images import csv_text
from lightopt.lights import PanelLight
from lightopt.rendering import grain_of
from lightopt.scene import Placement


class BlindReason(IntEnum):
    """Why defects on a patch are not seen; saturated by light n is ``SATURATED + n``, n from 0 in the rig's order."""

    SEEN = 0
    CAMERA = 1
    GRAZING = 2
    SHADOWED = 3
    CONTRAST = 4
    SATURATED = 5


@dataclass(frozen=True, kw_only=True)
class BlindSpots:
    """Visibility of defects on all n patches of a run, over one posture or several."""

    codes: NDArray[np.int16]  # reasons (:class:`BlindReason`), shape (n,)
    share: Float64  # weighted share of the defects that are found on each patch, shape (n,)
    areas: Float64  # of the patches [mm²], shape (n,)

    @property
    def seen(self) -> float:
        """Share of the surface × defects that is found, of what is not left out."""
        return float((self.areas * self.share).sum() / self.counted)

    @property
    def counted(self) -> float:
        """Area that shares are of: all but what is seen at a grazing angle only [mm²]."""
        return max(float(self.areas[self.codes != BlindReason.GRAZING].sum()), 1e-300)

    @property
    def grain(self) -> float:
        """How far these shares may be off: see :func:`lightopt.rendering.grain_of`."""
        return grain_of(self.areas[self.codes != BlindReason.GRAZING])

    @property
    def left_out(self) -> float:
        """Of the whole surface, the share that is seen at a grazing angle only."""
        return float(self.areas[self.codes == BlindReason.GRAZING].sum() / self.areas.sum())

    def by_reason(self) -> dict[int, float]:
        """Share of the surface × defects that is not found, by code, ascending; they add up to 1 − :attr:`seen`.

        Of what is not left out: :attr:`BlindReason.GRAZING` is not among them.
        """
        lost = self.areas * (1.0 - self.share) / self.counted
        found = np.unique(self.codes[(self.codes != BlindReason.SEEN) & (self.codes != BlindReason.GRAZING)])
        return {int(code): float(lost[self.codes == code].sum()) for code in found}


def blind_text(code: int, lights: Sequence[str]) -> str:
    if code >= BlindReason.SATURATED:
        return f"saturated by {lights[code - BlindReason.SATURATED]}"
    return {
        BlindReason.SEEN: "found",
        BlindReason.CAMERA: "never seen by the camera",
        BlindReason.GRAZING: "left out: at a grazing angle or an edge",
        BlindReason.SHADOWED: "shadowed",
        BlindReason.CONTRAST: "contrast under noise",
    }[BlindReason(code)]


@dataclass(frozen=True, eq=False, kw_only=True)
class DefectVisibility:
    """What the images of a posture show of the p patches that the camera sees there, and of t defects on them."""

    visibility: Visibility  # the patches; without positions of lights
    counts: Counts  # units of evidence up to what is needed, shape (k, p, ⌈t / 64⌉)
    least: int  # images that must show a defect
    usable: Int32  # number of images with a level that is neither dark nor saturated, shape (p,)
    saturated: Int32  # number of images with a saturated level and no usable one, shape (p,)
    first: NDArray[np.int16]  # the first light with such an image; −1 where there is none; shape (p,)


def by_light(matrices: Sequence[LuminanceMatrix]) -> list[list[tuple[LuminanceMatrix, int]]]:
    """The images of each light, for :func:`defect_visibility`, from matrices of all lights: one for each exposure."""
    return [[(matrix, light) for matrix in matrices] for light in range(len(matrices[0].levels))]


def defect_visibility(
    lights: Iterable[Iterable[tuple[LuminanceMatrix, int]]], thresholds: LevelThresholds, *, least: int
) -> DefectVisibility:
    """What the images of a posture's lights show; `least` must show a defect.

    lights: Of each light in the rig's order, matrices with their visibility and the light's index in them: one for each
        exposure, or for some of the positions. They count as one image, which shows what any of them shows under any
        of the positions. From a generator, only one is held at a time.
    """
    shown: DefectVisibility | None = None
    for light, matrices in enumerate(lights):
        seen, good, bright = np.uint64(0), np.False_, np.False_
        for matrix, layer in matrices:
            visibility, levels = matrix.visibility, matrix.levels[layer]
            assert visibility is not None
            count, width = len(visibility.patch), visibility.words[layer].shape[-1]
            shown = shown or DefectVisibility(
                visibility=visibility.rows([np.zeros(0, np.int64)] * len(visibility.words)),
                counts=np.zeros((units_needed(least), count, width), np.uint64),
                least=least,
                usable=np.zeros(count, np.int32),
                saturated=np.zeros(count, np.int32),
                first=np.full(count, -1, np.int16),
            )
            saturated = levels >= thresholds.saturation
            seen = seen | np.bitwise_or.reduce(visibility.words[layer], axis=0)
            good = good | ((levels > thresholds.black) & ~saturated).any(axis=0)
            bright = bright | saturated.any(axis=0)
        assert shown is not None
        assert isinstance(seen, np.ndarray)
        add_units(shown.counts, seen)
        glare = bright & ~good
        shown.usable[:] += good
        shown.saturated[:] += glare
        shown.first[glare & (shown.first < 0)] = light
    assert shown is not None
    return shown


def blind_spots(areas: Float64, postures: Sequence[DefectVisibility]) -> BlindSpots:
    """Blind spots over one posture or several: found is what their images together have enough evidence of.

    `areas` are those of all patches of the run [mm²], shape (n,).
    """
    count = len(areas)
    if not postures:
        return BlindSpots(codes=np.full(count, BlindReason.CAMERA, np.int16), share=np.zeros(count), areas=areas)
    first_posture = postures[0].visibility
    least = postures[0].least
    counts = np.zeros((len(postures[0].counts), count, postures[0].counts.shape[2]), np.uint64)
    usable, saturated = np.zeros(count, np.int64), np.zeros(count, np.int64)
    first = np.full(count, -1, np.int16)
    # 0 the camera does not see it, 1 at a grazing angle, 2 well
    sight = np.zeros(count, np.int8)
    for shown in postures:
        patch, grazing = shown.visibility.patch, shown.visibility.grazing
        sight[grazing] = np.maximum(sight[grazing], 1)
        sight[patch] = 2
        counts[:, patch] = add_counts(counts[:, patch], shown.counts)
        usable[patch] += shown.usable
        saturated[patch] += shown.saturated
        first[patch] = np.where(first[patch] < 0, shown.first, first[patch])
    codes = np.full(count, BlindReason.CONTRAST, np.int16)
    lacking = usable < least
    codes[lacking] = BlindReason.SHADOWED
    glaring = lacking & (usable + saturated >= least)
    codes[glaring] = BlindReason.SATURATED + first[glaring]
    codes[sight == 1] = BlindReason.GRAZING
    codes[sight == 0] = BlindReason.CAMERA
    if len(postures) == 1 and (spare := first_posture.spare_flags) is not None:
        # of several postures together, images of the others light what one leaves dark
        counts[:, first_posture.patch] = add_counts(counts[:, first_posture.patch], spare)
    sums, every_defect = first_posture.weights(counts[-1]), sum(defect.weight for defect in first_posture.defects)
    codes[sums == every_defect] = BlindReason.SEEN
    return BlindSpots(codes=codes, share=sums / every_defect, areas=areas)


BLIND_SHARES_OF = "the part's surface without what is at grazing angles or edges only, × defects by weight"
"""What shares of blind spots are shares of."""

BLIND_LIGHTS = ("chosen", "best for each defect")
"""Light positions in the rows of the tables: the chosen ones; or for each defect any that show it, which no one set of
positions need do for all."""


# a posture, and what its images show of defects: with the chosen lights and exposures, and with all that there were to
# choose from
PostureVisibility = tuple[Posture, DefectVisibility, DefectVisibility]

# a posture, None for all of them; blind spots of the chosen lights, and of all that the lights can do
BlindPart = tuple[Posture | None, BlindSpots, BlindSpots]


@dataclass(frozen=True, eq=False, kw_only=True)
class BlindSpotSummary:
    """Blind spots of the whole surface."""

    objective: DetectabilityObjective  # whose defects they are
    lights: tuple[str, ...]  # names, in the rig's order
    parts: tuple[BlindPart, ...]  # by all images of all postures together, then by each posture's alone

    @staticmethod
    def of(
        visibility: Sequence[PostureVisibility], areas: Float64, goal: DetectabilityObjective, names: tuple[str, ...]
    ) -> "BlindSpotSummary":
        """Combine postures; `areas` are those of all patches of the run [mm²], shape (n,)."""

        def part(posture: Posture | None, some: Sequence[PostureVisibility]) -> BlindPart:
            return posture, blind_spots(areas, [one[1] for one in some]), blind_spots(areas, [one[2] for one in some])

        parts = part(None, visibility), *(part(one[0], [one]) for one in visibility)
        return BlindSpotSummary(objective=goal, lights=names, parts=parts)

    def as_dict(self) -> dict[str, Any]:
        _, whole, _ = self.parts[0]
        both = [{"chosen": self._facts(one), "any_position": self._facts(other)} for _, one, other in self.parts]
        return {
            "min_images": self.objective.min_images,
            "shares_of": BLIND_SHARES_OF,
            "surface_mm2": round(float(whole.areas.sum()), 6),
            "grain": round(whole.grain, 6),
            **both[0],
            "postures": [
                {"posture": posture.as_dict(), **facts}
                for (posture, *_), facts in zip(self.parts, both, strict=True)
                if posture is not None
            ],
        }

    def _facts(self, spots: BlindSpots) -> dict[str, Any]:
        shares = {blind_text(code, self.lights): round(share, 6) for code, share in spots.by_reason().items()}
        reasons = [{"reason": reason, "share": share} for reason, share in shares.items()]
        return {"seen": round(spots.seen, 6), "blind": reasons, "left_out_of_surface": round(spots.left_out, 6)}


def reason_names(lights: Sequence[str]) -> list[tuple[int, str]]:
    codes = [*BlindReason, *(BlindReason.SATURATED + light for light in range(1, len(lights)))]
    return [(int(code), blind_text(int(code), lights)) for code in codes]


def planned_visibility(
    evaluator: ImageEvaluator,
    setup: Setup,
    candidates: Candidates | None,
    all_exposures: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
    progress: Share = ignore,
) -> tuple[PostureVisibility, ...]:
    """Visibility of defects in each posture: `least` images must show one.

    `setup` has the lights, postures and planned exposures; `candidates` (None where no light moves) and
    `all_exposures` are those to choose from. The patches of `evaluator` are those of the blind spots.
    """
    found: dict[int, PostureVisibility] = {}
    items = [
        (evaluator.row(posture), tuple(setup.panels(index)), setup.exposures[index])
        for index, posture in enumerate(setup.postures)
    ]
    free = None if candidates is None else candidates.panels
    goal = all_exposures, thresholds, least
    # in this process the threads are those of each posture
    evaluator.spread(_visibility_in, items, found.__setitem__, free, *goal, threads=1, progress=progress)
    return tuple(found[index] for index in range(len(items)))


def _visibility_in(
    item: tuple[PatchRow, Sequence[PanelLight], Sequence[float]],
    evaluator: ImageEvaluator,
    free: Sequence[Sequence[PanelLight]] | None,
    all_exposures: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
) -> PostureVisibility:
    row, lights, exposures = item
    posture, evaluator = row[0], evaluator.of_rows([row])
    panels = [[panel] for panel in lights]
    matrices = evaluator.matrices(posture, panels, exposures=exposures)
    # light by light, and of each as many positions as there is room for: all at all exposures would be much to hold
    batches = (
        evaluator.in_batches(posture, positions, exposures=all_exposures)
        for positions in (panels if free is None else free)
    )
    every = (((matrix, 0) for some in of_light for matrix in some) for of_light in batches)
    chosen, possible = (defect_visibility(some, thresholds, least=least) for some in (by_light(matrices), every))
    return posture, chosen, possible


Colour = tuple[int, int, int]  # red, green and blue, 0 to 255


@dataclass(frozen=True, kw_only=True)
class BlindClass:
    """Patches of one colour: why defects are not seen there, and whether others are.

    :attr:`BlindReason.SATURATED` stands for every light.
    """

    code: BlindReason
    some_seen: bool
    label: str
    colour: Colour


@dataclass(frozen=True)
class LegendRow:
    """A line of a legend: label, share in words, and the colours that stand for it.

    Shares are of the part's surface × defects; what is left out is a share of the whole surface.
    """

    label: str
    amount: str
    colours: tuple[Colour, ...]


# Okabe and Ito, Color Universal Design (2008): apart with any colour vision; in the order of the legend
_COLOURS = {
    BlindReason.SEEN: (86, 180, 233),
    BlindReason.CONTRAST: (240, 228, 66),
    BlindReason.SATURATED: (213, 94, 0),
    BlindReason.SHADOWED: (11, 60, 93),
    BlindReason.GRAZING: (204, 121, 167),
    BlindReason.CAMERA: (201, 206, 214),
}
_ONE_CLASS = (BlindReason.SEEN, BlindReason.GRAZING, BlindReason.CAMERA)


def _classes_of(code: BlindReason, colour: Colour) -> tuple[BlindClass, ...]:
    label = blind_text(code, ["a light"])
    none_seen = BlindClass(code=code, some_seen=code == BlindReason.SEEN, label=label, colour=colour)
    if code in _ONE_CLASS:
        return (none_seen,)
    red, green, blue = ((channel + 255) // 2 for channel in colour)
    label = f"{label}, other defects found"
    return none_seen, BlindClass(code=code, some_seen=True, label=label, colour=(red, green, blue))


BLIND_CLASSES = tuple(one for code, colour in _COLOURS.items() for one in _classes_of(code, colour))
"""Seen, and each reason: in its own colour where no defect is seen, pale where others are."""


def blind_class(code: int) -> BlindClass:
    """The class of a code where no defect is seen, or where all are."""
    return next(one for one in BLIND_CLASSES if one.code == min(code, BlindReason.SATURATED))


def blind_classes(spots: BlindSpots) -> UInt8:
    """Class of each patch, indices into :data:`BLIND_CLASSES`, shape (n,)."""
    codes, some = np.minimum(spots.codes, BlindReason.SATURATED), spots.share > 0.0
    classes = np.zeros(len(codes), np.uint8)
    for index, one in enumerate(BLIND_CLASSES):
        classes[(codes == one.code) & ((some == one.some_seen) | (one.code in _ONE_CLASS))] = index
    return classes


def blind_colours(spots: BlindSpots) -> UInt8:
    """Colour of each patch, shape (n, 3)."""
    return np.array([one.colour for one in BLIND_CLASSES], np.uint8)[blind_classes(spots)]


def blind_legend(spots: BlindSpots) -> tuple[LegendRow, ...]:
    """What is seen, and every reason that occurs, with the colours that stand for it."""
    shares = dict.fromkeys(BlindReason, 0.0)
    shares[BlindReason.SEEN], shares[BlindReason.GRAZING] = spots.seen, spots.left_out
    for code, share in spots.by_reason().items():
        shares[BlindReason(min(code, BlindReason.SATURATED))] += share
    rows: list[LegendRow] = []
    for code in _COLOURS:
        if shares[code] > 0.0 or code == BlindReason.SEEN:
            colours = tuple(one.colour for one in BLIND_CLASSES if one.code == code)
            rows.append(LegendRow(blind_class(code).label, share_text(shares[code], spots.grain), colours))
    return tuple(rows)


BLIND_CSV, BLIND_PLY, BLIND_PNG = BLIND_NAMES = "blind.csv", "blind.ply", "blind.png"


def blind_csv(summary: BlindSpotSummary) -> str:
    table: list[list[object]] = [["postures", "lights", "what", "share", "share_of", "area_mm2", "colour"]]
    names = dict(reason_names(summary.lights))
    surface = float(summary.parts[0][1].areas.sum())
    counted, whole = "surface x defects without what is left out", "surface"
    for posture, chosen, possible in summary.parts:
        where = "all" if posture is None else f"{posture.elevation_deg:g},{posture.rotation_deg:g}"
        for lights, spots in zip(BLIND_LIGHTS, (chosen, possible), strict=True):
            rows = [
                (code, share, counted, share * spots.counted)
                for code, share in {int(BlindReason.SEEN): spots.seen, **spots.by_reason()}.items()
            ]
            if spots.left_out:
                rows.append((int(BlindReason.GRAZING), spots.left_out, whole, spots.left_out * surface))
            for code, share, of, area in rows:
                colour = "#{:02x}{:02x}{:02x}".format(*blind_class(code).colour)
                table.append([where, lights, names[code], f"{share:.6f}", of, f"{area:.6g}", colour])
    return csv_text(table)


def blind_ply(summary: BlindSpotSummary, patches: Patches, placement: Placement) -> bytes:
    """All patches with their blind spots; `placement` is that of the mesh file in the part's frame."""
    _, chosen, possible = summary.parts[0]
    # corners in the coordinates of the mesh file: x_file = Rᵀ·(x − t)
    vertices = (patches.vertices - placement.translation) @ placement.rotation
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment lightopt blind spots; lengths in mm, coordinates of the part's own file (GLB: Z up)",
        "comment seen and code: found by the images of all postures under the chosen lights",
        "comment reachable and reachable_code: each light where it shows the defect, whatever the others",
        "comment seen, reachable: weighted share of the defects, 0 to 1",
        *(f"comment colour {' '.join(map(str, one.colour))}: {one.label}" for one in BLIND_CLASSES),
        *(f"comment code {code}: {name}" for code, name in reason_names(summary.lights)),
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(patches)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        "property float seen",
        "property uchar code",
        "property float reachable",
        "property uchar reachable_code",
        "end_header",
    ]
    faces = np.zeros(len(patches), "u1, (3,)<i4, (3,)u1, <f4, u1, <f4, u1")
    columns = [3, patches.triangles, blind_colours(chosen)]
    columns += [column for one in (chosen, possible) for column in (one.share, np.minimum(one.codes, 255))]
    for number, column in enumerate(columns):
        faces[f"f{number}"] = column
    # a header is ASCII without control characters, whatever lights are called
    lines = ("".join(c if c.isascii() and c.isprintable() else "?" for c in line) for line in header)
    text = "".join(f"{line}\n" for line in lines)
    return text.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes()
