"""Tables of docs/validation/reliability.md: every run of a campaign is counted once."""

from __future__ import annotations

import rig_faults
from fault_cases import Case
from fault_runs import Outcome
from faults import rows_of, table


def test_the_table_of_faults_counts_every_run() -> None:
    outcomes = [
        Outcome(Case("a"), True, True, 2, "", "off", ()),
        Outcome(Case("a"), True, False, 0, "while", "told", ()),
        Outcome(Case("b"), True, False, 1, "while", "LIT", ("a light burns",)),
        Outcome(Case("b"), False, True, 0, "", "off", ()),  # never struck: not survived
    ]
    lines = table(rows_of(outcomes)).splitlines()
    assert lines[2:] == [
        "| a | 2 | 1 | 1 | 1 | 2 | 0 | 0 |",
        "| b | 1 | 0 | 1 | 0 | 1 | 1 | 1 |",
        "| **all** | 3 | 1 | 2 | 1 | 3 | 1 | 1 |",
    ]


def test_rows_of_a_table_of_rig_faults_are_renewed_and_summed() -> None:
    """Rows that did not run stay, those of faults that there are no more go, and the last line counts what is there."""
    head = "| fault | runs | wrong |\n|---|---:|---:|\n"
    old = f"{head}| a, once | 2 | 1 |\n| gone | 5 | 5 |\n| c | 1 | 0 |\n| **all** | 8 | 6 |"
    new = f"{head}| b | 3 | 0 |\n| a, once | 2 | 0 |\n| **all** | 5 | 0 |"
    kinds = ["a, once", "a, once", "b", "c"]
    assert rig_faults.renewed(old, new, kinds) == (
        f"{head}| a, once | 2 | 0 |\n| b | 3 | 0 |\n| c | 1 | 0 |\n| **all** | 6 | 0 |"
    )
