"""What is shown of a long run while it runs."""

from __future__ import annotations

import logging
import sys

import pytest

from lightopt.cli._terminal import QUIET, set_up_log, show_progress


@pytest.mark.parametrize("terminal", [True, False])
def test_nothing_is_shown_where_nobody_looks(terminal, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    told = QUIET.set(terminal)
    with show_progress() as report:
        assert report is None
    QUIET.reset(told)


def test_the_bar_shows_the_stage_and_begins_anew_with_the_next(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown, begun = [], []
    monkeypatch.setattr("rich.progress.Progress.update", lambda self, task, **facts: shown.append(facts))
    monkeypatch.setattr("rich.progress.Progress.reset", lambda self, task: begun.append(len(shown)))
    with show_progress() as report:
        assert report is not None
        for stage, share in (("paper", 0.1), ("paper", 0.9), ("coverage", 0.0), ("coverage", 0.5)):
            report(stage, share)
    assert [(one["description"], one["completed"]) for one in shown] == [
        ("paper", 0.1),
        ("paper", 0.9),
        ("coverage", 0.0),
        ("coverage", 0.5),
    ]
    assert begun == [2]


def test_the_log_is_shown_with_verbose_only(capsys):
    log = logging.getLogger("lightopt.rendering")
    for verbose, lines in ((True, 1), (False, 0), (True, 1)):
        set_up_log(verbose)
        log.info("cast %d rays", 5)
        shown = capsys.readouterr().err.splitlines()
        assert len(shown) == lines
        assert all(line.endswith("lightopt.rendering: cast 5 rays") for line in shown)
    set_up_log(False)
