"""The result of a design: light positions per objective, the plan, and all that files, report and terminal show.

With it go the command that requests a plan, and those that carry it out, with the travel of the stage in each.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._blind_spots import BlindSpotSummary
from lightopt.design._candidates import Candidates, Curve, Place
from lightopt.design._misalignment import Setup
from lightopt.design._problem import ExcludedPosture, OptimizeOptions, PlanOptions, Problem
from lightopt.design._tolerances import ToleranceAnalysis, Tolerances
from lightopt.design.objectives._objective import Objective, share_text
from lightopt.design.postures._exposures import Brackets
from lightopt.design.postures._posture_search import PostureChoice
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import Levels
from lightopt.design.search._between_steps import BetweenSteps
from lightopt.design.search._exact_search import Ranked, SearchResult
from lightopt.images import posture_folder
from lightopt.rendering import GRAZING_DEG, PatchTable
from lightopt.scene import travel_order, travel_s

RIG_NAME, PLANNED_PART_NAME = "rig.optimized.yaml", "part.planned.yaml"

HOME = Posture(0.0, 0.0)  # where the stage's way begins

LEFT_OUT_MEANING = (
    f"left out: of the surface that the camera sees, what it sees at more than {GRAZING_DEG:g}° to the normal, and "
    "with objective detectability what lies at silhouettes and creases; it counts neither as covered nor as uncovered"
)
"""What the share that is left out is."""

NOT_COUNTED = "not counted"  # runner-up and ties where no other combination was scored


@dataclass(frozen=True, kw_only=True)
class Way:
    """The travel of the stage through postures, in the order that takes least time from (0°, 0°)."""

    order: tuple[Posture, ...]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of a plan, to be run in the folder of its files; `way` is None where it renders."""

    text: str
    way: Way | None = None


@dataclass(frozen=True, kw_only=True)
class ObjectiveResult:
    objective: Objective
    found: SearchResult
    scores: Mapping[str, int]  # of the best set under every objective, by name
    details: Mapping[str, Any] = field(default_factory=dict[str, Any])  # further facts, as JSON
    nothing: str | None = None  # why there is no best set: no combination scores at all. None where there is one
    # where the positions were chosen with postures: the set of alternatives that `found` is a proof for; others were
    # not counted. None where the search chose them
    proven_of: str | None = None
    # what positions between the candidates can score, of the first objective's result; None where none lies between, or
    # that was not computed
    between: BetweenSteps | None = None

    @property
    def ties_text(self) -> str:
        """How many other combinations share the optimum's score; not counted for a set that was chosen before."""
        return NOT_COUNTED if self.proven_of else f"{'' if self.found.complete else '≥ '}{self.found.ties:,}"

    @property
    def near_text(self) -> str:
        """How many other combinations score nearly as much; not counted for a set that was chosen before."""
        return NOT_COUNTED if self.proven_of else f"{'' if self.found.near_exact else '≥ '}{self.found.near:,}"

    @property
    def combinations_text(self) -> str:
        """How many combinations were scored, excluded by a bound, and left; not of a set that was chosen before."""
        found = self.found
        if self.proven_of is not None:
            return NOT_COUNTED
        text = f"{found.scored:,}" + (f" + {found.excluded:,} by bound" if found.excluded else "")
        return text + (f", {found.left:,} left" if found.left else "")


