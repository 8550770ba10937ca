"""What the positions of the lights show in postures, and which of them show most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Share
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._combinations import PlaceCounts
from lightopt.design.postures._counts import added, counts_of_images, no_counts
from lightopt.design.postures._light_positions import Places, place_lights
from lightopt.design.postures._pair_visibility import Survey
from lightopt.design.search._search import DEFAULT_LIMIT

MOST_COUNT_BYTES = 1_500_000_000
"""Of the counts of all candidate postures, and of all positions of the lights, that are held at a time."""


def holds_places(survey: Survey, candidates: Candidates | None, *, least: int) -> bool:
    """Whether there is room for the counts of all positions of the lights."""
    places = 0 if candidates is None else sum(len(some) for some in candidates.panels)
    pairs = len(survey.patches) * survey.weights.masks.shape[1]
    # those of a posture's images beside the sums
    return places * (least + 1) * pairs * 8 <= MOST_COUNT_BYTES


def place_counts(
    survey: Survey,
    postures: Sequence[tuple[Posture, tuple[float, ...]]],
    candidates: Candidates,
    *,
    least: int,
    tell: Share | None = None,
) -> list[PlaceCounts]:
    """What each position of each light shows in postures: counts, of each light of shape (positions, k, p, words).

    Parameters
    ----------
    survey
        The part.
    postures
        Each with the exposures that an image of it may be taken with.
    candidates
        Positions of the lights.
    least
        Images that must show a pair, of all postures together: k.
    tell
        Called with the share that is done.
    """
    empty = no_counts(survey.weights, least)
    totals = [np.repeat(empty[None], len(some), axis=0) for some in candidates.panels]
    for done, (posture, exposures) in enumerate(postures, start=1):
        images = replace(survey, exposures=exposures).flags(posture, candidates.panels)
        for total, layer in zip(totals, images, strict=True):
            for place, flags in enumerate(layer):
                total[place] = added(total[place], counts_of_images([flags], least))
        if tell is not None:
            tell(done / len(postures))
    return totals


def best_places(
    survey: Survey,
    postures: Sequence[tuple[Posture, tuple[float, ...]]],
    candidates: Candidates,
    *,
    least: int,
    limit: int = DEFAULT_LIMIT,
    tell: Share | None = None,
) -> tuple[Places, list[PlaceCounts]]:
    """The positions of the lights that show most in postures, and what each position shows.

    Parameters
    ----------
    survey, postures, candidates, least, tell
        As for :func:`place_counts`.
    limit
        Most combinations that are tried; with more, lights are moved one at a time.
    """
    counted = len(postures) / (len(postures) + 1)
    counts = place_counts(
        survey,
        postures,
        candidates,
        least=least,
        tell=None if tell is None else lambda share: tell(counted * share),
    )
    places = place_lights(
        counts,
        survey.weights,
        candidates.space,
        limit=limit,
        threads=survey.threads,
        progress=None if tell is None else lambda share: tell(counted + (1.0 - counted) * share),
    )
    return places, counts
