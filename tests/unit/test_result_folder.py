"""A folder of results: nothing of other inputs is replaced unasked, and nothing of an earlier result stays behind."""

from __future__ import annotations

import json

import pytest

from lightopt.core.errors import InputError
from lightopt.images import ResultFolder


def folder(path, made_from, *, force=False):
    return ResultFolder(
        path, made_from, name="trial.json", format="lightopt-trial/1", what="a trial", also=("extra.yaml",), force=force
    )


def written(path, made_from, *names, force=False):
    result = folder(path, made_from, force=force)
    for name in names:
        result.write_text(name, f"{name}\n")
    return result.finish({"figure": 3})


def test_the_list_says_what_is_there_and_what_it_was_made_from(tmp_path):
    path = written(tmp_path / "a", {"seed": (1, 2)}, "b/c.txt", "a.txt")
    assert json.loads(path.read_text(encoding="utf-8")) == {
        "format": "lightopt-trial/1",
        "figure": 3,
        "files": ["a.txt", "b/c.txt"],
        "provenance": {"seed": [1, 2]},
    }


def test_the_same_inputs_replace_and_leave_nothing_behind(tmp_path):
    written(tmp_path, {"seed": (1, 2)}, "old/one.txt", "two.txt")
    (tmp_path / "mine.txt").write_text("kept", encoding="utf-8")
    written(tmp_path, {"seed": (1, 2)}, "two.txt")
    assert {p.name for p in tmp_path.rglob("*") if p.is_file()} == {"two.txt", "trial.json", "mine.txt"}


@pytest.mark.parametrize("there", ["trial.json", "extra.yaml"])
def test_other_inputs_and_files_of_unknown_making_are_replaced_with_force_only(tmp_path, there):
    written(tmp_path, {"seed": 1})
    if there == "extra.yaml":
        (tmp_path / "trial.json").unlink()
        (tmp_path / there).write_text("a person's", encoding="utf-8")
    with pytest.raises(InputError, match=f"already has {there} of a trial of other inputs .* option 'force'"):
        folder(tmp_path, {"seed": 2})
    assert (tmp_path / there).exists()
    written(tmp_path, {"seed": 2}, force=True)
    assert not (tmp_path / "extra.yaml").exists()


def test_names_that_lead_out_of_the_folder_are_not_touched(tmp_path):
    outside = tmp_path / "outside.txt"
    outside.write_text("not ours", encoding="utf-8")
    inside = tmp_path / "in"
    inside.mkdir()
    listed = {"format": "lightopt-trial/1", "files": ["../outside.txt", "\0", 3], "provenance": {"seed": 1}}
    (inside / "trial.json").write_text(json.dumps(listed), encoding="utf-8")
    written(inside, {"seed": 1}, "new.txt")
    assert outside.exists()


def test_no_result_goes_to_the_folder_of_an_image_set(tmp_path):
    (tmp_path / "manifest.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="is the folder of an image set; choose another one for a trial"):
        folder(tmp_path, {"seed": 1}, force=True)


def test_a_link_is_removed_and_not_what_it_leads_to(tmp_path):
    """Images may be links into a store of data."""
    path = written(tmp_path / "a", {"seed": 1}, "images/one.txt")
    store = tmp_path / "store.txt"
    store.write_text("kept", encoding="utf-8")
    link = path.parent / "images" / "one.txt"
    link.unlink()
    try:
        link.symlink_to(store)
    except OSError:
        pytest.skip("links need rights here")
    written(path.parent, {"seed": 1}, "two.txt")
    assert store.read_text(encoding="utf-8") == "kept"
    assert not (path.parent / "images").exists()


def test_what_is_no_name_in_a_list_leads_nowhere(tmp_path):
    """A list may be damaged; a folder whose file is gone goes, too."""
    path = written(tmp_path, {"seed": 1}, "a.txt")
    document = json.loads(path.read_text(encoding="utf-8"))
    document["files"] += [None, 3, {"file": "a.txt"}, "..", "gone/one.txt"]
    path.write_text(json.dumps(document), encoding="utf-8")
    (tmp_path / "gone").mkdir()
    for name in ("None", "3"):
        (tmp_path / name).write_text("kept", encoding="utf-8")
    written(tmp_path, {"seed": 1}, "b.txt")
    assert {p.name for p in tmp_path.iterdir()} == {"None", "3", "b.txt", "trial.json"}
