"""Numbers in a YAML text are changed where they stand, and nothing else is."""

from __future__ import annotations

import pytest

from lightopt.config import edit_numbers
from lightopt.errors import InputError

TEXT = """\
# a rig
lights:   # two
  - {name: a, elevation_deg: 60,   azimuth_deg: 45}   # flow
  - name: "b: c"
    elevation_deg: 5.0e1 # block
"""


def test_flow_and_block_style_keep_comments_and_spacing():
    values = {("lights", 0, "elevation_deg"): 32.5, ("lights", 1, "elevation_deg"): 30.0}
    assert edit_numbers(TEXT, values, name="rig.yaml") == TEXT.replace("60,", "32.5,").replace("5.0e1", "30")


def test_numbers_are_written_short_and_exact_to_nine_decimals():
    key = ("lights", 0, "azimuth_deg")
    for value, written in ((1e-7, "0.0000001"), (-12.0, "-12"), (1 / 3, "0.333333333"), (100.0, "100")):
        assert f"azimuth_deg: {written}}}" in edit_numbers(TEXT, {key: value}, name="rig.yaml")


@pytest.mark.parametrize("other", ["*e", "60 # and the alias below\n    gain: *e"])
def test_a_shared_number_is_refused(other):
    text = f"lights:\n  - {{elevation_deg: &e 60}}\n  - name: x\n    elevation_deg: {other}\n"
    with pytest.raises(
        InputError, match=r"rig.yaml: lights\[0\]\.elevation_deg cannot be changed one by one"
    ):
        edit_numbers(text, {("lights", 0, "elevation_deg"): 30.0}, name="rig.yaml")