@dataclass(frozen=True, kw_only=True)
class SetResult:
    postures: tuple[Posture, ...]  # one, or all of them where the lights stand the same for all
    patches: int  # number of inspectable patches, summed over the postures
    area: int  # of these patches [µm²]
    grazing_area: int  # that the camera sees at a grazing angle, left out of scores and shares, likewise [µm²]
    grain: float  # how far shares of the area may be off since each patch counts as its middle does, 0 to 1
    answers: tuple[ObjectiveResult, ...]  # one per objective
    levels: tuple[Levels, ...]  # of each posture, under the best set of the first objective, shape (lights, p)
    curves: tuple[Curve, ...]  # the first objective's score against one angle; none where nothing scores
    initial_score: int | None = None  # the first objective's, of the rig file's angles; None where not computed

    @property
    def left_out(self) -> float:
        """Of the surface that the camera sees, the share that it sees at a grazing angle."""
        return self.grazing_area / max(1, self.area + self.grazing_area)

    @property
    def left_out_text(self) -> str:
        """The same to the digits that the patches support; see :data:`LEFT_OUT_MEANING`."""
        return share_text(self.left_out, self.grain)

    def format_score(self, value: int, objective: Objective) -> str:
        return objective.format_score(value, self.grain * self.area)

    def score_text(self, value: int, objective: Objective) -> str:
        """The same, and as a share of the inspectable area where it is one."""
        share = objective.share_of_whole(value, self.area)
        text = self.format_score(value, objective)
        return text + ("" if share is None else f" ({share_text(share, self.grain)})")

    @property
    def gain_text(self) -> str | None:
        """What the lights as they stand score under the first objective, and what the change gains; None if unknown."""
        first = self.answers[0]
        if self.initial_score is None or first.nothing is not None:
            return None
        objective, score = first.objective, first.found.best.score
        text = f"as the lights stand now: {self.score_text(self.initial_score, objective)}; "
        if score <= self.initial_score:
            return text + "no other positions score more"
        share = objective.share_of_whole(score - self.initial_score, self.area)
        if share is not None:
            return text + f"the change gains {share_text(share, self.grain).removesuffix('%')}points"
        more = 100.0 * (score - self.initial_score) / max(1, self.initial_score)
        return text + f"the change gains {more:.1f} % of that"

    @property
    def between_text(self) -> str | None:
        """What positions between the candidates can score under the first objective; None where it is not known."""
        first = self.answers[0]
        if first.between is None or first.nothing is not None:
            return None
        bound = self.score_text(first.between.bound, first.objective)
        return f"positions between the candidates are expected to score at most {bound}"

    def gap_text(self, answer: ObjectiveResult) -> str:
        """By how much the runner-up scores less; of the combinations scored (≥) where some are left."""
        found = answer.found
        if answer.proven_of is not None:
            return NOT_COUNTED
        if found.gap is None:
            return "-"
        gap = self.format_score(found.gap, answer.objective)
        if not found.gap:
            return "equal"
        # a gap below the patches' grain is that small whatever is left
        return gap if gap.startswith("<") else f"{'' if found.complete else '≥ '}−{gap}"


def places_of(candidates: Candidates, ranked: Ranked) -> tuple[Place, ...]:
    return tuple(places[k] for places, k in zip(candidates.places, ranked.candidates, strict=True))


# what the shares of a plan are shares of, and those of exposures for a part's own postures
SHARES_OF, OWN_SHARES_OF = (
    f"the surface that the camera sees in any {which} at up to {GRAZING_DEG:g}° to its normal × defects by weight"
    for which in ("posture to choose from", "of the postures")
)

NEGLIGIBLE_SHARE = 0.001  # of the pairs: what further postures add together that is too little for an image


@dataclass(frozen=True, eq=False)
class ChosenPostures:
    choice: PostureChoice
    evaluator: ImageEvaluator  # all postures to choose from, and the patches for the last iterations and all figures
    drawn: int  # number of patches for the first iterations
    left_out: tuple[ExcludedPosture, ...]  # postures that the stage reaches and that are of no use
    way: Way  # through the chosen ones, were all captured in one round
    pace: str  # how fast the stage goes, and who says so
    plan: PlanOptions

    @property
    def proven(self) -> bool:
        """Whether no other postures with no other lights show more: then the alternating search can miss nothing."""
        cover = self.choice.cover
        return cover.covered == cover.total or (self.choice.iterations == 0 and cover.proven)

    @property
    def sufficient(self) -> int:
        """How many of the postures, in the order in which they were chosen, come within a tenth of a point of all."""
        steps = self.choice.cover.steps
        enough = (steps[-1].covered if steps else 0) - NEGLIGIBLE_SHARE * self.choice.cover.total
        return next((i for i, step in enumerate(steps, start=1) if step.covered >= enough), len(steps))


@dataclass(frozen=True)
class ToleranceResult:
    """How far the score of one posture, or of several together, falls when angles are off.

    `grain` is how far shares of its `patches` may be off since a patch counts as its middle does.
    """

    postures: tuple[Posture, ...]
    robustness: ToleranceAnalysis
    unit: str
    patches: int
    grain: float


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    chosen: ChosenPostures | None = None  # postures; None where the part's own were taken
    brackets: Brackets | None = None  # exposures; None where there were no others to choose from
    # share of each kind of defect that own postures show at the planned exposures; empty without these
    defects: Mapping[str, float] = field(default_factory=dict[str, float])
    tolerances: tuple[ToleranceResult, ...] = ()  # of each posture, then of all together; empty if not requested
    commands: tuple[Command, ...] = ()  # that carry out planned postures or exposures; empty without these

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        return (1.0,) if self.brackets is None else self.brackets.of(posture)


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignResult(Problem):
    """Best light positions for a part, and the plan made for them; `candidates` are those of `results`."""

    folder: Path
    command: str  # the command line that asks for this result
    patches: PatchTable | None  # None where all matrices came from the cache and there is no report
    results: tuple[SetResult, ...]  # one per posture, or one for all of them
    plan: PlanResult
    blind: BlindSpotSummary | None  # blind spots, where images are tested for defects
    reused: int  # number of luminance matrices read from the cache
    warnings: tuple[str, ...]  # what was repaired or is partly wrong


