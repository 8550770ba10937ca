"""Values put into YAML files that people wrote."""

from __future__ import annotations

import pytest

from lightopt.config import with_list
from lightopt.config._edit import with_values
from lightopt.core.errors import InputError

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
    done = with_values(TEXT, {("lights", 1, "gain"): "1.02", ("lights", 2, "gain"): "0.9", ("lights", 0, "gain"): "2"})
    assert "- {name: one, gain: 2}   # the first" in done
    assert "- {gain: 1.02, name: two}" in done
    assert "  - gain: 0.9\n    name: three\n    distance_mm: 330\n" in done


def test_keys_are_removed_with_the_comments_beside_them():
    done = with_values(
        TEXT,
        {
            ("reflectance", "R_d"): None,
            ("reflectance", "full_scale"): "255",
            ("lights", 0, "gain"): None,
            ("lights", 2, "name"): None,
            ("lights", 2, "not there"): None,
        },
    )
    assert "reflectance:            # of the paper\n  full_scale: 255\n  R_s: 12500\n" in done
    assert "- {name: one}   # the first" in done
    assert "  - distance_mm: 330\n" in done


def test_all_keys_but_one_are_removed_from_braces():
    text = "lights:\n  - {name: one, a: 1, b: [2, 3],  c: {d: 4, e: 5}}  # x, }\n"
    gone = {("lights", 0, key): None for key in "abc"}
    assert with_values(text, gone) == "lights:\n  - {name: one}  # x, }\n"
    done = with_values(text, gone | {("lights", 0, "pose"): "{f: 6}", ("lights", 0, "c"): "7"})
    assert "- {pose: {f: 6}, c: 7, name: one}  # x, }" in done


def test_a_mapping_takes_the_place_of_another_and_a_key_of_the_top_goes_to_the_end():
    done = with_values(
        "camera:\n  pose:\n    a: 1  # one\n    b: [2, 3]\n  size: 3\n", {("camera", "pose"): "{c: 4}", ("d",): "5"}
    )
    assert done == "camera:\n  pose: {c: 4}\n  size: 3\nd: 5\n"


def test_a_mapping_that_is_not_there_is_refused():
    with pytest.raises(InputError, match=r"camera\.sensor"):
        with_values(TEXT, {("camera", "sensor", "black_level"): "3"})


def test_an_anchor_that_would_be_lost_is_refused():
    text = "a: &x 3\nb: *x\n"
    with pytest.raises(InputError, match="anchors"):
        with_values(text, {("a",): "4"})
    assert with_values(text, {("b",): "4"}) == "a: &x 3\nb: 4\n"


BLOCK = """\
postures:   # two
  - {elevation_deg: 0, rotation_deg: 0}
  # then
  - elevation_deg: 1
    rotation_deg: 3
"""


@pytest.mark.parametrize(
    ("there", "beside"),
    [
        ("postures: [{elevation_deg: 0, rotation_deg: 0}]   # the usual\n", "   # the usual"),
        ("postures: [\n  {elevation_deg: 0, rotation_deg: 0} # one\n]  # all\n", "  # all"),
        (BLOCK, "   # two"),
        ("postures:\n- {elevation_deg: 0,\n   rotation_deg: 0}   # of this one only\n", ""),
        ("postures:  # a 'b': c\n\n  - elevation_deg: 1\n    rotation_deg: 3  # of it\n", "  # a 'b': c"),
    ],
)
def test_a_list_takes_the_place_of_another_and_only_its_own_comment_stays(there, beside):
    before, after = "# a part\nformat: x   # one\n", "# next comes\nreflectance: {R_d: 1}   # all\n"
    new = ["{elevation_deg: 5, rotation_deg: 6}", "{elevation_deg: 7, rotation_deg: 8}"]
    done = with_list(before + there + after, "postures", new, comment="planned", replace=True)
    block = f"# planned\npostures:{beside}\n  - {new[0]}\n  - {new[1]}\n"
    assert done == before + block + after
    with pytest.raises(InputError, match="it has such a key"):
        with_list(before + there + after, "postures", new, comment="planned")
    # at the end of the file, and where there is none yet
    assert with_list(before + there, "postures", new, comment="planned", replace=True) == before + block
    plain = block.replace(beside, "") if beside else block
    assert with_list(before, "postures", new, comment="planned", replace=True) == f"{before}\n{plain}"


@pytest.mark.parametrize(
    "text", ["{format: x, postures: [{a: 1}]}\n", "x: &p [{a: 1}]\npostures: *p\n", "x: &p {a: 1}\npostures:\n  - *p\n"]
)
def test_a_list_in_braces_or_behind_an_alias_is_refused(text):
    with pytest.raises(InputError, match="postures cannot be"):
        with_list(text, "postures", ["{a: 2}"], comment="planned", replace=True)
