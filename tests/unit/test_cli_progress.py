"""What is said of a long search while it runs."""

from __future__ import annotations

import sys

import pytest

from lightopt.cli._terminal import show_progress, show_time_left
from lightopt.core.transforms import Posture


def test_time_left_is_that_of_the_rest_at_the_pace_so_far(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with show_time_left("searching", quiet=False) as report:
        assert report is not None
        for seconds, share in ((0.0, 0.1), (0.5, 0.2), (2.0, 0.3), (2.5, 0.4), (4.0, 0.5)):
            now[0] = 100.0 + seconds
            report("paper", share)
        # the next one has a pace of its own
        for seconds, share in ((5.0, 0.0), (7.0, 0.2)):
            now[0] = 100.0 + seconds
            report("coverage", share)
    # from 10 % on: 20 % in 2 s leaves 70 % for 7 s; 40 % in 4 s leaves 50 % for 5 s
    assert capsys.readouterr().err.splitlines() == [
        "searching paper: 30.0 %, at most about 7 s left",
        "searching paper: 50.0 %, at most about 5 s left",
        "searching coverage: 20.0 %, at most about 8 s left",
    ]


@pytest.mark.parametrize("quiet", [True, False])
def test_nothing_is_said_where_nobody_looks(quiet):
    with show_time_left("searching", quiet=quiet) as report:
        assert report is None


def test_the_bar_ends_at_100_percent_where_more_postures_come_than_were_known_of(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    said = []
    monkeypatch.setattr("rich.progress.Progress.update", lambda self, task, **facts: said.append(facts))
    with show_progress("casting rays", 2, quiet=False) as report:
        assert report is not None
        for rotation in (0.0, 90.0, 180.0):
            report(Posture(0.0, rotation), 1.0, 1000)
    assert [(one["completed"], one["total"]) for one in said] == [(1.0, 2.0), (2.0, 2.0), (3.0, 3.0)]