def way_through(rig: RigConfig, postures: Sequence[Posture]) -> Way:
    """The fastest way from (0°, 0°) through postures, at the speed of the rig's stage or of the virtual bench's.

    The order of `postures` decides where times are equal.
    """

    def time(start: Posture, end: Posture) -> float:
        if rig.hardware is None:
            return travel_s(None, start, end)
        return 0.0 if rig.hardware.stage is None else travel_s(rig.hardware.stage, start, end)

    order = travel_order(postures, start=HOME, time=time)
    return Way(order=order, seconds=sum(time(a, b) for a, b in zip((HOME, *order), order, strict=False)))


def plan_commands(setup: Setup, options: OptimizeOptions) -> tuple[Command, ...]:
    """Commands that carry a plan out, in the folder of its files: those that capture it, then those that render it.

    One of each kind for all postures of the same rig file and exposures.
    """
    # as the rig files are written: one where all postures have the same lights
    one_rig = len(set(setup.places)) == 1
    groups: dict[tuple[str, tuple[float, ...]], list[Posture]] = {}
    for posture, exposures in zip(setup.postures, setup.exposures, strict=True):
        file = RIG_NAME if one_rig else f"{posture_folder(posture)}/{RIG_NAME}"
        groups.setdefault((file, exposures), []).append(posture)
    captures: list[Command] = []
    renders: list[Command] = []
    for number, ((file, exposures), postures) in enumerate(groups.items(), start=1):
        end = "" if len(groups) == 1 else f"-{number}"
        chosen = [] if len(groups) == 1 else _posture_words(postures)
        files = [file, PLANNED_PART_NAME, *chosen, f"--exposure {','.join(f'{one:.9g}' for one in exposures)}"]
        way = way_through(setup.rig, postures)
        captures.append(Command(text=" ".join(["lightopt capture", *files, f"-o captured{end}"]), way=way))
        words = ["lightopt render", *files, *_render_words(options), f"-o rendered{end}"]
        renders.append(Command(text=" ".join(words)))
    return (*captures, *renders)


def command_text(rig: Path, part: Path, options: OptimizeOptions, plan: PlanOptions) -> str:
    """The command of a run with every option that differs from its default, but for folders and how it is run.

    Files are named without their folder, so that the text does not depend on it.
    """
    words = ["lightopt", "optimize", rig.name, part.name, *_search_words(options), *_plan_words(plan)]
    return " ".join(shlex.quote(word) for word in words)


def _render_words(options: OptimizeOptions) -> list[str]:
    """The options of ``lightopt render`` that reproduce the plan's images, where they differ from its defaults."""
    words = _differing(options, {"--points": "points", "--patches": "patch_budget"})
    return [*words, *(() if options.shadows else ("--no-shadows",))]


def _search_words(options: OptimizeOptions) -> list[str]:
    words = [word for name in options.objectives for word in ("--objective", name)]
    words += _differing(options, {"--step": "step_deg", "--min-images": "min_images", "--false-alarms": "false_alarms"})
    words += () if options.threshold is None else ("--calibration", options.threshold.file)
    names = {"--shade-below": "shade_below", "--ranking-rows": "rows", "--max-combinations": "limit"}
    words += [*_differing(options, names), *_posture_words(options.postures or ())]
    flags = (
        ("--common-elevation", options.common_elevation),
        ("--lights-per-posture", not options.common_lights),
        ("--no-images", not options.images),
    )
    return [*words, *_render_words(options), *(flag for flag, given in flags if given)]


def _plan_words(plan: PlanOptions) -> list[str]:
    names = {"--choose-postures": "choose_postures", "--target": "target", "--posture-step": "posture_step_deg"}
    words = _differing(plan, {**names, "--allow-outside": "allow_outside_px"})
    if plan.exposures:
        words += ["--exposure", ",".join(_text(exposure) for exposure in plan.exposures)]
        words += _differing(plan, {"--exposure-gain": "exposure_gain"})
    if plan.tolerances is not None:
        names = {"--light-tolerance": "light_deg", "--pose-tolerance": "pose_deg"}
        words += _differing(plan.tolerances, {**names, "--tolerance-target": "tolerance_target"})
    return words


def _posture_words(postures: Sequence[Posture]) -> list[str]:
    return [f"--posture={decimal_text(p.elevation_deg)},{decimal_text(p.rotation_deg)}" for p in postures]


def _differing(options: OptimizeOptions | PlanOptions | Tolerances, names: dict[str, str]) -> list[str]:
    # the options of these names whose values differ from the defaults
    default = type(options)()
    some = [(option, getattr(options, name), getattr(default, name)) for option, name in names.items()]
    return [word for option, value, unset in some if value != unset for word in (option, _text(value))]


def _text(value: object) -> str:
    # a float by as many digits as make it the same number again, whole numbers without their point
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def decimal_text(value: float) -> str:
    """An angle or a length for a file: at most nine decimals, which is finer than any stage, and no exponent."""
    return f"{round(value, 9):.9f}".rstrip("0").rstrip(".")
