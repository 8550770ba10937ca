"""Values put into YAML files that people wrote."""

from __future__ import annotations

import pytest

from lightopt.config import with_values
from lightopt.errors import InputError

TEXT = """\
# a part
format: lightopt-part/1

reflectance:            # of the paper
  R_d: 45.0             # diffuse, 'R_s: 1' is not this
  R_s: 12500
  sigma_rad: "0.0475"
lights:
  - {name: one, gain: 1}   # the first
  - {name: two}
  - name: three
    distance_mm: 330
"""


def test_only_the_values_change():
    done = with_values(TEXT, {("reflectance", "R_d"): "44.9", ("reflectance", "sigma_rad"): "0.05"})
    assert done == TEXT.replace("45.0  ", "44.9  ").replace('"0.0475"', "0.05")


def test_a_key_is_added_to_a_mapping_of_either_style():
    done = with_values(
        TEXT, {("lights", 1, "gain"): "1.02", ("lights", 2, "gain"): "0.9", ("lights", 0, "gain"): "2"}
    )
    assert "- {name: one, gain: 2}   # the first" in done
    assert "- {gain: 1.02, name: two}" in done
    assert "  - gain: 0.9\n    name: three\n    distance_mm: 330\n" in done


def test_a_mapping_that_is_not_there_is_refused():
    with pytest.raises(InputError, match=r"camera\.sensor"):
        with_values(TEXT, {("camera", "sensor", "black_level"): "3"})


def test_an_anchor_that_would_be_lost_is_refused():
    text = "a: &x 3\nb: *x\n"
    with pytest.raises(InputError, match="anchors"):
        with_values(text, {("a",): "4"})
    assert with_values(text, {("b",): "4"}) == "a: &x 3\nb: 4\n"
