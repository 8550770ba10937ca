"""Running over the results of an earlier run: what --force removes, in which order, and what is never touched."""

from __future__ import annotations

import json
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from designed import design
from test_cli_optimize import result_of, with_lights

from lightopt.core.errors import InputError
from lightopt.core.provenance import versions
from lightopt.core.transforms import Posture
from lightopt.design import LuminanceMatrix, OptimizeOptions, finish_design, optimize, write_design
from lightopt.design._files import begin_writing
from lightopt.design.responses import _posture_matrices as _matrices
from lightopt.images import ImageEntry, ImageSetWriter, Manifest

EACH = OptimizeOptions(step_deg=20.0, patch_budget=500, common_lights=False)
ONE = OptimizeOptions(step_deg=20.0, patch_budget=500)


@pytest.fixture
def three(bench):
    return with_lights(bench)


def listed(folder: Path) -> set[Path]:
    """All that a result names, images by their manifests."""
    result = result_of(folder)
    files = {folder / rig["file"] for rig in result["rigs"]} | {folder / o["map"] for o in result["overlaps"]}
    for one in result["images"]:
        home = folder / one["folder"]
        manifest = json.loads((home / "manifest.json").read_text(encoding="utf-8"))
        files |= {home / "manifest.json"} | {home / name for name in manifest["files"]}
        files |= {home / i[kind] for i in manifest["images"] for kind in ("png", "exr")}
        files |= {home / i["exr"] for i in manifest["geometry"]}
    return files


def there(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file()}


def test_force_leaves_exactly_the_files_of_the_new_run(three):
    design(three.rig, three.part, three.out, options=EACH)
    mine = three.out / "posture_0_0" / "images" / "posture_0_0" / "notes.txt"
    mine.write_text("of a person", encoding="utf-8")
    design(three.rig, three.part, three.out, options=ONE, force=True)
    new = listed(three.out) | {three.out / "result.json", three.out / "ranking.csv"}
    assert there(three.out) == new | {mine}
    assert len(result_of(three.out)["images"]) == 1
    design(three.rig, three.part, three.out, options=EACH, force=True)
    new = listed(three.out) | {three.out / "result.json", three.out / "ranking.csv"}
    assert there(three.out) == new | {mine}


def test_interrupted_under_force_there_is_no_result_beside_other_files(three, monkeypatch):
    design(three.rig, three.part, three.out, options=EACH)

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("lightopt.design._files.render_image_set", stop)
        with pytest.raises(KeyboardInterrupt):
            design(three.rig, three.part, three.out, options=ONE, force=True)
    assert not (three.out / "result.json").exists()
    assert not list(three.out.rglob("images/manifest.json"))
    # what it had written itself is known to the next run, whatever that wants
    assert (three.out / "rig.optimized.yaml").exists()
    design(three.rig, three.part, three.out, options=EACH, force=True)
    new = listed(three.out) | {three.out / "result.json", three.out / "ranking.csv"}
    assert there(three.out) == new


def test_refused_under_force_all_is_as_before(three, snapshot):
    design(three.rig, three.part, three.out, options=EACH)
    before = snapshot(three.out)
    three.edit("part.yaml", "R_d: 45.0", "R_d: -1")
    with pytest.raises(InputError, match="R_d"):
        design(three.rig, three.part, three.out, options=ONE, force=True)
    assert snapshot(three.out) == before


