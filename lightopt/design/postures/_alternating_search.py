"""Alternating search for postures and lights, until neither improves the other.

The lights are placed for the postures by trying every combination of their positions; the postures are chosen for the
lights by greedy cover and exchanges. No step shows less than the one before, so that the search ends: in a local
optimum, which depends on the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from lightopt.core.run_context import RunContext, Share
from lightopt.core.transforms import Posture
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._best_set import best_set
from lightopt.design.postures._choice import Cover, PostureRequest
from lightopt.design.postures._combinations import PositionCounts
from lightopt.design.postures._counts import Counts
from lightopt.design.postures._greedy_cover import greedy_cover, improve_by_exchange
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.postures._light_positions import LightPositions, best_positions
from lightopt.scene import PanelLight

# of the counts that are cached: for recent lights, and for all positions in the last postures
CACHED_BYTES = 400_000_000

Lights = tuple[int, ...] | None  # candidate of each light; None for the rig's own positions


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Light positions, and the postures chosen for them.

    panels, lights: The lights, world frame, and the index of each one's candidate.
    exact: Whether every combination of the lights was tried in every iteration.
    iterations: How often the lights were placed.
    converged: Whether the last iteration found no positions that show more in these postures.
    """

    panels: tuple[PanelLight, ...]
    cover: Cover
    lights: Lights = None
    exact: bool = True
    iterations: int = 0
    converged: bool = True


def merit(cover: Cover, request: PostureRequest) -> tuple[float, ...]:
    """Sort key of a cover: reaching the target with few postures first; without a target, more seen."""
    if request.target is not None and cover.share >= request.target:
        return (1.0, -len(cover.steps), cover.covered, cover.benefit)
    return (0.0, cover.covered, cover.benefit)


class AlternatingSearch:
    """Alternating search on the patches of an evaluator; results for lights or postures are cached.

    postures: To choose from.
    candidates: Positions of the lights to choose from; None where no light moves.
    min_images: Images that must show a pair, of all postures together.
    where: The patches, for progress messages.
    prove: Whether all sets of postures are searched where that is little work.
    """

    def __init__(
        self,
        evaluator: ImageEvaluator,
        postures: Sequence[Posture],
        candidates: Candidates | None,
        *,
        min_images: int,
        where: str,
        prove: bool,
        run: RunContext,
    ) -> None:
        self.prove = prove
        self.evaluator, self.postures = evaluator, postures
        self.candidates, self.min_images = candidates, min_images
        self._where, self._run, self._passes = where, run, 0
        self._counts: dict[Lights, list[Counts]] = {}
        self._positions: dict[tuple[int, ...], LightPositions] = {}
        self._last_counts: tuple[tuple[int, ...], list[PositionCounts]] | None = None

    def panels(self, lights: Sequence[int]) -> tuple[PanelLight, ...]:
        """The panels for one candidate index per light."""
        assert self.candidates is not None
        return self.candidates.panels_at(lights)

    def solution_for(self, panels: Sequence[PanelLight], lights: Lights, request: PostureRequest) -> Solution:
        """The postures for lights."""
        return Solution(panels=tuple(panels), lights=lights, cover=self.cover(panels, lights, request), converged=False)

    def improve(self, solution: Solution, most: int, request: PostureRequest) -> Solution:
        """Place lights for the postures and choose postures for the lights, while that gains; `most` times at most."""
        if self.candidates is None:
            return replace(solution, converged=True)
        for _ in range(most):
            positions = self.lights(solution.cover.chosen, request)
            solution = replace(
                solution,
                exact=solution.exact and positions.exact,
                iterations=solution.iterations + 1,
                converged=positions.covered <= solution.cover.covered,
            )
            if positions.candidates == solution.lights:
                return solution
            panels = self.panels(positions.candidates)
            better = self.cover(panels, positions.candidates, request, before=solution.cover.chosen)
            gained = merit(better, request) > merit(solution.cover, request)
            # positions of the grid are preferred to the rig's own where they are as good
            as_good = merit(better, request) == merit(solution.cover, request)
            if not gained and not (as_good and solution.lights is None):
                return solution
            solution = replace(solution, panels=panels, cover=better, lights=positions.candidates, converged=False)
        return solution

    def cover(
        self, panels: Sequence[PanelLight], lights: Lights, request: PostureRequest, before: Sequence[int] = ()
    ) -> Cover:
        """Postures for lights: a greedy choice and those of the previous iteration, both improved by exchanges.

        With `prove` and a fixed number, the best of all sets of as many, where the search for it completes.
        """
        counts, weights = self._counts_under(panels, lights), self.evaluator.weights
        greedy = partial(greedy_cover, counts, weights, count=request.count, target=request.target)
        covers = [greedy()]
        sets = [covers[0].chosen, tuple(before)]
        if request.target is None:
            sets = [improve_by_exchange(counts, weights, one, threads=self.evaluator.threads) for one in sets]
        covers += [greedy(among=one) for one in sets if one and one != covers[0].chosen]
        best = max(covers, key=lambda cover: merit(cover, request))
        if self.prove and request.target is None and request.count is not None:
            size = min(request.count, len(counts))
            chosen, max_covered, sets = best_set(counts, weights, best.chosen, size, threads=self.evaluator.threads)
            if chosen != best.chosen:
                covers.append(greedy(among=chosen))
                best = covers[-1]
            best = best.with_search(max_covered, sets)
        same = [cover.bounds for cover in covers if len(cover.bounds) == len(best.bounds)]
        return replace(best, bounds=tuple(min(bounds) for bounds in zip(*same, strict=True)))

    def lights(self, chosen: Sequence[int], request: PostureRequest) -> LightPositions:
        """The best positions of the lights for postures."""
        assert self.candidates is not None
        key = tuple(sorted(chosen))
        if key not in self._positions:
            self._passes += 1
            self._positions[key], counts = best_positions(
                self.evaluator,
                [(self.postures[i], self.evaluator.exposures) for i in key],
                self.candidates,
                min_images=self.min_images,
                limit=request.limit,
                progress=self._stage("lights for postures"),
            )
            small = sum(one.nbytes for one in counts) <= CACHED_BYTES
            self._last_counts = (key, counts) if small else None
        return self._positions[key]

    def position_counts(self, chosen: Sequence[int]) -> tuple[PositionCounts, ...] | None:
        """What each position of each light shows in postures; None unless the lights were last placed for these."""
        if self._last_counts is None or self._last_counts[0] != tuple(sorted(chosen)):
            return None
        return tuple(self._last_counts[1])

    def _counts_under(self, panels: Sequence[PanelLight], lights: Lights) -> list[Counts]:
        # what every posture shows under these lights, once for as many as there is room for
        if lights not in self._counts:
            counts: list[Counts] = []
            self._passes += 1
            progress = self._stage("postures for lights")
            for i, posture in enumerate(self.postures):
                counts.append(self.evaluator.counts(posture, panels, min_images=self.min_images))
                if progress is not None:
                    progress((i + 1) / len(self.postures))
            size = sum(one.nbytes for one in counts)
            while self._counts and (len(self._counts) + 1) * size > CACHED_BYTES:
                del self._counts[next(iter(self._counts))]
            self._counts[lights] = counts
        return self._counts[lights]

    def _stage(self, name: str) -> Share | None:
        return self._run.stage(f"{name}, {self._where}, pass {self._passes}")
