"""Objectives that are searched beside one whose light positions were chosen before."""

from __future__ import annotations

from dataclasses import replace

import pytest
from designed import design

from lightopt.design import OptimizeOptions
from lightopt.design.responses import _posture_matrices as matrices

LIGHTS = """\
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [30, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 165, elevation_range_deg: [40, 50]}
  - {name: light3, distance_mm: 330, elevation_deg: 50, azimuth_deg: 285}
"""
PLACES = ((40.0, 45.0), (50.0, 165.0), (50.0, 285.0))
OPTIONS = OptimizeOptions(
    step_deg=10.0, common_lights=True, patch_budget=400, images=False, objectives=("coverage", "paper")
)


@pytest.fixture
def three(bench):
    head, rest = bench.rig.read_text(encoding="utf-8").split("lights:\n", 1)
    bench.rig.write_text(head + LIGHTS + rest[rest.index("stage:") :], encoding="utf-8", newline="\n")
    return bench


def test_the_others_are_found_as_without_it(three):
    chosen = replace(OPTIONS, objectives=("detectability", "coverage", "paper"), places=PLACES)
    beside = design(three.rig, three.part, three.folder / "beside", options=chosen)
    first, *others = beside.results[0].answers
    # each as if it were the first, on the same surface, which is without edges where defects are planned for
    for answer in others:
        name = answer.objective.name
        order = (name, *(other for other in ("detectability", "coverage", "paper") if other != name))
        alone = design(three.rig, three.part, three.folder / name, options=replace(OPTIONS, objectives=order)).results[
            0
        ]
        assert answer.found == alone.answers[0].found
        assert answer.scores == alone.answers[0].scores
    # the first stands where it was put, and has the scores of that combination
    best = first.found.best
    angles = tuple(some[k] for some, k in zip(beside.candidates.places, best.candidates, strict=True))
    assert (angles, first.found.scored) == (PLACES, 1)
    assert first.scores["coverage"] <= others[0].found.best.score
    assert first.scores["paper"] <= others[1].found.best.score
    lone = design(three.rig, three.part, three.folder / "lone", options=replace(chosen, objectives=("detectability",)))
    assert lone.results[0].answers[0].found.best.score == best.score == first.scores["detectability"]
    assert not beside.warnings


@pytest.mark.parametrize(
    ("places", "room", "why"),
    [
        (((41.0, 45.0), *PLACES[1:]), True, "the chosen ones are not among them"),
        (PLACES, False, "they are too many for memory"),
    ],
)
def test_where_they_cannot_be_searched_it_is_said_that_they_are_only_scored(three, places, room, why, monkeypatch):
    real = matrices.PostureMatrices.fits_memory

    def holds(self, candidates):
        with monkeypatch.context() as small:
            if not room:
                small.setattr(matrices, "MOST_BYTES", 1000)
            return real(self, candidates)

    monkeypatch.setattr(matrices.PostureMatrices, "fits_memory", holds)
    chosen = replace(OPTIONS, objectives=("detectability", "paper"), places=places)
    found = design(three.rig, three.part, three.out, options=chosen)
    assert [answer.found.scored for answer in found.results[0].answers] == [1, 1]
    assert any("are scored for the chosen light positions only" in text and why in text for text in found.warnings)