@pytest.mark.parametrize(
    "content",
    [
        {"rigs": 5, "images": "x", "overlaps": None},
        {"rigs": [5, None, {"file": 5}, {"file": "a\0b"}, {}], "images": [{"folder": "."}], "overlaps": [[]]},
        {"rigs": [{"file": "../rig.optimized.yaml"}, {"file": "keep.txt"}], "overlaps": [{"map": "keep.png"}]},
        {"images": [{"folder": "../captured"}, {"folder": "captured"}], "rigs": [{"file": "."}]},
    ],
)
def test_a_malformed_result_removes_nothing_of_others(tmp_path, content, snapshot):
    folder = tmp_path / "out"
    folder.mkdir()
    for path in (tmp_path / "rig.optimized.yaml", folder / "keep.txt", folder / "keep.png"):
        path.write_text("keep", encoding="utf-8")
    for home in (tmp_path / "captured", folder / "captured"):
        writer = ImageSetWriter(home, Manifest(kind="captured", bit_depth=8))
        entry = ImageEntry("a", light_elevation_deg=60, light_azimuth_deg=0, posture=Posture(0.0, 0.0))
        writer.add_image(entry, png=np.zeros((4, 4), np.uint8))
    before = snapshot(tmp_path)
    result = folder / "result.json"
    result.write_text(json.dumps({"format": "lightopt-optimum/1", **content}), encoding="utf-8")
    begin_writing(folder, {"rigs": [], "images": [], "overlaps": []}, force=True)
    assert not result.exists()
    (folder / "unfinished.json").unlink()
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("name", ["report.html", "result.json"])
def test_without_force_a_previous_run_does_not_open_files_of_others(three, name):
    options = replace(ONE, images=False, report=name == "report.html")
    result = optimize(three.rig, three.part, three.out, options=options)
    three.out.mkdir()
    (three.out / name).write_text("of a person", encoding="utf-8")
    unfinished = {"format": "lightopt-unfinished/1", "files": []}
    (three.out / "unfinished.json").write_text(json.dumps(unfinished), encoding="utf-8")
    with pytest.raises(InputError, match=f"{name}: exists with other content"):
        finish_design(write_design(result), "page" if options.report else None)
    assert (three.out / name).read_text(encoding="utf-8") == "of a person"


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "[" * 100_000, "5", '{"format": 5}', "\ud800"])
def test_a_result_that_cannot_be_read_is_refused_and_replaced_by_force(three, cli, text):
    three.out.mkdir()
    (three.out / "result.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    command = ("optimize", three.rig, three.part, "-o", three.out, "--patches", "500", "--step", "20")
    more = ("--posture", "0,0", "--no-images", "-q")
    ran = cli(*command, *more)
    assert ran.status == 2
    assert "exists and is not a result of lightopt optimize; use --force" in ran.err
    assert cli(*command, *more, "--force").status == 0
    assert result_of(three.out)["images"] == []


def test_the_rig_is_written_as_it_was_loaded(three):
    """Whatever happens to the file while the search is on."""
    before = three.rig.read_text(encoding="utf-8")

    def spoil(*_):
        three.rig.write_text("spoilt", encoding="utf-8")

    design(three.rig, three.part, three.out, options=ONE, progress=spoil)
    assert three.rig.read_text(encoding="utf-8") == "spoilt"
    path = three.out / "rig.optimized.yaml"
    assert "# the low one" in path.read_text(encoding="utf-8")
    assert len(path.read_text(encoding="utf-8").splitlines()) == len(before.splitlines())


def test_what_cannot_be_edited_is_reported_before_rays_are_cast(three, monkeypatch):
    monkeypatch.setattr("lightopt.design._optimize.cast_rays_at", lambda _: pytest.fail("rays were cast"))
    three.edit("rig.yaml", "elevation_deg: 60,", "elevation_deg: &low 60,")
    three.edit("rig.yaml", "elevation_deg: 50.0 ", "elevation_deg: *low ")
    with pytest.raises(InputError, match=r"rig\.yaml: .*write anchors and aliases out"):
        design(three.rig, three.part, three.out, options=ONE)


KEPT = OptimizeOptions(step_deg=20.0, patch_budget=500, common_lights=False, keep_matrix=True, images=False)


def test_a_kept_matrix_is_reused_as_long_as_no_level_changes(three):
    """Noise, saturation, names, ranges and the mesh's file name change no level; black does."""
    design(three.rig, three.part, three.out, options=KEPT)
    three.edit("rig.yaml", "read_noise_levels: 0.8", "read_noise_levels: 2.5, saturation_level: 250")
    three.edit("rig.yaml", "name: light1", "name: first")
    three.mesh.rename(three.folder / "renamed.stl")
    three.edit("part.yaml", "knob.stl", "renamed.stl")
    assert design(three.rig, three.part, three.out, options=KEPT, force=True).reused == 2
    three.edit("rig.yaml", "bit_depth: 8,", "bit_depth: 8, black_level: 3,")
    assert design(three.rig, three.part, three.out, options=KEPT, force=True).reused == 0


def test_the_matrix_depends_on_the_version_of_what_loads_the_mesh(three, monkeypatch):
    design(three.rig, three.part, three.out, options=KEPT)
    monkeypatch.setattr("lightopt.core.provenance.versions", lambda: {**versions(), "trimesh": "0"})
    assert design(three.rig, three.part, three.out, options=KEPT, force=True).reused == 0


def test_matrices_are_held_together_only_where_lights_are_common(three, monkeypatch):
    refs: list[weakref.ref[LuminanceMatrix]] = []
    alive: list[int] = []
    real = _matrices.PostureMatrices.matrix

    def make(*arguments, **options):
        alive.append(sum(ref() is not None for ref in refs))
        made = real(*arguments, **options)
        refs.append(weakref.ref(made))
        return made

    monkeypatch.setattr(_matrices.PostureMatrices, "matrix", make)
    options = replace(KEPT, keep_matrix=False)
    design(three.rig, three.part, three.out / "own", options=options)
    design(three.rig, three.part, three.out / "common", options=replace(options, common_lights=True))
    assert alive == [0, 0, 0, 1]


def test_the_budget_is_of_all_that_is_held(three, monkeypatch):
    options = replace(KEPT, keep_matrix=False)
    found = design(three.rig, three.part, three.out, options=options)
    positions, patches = sum(found.candidates.space.sizes), max(result.patches for result in found.results)
    monkeypatch.setattr(_matrices, "MOST_BYTES", round(1.5 * positions * patches))
    design(three.rig, three.part, three.out, options=options)
    with pytest.raises(InputError, match=r"GB; raise option 'step_deg' or lower option 'patch_budget'"):
        design(three.rig, three.part, three.out / "all", options=replace(options, common_lights=True))
