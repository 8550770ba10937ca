"""The benchmarks run, at toy size, and what they say is what they measured."""

from __future__ import annotations

import csv
import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks import auto, bare, batch, command, dataset, displaced, peers
from benchmarks._case import TOY, case_scene, chrome, resized
from benchmarks._peer_process import MITSUBA, PeerError, PeerProcess
from benchmarks._reference import equally_spaced, gauss_legendre, sum_of_points
from benchmarks._report import Table, ratios, rounds
from benchmarks.detector_training import DATASET, INSPECT, PASTED, Curve, Study
from benchmarks.run import main
from lightopt.defects import (
    BUILT_IN_CATALOGUE,
    SHAPE_KINDS,
    CatalogueEntry,
    PlacedDefect,
    radial_place,
    surface_coordinates,
)
from lightopt.geometry import RayCaster, TriangleMesh, face_areas, face_normals
from lightopt.rendering import cast_rays_at, render_posture, trace_samples
from lightopt.scene import Scene

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return case_scene(TOY)


def test_rounds_interleave_and_ratios_are_of_the_least_and_of_the_rounds() -> None:
    order: list[str] = []
    seconds = rounds({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b"] * 3
    assert {name: len(times) for name, times in seconds.items()} == {"a": 3, "b": 3}
    assert ratios([4.0, 9.0, 8.0], [2.0, 3.0, 1.0]) == (4.0, 3.0)


def test_table_columns_line_up() -> None:
    text = Table("title", ("", "s"), [("long name", "1"), ("x", "12.5")]).text()
    assert text.splitlines() == ["title", "                s", "  long name     1", "  x          12.5"]


@pytest.mark.nightly
def test_replay_casts_the_rays_of_the_run(scene: Scene) -> None:
    rays = bare.record_rays(scene)
    images = bare.render_from_mesh(scene)
    # bare embreex gets the rays, too, that lightopt proves free and does not cast
    assert rays.count > images.rays
    answers = {bare.replay(rays, block=block, threads=threads)() for block in (100, 10_000) for threads in (1, 2)}
    hits = int(images.geometry.hit.sum())
    assert {hit for hit, _ in answers} == {hits}
    assert len({blocked for _, blocked in answers}) == 1
    # no ray of the four times four points was cast below the horizon, and some are
    assert len(rays.shadow[0]) < 16 * hits


@pytest.mark.slow
def test_a_smaller_sensor_sees_the_same(scene: Scene) -> None:
    wide = resized(scene.camera, 4 * scene.camera.width)
    assert wide.height == 4 * scene.camera.height
    assert wide.width * wide.pixel_size == pytest.approx(scene.camera.width * scene.camera.pixel_size)


@pytest.mark.nightly
def test_reference_on_a_grid_is_the_render_with_as_many_points(scene: Scene) -> None:
    caster = cast_rays_at(scene)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5))
    hits, surface = trace_samples(caster, scene.mesh, scene.camera, column, row)
    four = render_posture(scene, scene.postures[0], caster=caster)
    for light, image in zip(scene.lights, four.lights, strict=True):
        level, _ = sum_of_points(
            surface, equally_spaced(light, 2), reflectance=scene.reflectance, caster=caster, threads=1
        )
        np.testing.assert_allclose(level, image.level.ravel()[hits.ray], rtol=1e-5)


def test_reference_rules_weigh_the_whole_panel(scene: Scene) -> None:
    light = scene.lights[0]
    for rule in (equally_spaced, gauss_legendre):
        panel = rule(light, 6)
        assert panel.weights.sum() == pytest.approx(light.total_weight)
        np.testing.assert_allclose(panel.weights @ panel.positions, light.centre, atol=1e-9)
        offset = panel.positions - light.centre
        assert np.abs(offset @ light.across).max() < 30.0
        assert np.abs(offset @ light.outward).max() < 1e-9


def test_comparison_counts_unsaturated_pixels_and_saturated_areas() -> None:
    against = np.array([10.0, 20.0, 1000.0, 254.4, 254.6, 300.0])
    levels = np.array([10.05, 20.3, 1000.0, 254.5, 254.6, 200.0])
    found = auto.compare(levels, against, 255)
    assert found.unsaturated == 2
    assert found.largest == pytest.approx(0.3)
    assert found.over == 0.5
    assert found.area == 1.0
    assert math.isnan(auto.compare(levels[:2], against[:2], 255).area)


@pytest.mark.nightly
def test_auto_is_converged_at_the_highlights_of_chrome(scene: Scene) -> None:
    shiny = chrome(scene)
    found = auto.exactness("chrome", shiny, 48, near=False)
    lit = {what: comparison for name, what, comparison in found if name == "chrome"}
    assert lit["auto – Gauss"].largest < 0.2
    assert lit["m = 4 – Gauss"].largest > 20.0


def test_agreement_is_the_share_of_lit_pixels() -> None:
    ours = [np.array([[0.0, 1.0, 2.0, 3.0]], np.float32)]
    theirs = [np.array([[0.0, 1.0005, 2.1, 0.0]], np.float32)]
    assert peers.agreement(theirs, ours) == pytest.approx(1 / 3)
    assert peers.agreement(ours, ours) == 1.0


def test_a_peer_with_other_pictures_gets_no_ratio() -> None:
    names = ("lightopt", "other")
    seconds = {f"{name}: {step}": [1.0] for name in names for step in ("build", "images")}
    table = peers.table("part", names, dict.fromkeys(names, (1.0, 1.0)), {"lightopt": 1.0, "other": 0.9}, seconds)
    ours, other = table.rows
    assert ours[-2:] == ("1.00", "1.00")
    assert other[1] == "90.000 %: disagrees"
    assert other[-2:] == ("–", "–")


@pytest.mark.nightly
def test_peers_render_our_pictures() -> None:
    there, missing = peers.start_peers(TOY, "spout")
    images = {}
    for peer in there:
        peer.build(), peer.images()
        images[peer.name] = peer.levels()
        peer.close()
    assert {"lightopt", "trimesh.ray + NumPy"} <= set(images)
    assert len(images) + len(missing) == 4
    for theirs in images.values():
        assert peers.agreement(theirs, images["lightopt"]) >= peers.AGREEMENT


# as Dr.Jit 1.5 says it
INACTIVE = (
    "ImportError: jit_init_thread_state(): the LLVM backend is inactive because the LLVM shared library "
    '("libLLVM.so") could not be found! Set the DRJIT_LIBLLVM_PATH environment variable to specify its path.\n'
)
LLVM_TOO_OLD = (
    "jit_llvm_init(): the located LLVM version (14) is too old. The Dr.Jit LLVM backend requires LLVM 15 or newer "
    f"for opaque pointer support, shutting down LLVM backend..\n{INACTIVE}"
)
NO_LLVM = (
    'jit_find_library(): Unable to load "libLLVM.so": libLLVM.so: cannot open shared object file: No such file or '
    f"directory!\njitc_llvm_init(): LLVM API initialization failed ..\n{INACTIVE}"
)


def refused(name: str, said: str, end: str) -> str:
    """What is said of a peer whose process says something on standard error and ends."""
    program = f"import os, sys; sys.stderr.write({said!r}); sys.stderr.flush(); {end}"
    with pytest.raises(PeerError) as error:
        PeerProcess(name, TOY, "spout", program=(sys.executable, "-c", program))
    head, _, reason = str(error.value).partition(": ")
    assert head == f"{name} does not run here and is left out"
    assert "\n" not in reason
    return reason


@pytest.mark.parametrize(
    ("said", "end", "words"),
    [
        (LLVM_TOO_OLD, "sys.exit(1)", "LLVM 14 is too old: "),
        (NO_LLVM, "sys.exit(1)", "there is no LLVM: "),
        (
            "LLVM ERROR: Cannot select: f32 = fminimum\n",
            "os.abort()",
            "its LLVM ended the process (LLVM ERROR: Cannot select: f32 = fminimum): ",
        ),
    ],
)
def test_mitsuba_without_an_llvm_is_one_line_that_says_what_to_install(said, end, words) -> None:
    assert refused(MITSUBA, said, end).startswith(f"{words}install Debian's package libllvm19 or a later one")


@pytest.mark.parametrize(
    ("name", "said", "words"),
    [
        ("lightopt", "LLVM ERROR: out of memory", "LLVM ERROR: out of memory"),
        (
            "lightopt",
            "numba.core.errors.LoweringError: LLVM IR parsing error",
            "numba.core.errors.LoweringError: LLVM IR parsing error",
        ),
        (MITSUBA, "RuntimeError: LLVM kernel failed", "RuntimeError: LLVM kernel failed"),
    ],
)
def test_no_llvm_of_the_system_is_missed_by_what_merely_names_llvm(name, said, words) -> None:
    assert refused(name, said, "sys.exit(1)") == words


@pytest.mark.parametrize(
    ("said", "end", "words"),
    [
        (
            "OSError: libusb-1.0.so.0: cannot open shared object file: No such file or directory",
            "sys.exit(1)",
            "it lacks libusb-1.0.so.0: install Debian's package libusb-1.0-0",
        ),
        (
            "ImportError: libGL.so.1: cannot open shared object file: No such file or directory",
            "sys.exit(1)",
            "it lacks libGL.so.1: install Debian's package libgl1",
        ),
        ("ModuleNotFoundError: No module named 'open3d'", "sys.exit(1)", "open3d is not installed"),
        ("", "os.abort()", "its process was ended by signal 6"),
        ("", "sys.exit(3)", "its process ended with status 3"),
    ],
)
def test_a_peer_that_does_not_run_is_one_line_that_says_what_to_install(said, end, words) -> None:
    assert refused("other", said, end).startswith(words)


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_a_peer_that_could_not_be_installed_is_tried_again(tmp_path: Path) -> None:
    """By the Makefile, with a Python that writes down what it is asked for."""
    (tmp_path / "bin").mkdir()
    python = tmp_path / "bin" / "python"
    (tmp_path / ".installed").touch()

    def run(fails: str) -> list[str]:
        python.write_text(
            f'#!/bin/sh\necho "$@" >>{tmp_path}/log\ncase "$*" in *{fails}*) exit 1;; esac\n', encoding="utf-8"
        )
        python.chmod(0o755)
        (tmp_path / "log").write_text("", encoding="utf-8")
        peers_installed = f"{tmp_path}/.peers"
        subprocess.run(
            ["make", "--silent", f"BENCH={tmp_path}", peers_installed], cwd=ROOT, check=True, stdout=subprocess.PIPE
        )
        return (tmp_path / "log").read_text(encoding="utf-8").splitlines()

    first = run("mitsuba")
    assert ["mitsuba" in line for line in first] == [True, False], "the rest is installed"
    assert all(f"--constraint {tmp_path}/constraints.txt" in line for line in first)
    assert len(run("nothing")) == 2, "tried again"
    assert run("nothing") == []


@pytest.mark.slow
def test_a_peer_that_ends_later_on_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(size: object, part: str) -> tuple[list[PeerProcess], list[str]]:
        assert size == TOY
        ends = "import sys; print('1', flush=True); input(); sys.exit('no memory')"
        return [PeerProcess(name, TOY, part, program=program(name, ends)) for name in ("lightopt", "other")], []

    def program(name: str, ends: str) -> tuple[str, ...] | None:
        return (sys.executable, "-c", ends) if name == "other" else None

    monkeypatch.setattr(peers, "start_peers", start)
    report = peers.run(TOY)
    assert [row[0] for row in report.tables[0].rows] == ["lightopt"]
    assert "other does not run here and is left out: no memory" in report.notes


def test_measure_says_how_much_memory_and_refuses_a_failed_command() -> None:
    small = command.measure([sys.executable, "-c", "pass"])
    if sys.platform != "win32":
        large = command.measure([sys.executable, "-c", "x = b'x' * 200_000_000"])
        assert 180e6 < large["peak_bytes"] - small["peak_bytes"] < 230e6
    with pytest.raises(RuntimeError, match="status 3: sorry"):
        command.measure([sys.executable, "-c", "import sys; print('sorry', file=sys.stderr); sys.exit(3)"])


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name",
    ["bare", "peers", "auto", "command", "search", "detectability", "plan", "fit", "inspecting", "capture", "growth"],
)
def test_each_benchmark_runs_and_writes_its_numbers(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([name, "--toy", "--out", str(tmp_path)])
    written = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert written["size"]["name"] == "toy"
    assert written["machine"]["cores"] >= 1
    assert written["numbers"]
    assert str(tmp_path / f"{name}.json") in capsys.readouterr().out
    for table in written["tables"]:
        assert table["rows"]
        assert all(len(row) == len(table["header"]) for row in table["rows"])


def test_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["bear"])
    assert refused.value.code == 2
    assert "no benchmark bear" in capsys.readouterr().err


@pytest.mark.nightly
def test_the_overhead_of_a_capture_is_what_its_times_leave() -> None:
    from benchmarks import capture

    numbers = capture.run(TOY).numbers
    for case in capture.CASES:
        found = numbers[case]
        assert isinstance(found, dict)
        needed = found["settling_s"] + found["frames_s"]
        assert found["settling_s"] == pytest.approx(0.2 + 5 * 0.1)  # the stage, and four lights
        assert found["overhead"] == pytest.approx(
            (found["whole_s"] - found["opening_s"] - found["closing_s"] - found["moving_s"] - needed) / needed, rel=1e-6
        )


@pytest.mark.nightly
def test_the_benchmark_of_inspections_fills_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    from benchmarks import inspection

    before = inspection.PAGE.read_bytes()
    inspection.main(["--toy", "--sets", "1", "--workers", "1"])
    assert inspection.PAGE.read_bytes() == before
    lines = capsys.readouterr().out.splitlines()
    ways = [line.split(" | ") for line in lines if line.startswith(("| residual", "| template"))]
    assert len(ways) == 2 + 4 + len(inspection.FUSIONS) + 5
    default = next(way for way in ways if inspection.TWO_AGREE in way[0])
    assert float(default[1]) > 0.85
    assert default[3].startswith("0, good part 0")
    assert inspection.TOY.defects == 12
    assert sum(" of 1 |" in line for line in lines) == 12
    found = sum(" 1 of 1 |" in line for line in lines)
    assert default[2] == f"{found} of 12"
    assert sum(line.startswith("| cover-knob | ") for line in lines) == len(inspection.FUSIONS)


@pytest.mark.nightly
def test_the_benchmark_of_the_catalogue_compares_both_detectors(capsys: pytest.CaptureFixture[str]) -> None:
    from benchmarks import catalogue

    catalogue.main(["--toy", "--sets", "1"])
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| cover-knob")]
    assert len(rows) == len(catalogue.EFFECTS) * len(catalogue.SEEN_IN) * len(catalogue.DETECTORS)
    found = {(*row[1:4],): int(row[4 + len(catalogue.KINDS)].split(" of ")[0]) for row in rows}
    for images in ("1", "2"):
        assert found["1", images, "catalogue"] >= found["1", images, "residual"]


def detectors(more: int) -> Study:
    """Two trainings, of which the first finds so many of ten defects more on each of twelve pieces, and inspect."""
    rng = np.random.default_rng(1)
    plain = rng.integers(2, 6, (3, 12, 1))
    # no false alarm at the first threshold, one on each second good piece at the next one, more below
    alarms = np.array([[0] * 8, [0, 1] * 4, [3] * 8])

    def curves(found: NDArray[np.int_], area: float) -> list[Curve]:
        return [Curve(alarms, np.stack([0 * own, own, own + 1]), np.full(12, area)) for own in found]

    inspect = Curve(np.zeros((1, 4), np.int_), np.full((1, 12, 1), 4), np.full(12, 0.8))
    trained = {DATASET: curves(plain + more, 0.8), PASTED: curves(plain, 0.7), INSPECT: [inspect]}
    return Study("part", ["dent"], np.full((12, 1), 10), 8, trained)


def test_trained_detectors_are_compared_on_the_same_pieces_at_the_same_false_alarms() -> None:
    better, same = detectors(1), detectors(0)
    # pieces and trainings differ by far more than one defect, and in both alike
    assert better.differences(1.0, PASTED) == pytest.approx(np.full((2, 3), 0.1))
    assert same.differences(1.0, PASTED)[0] == pytest.approx([0.0, 0.0, 0.0])
    # the good pieces may be others, with more than one false alarm on each second one
    assert better.differences(0.5, PASTED)[0] == pytest.approx([0.1, 0.0, 0.1])
    value, low, high = better.differences(1.0, INSPECT)[0]
    assert low < value < high
    curve = better.curves[DATASET][0]
    assert [curve.least(rate, np.arange(8)) for rate in (0.1, 0.5, 2.9, 3.0)] == [0, 1, 1, 2]
    assert better.curves[INSPECT][0].least(0.1, np.arange(8)) == 0
    rows = [row for row in better.rows() if row.trained_on == DATASET and row.rate == 1.0]
    assert [row.found for row in rows] == [int(one.found[1].sum()) for one in better.curves[DATASET]]
    assert {row.false_alarms for row in rows} == {4}


def disturbed_plane(entry: CatalogueEntry) -> tuple[PlacedDefect, TriangleMesh]:
    """A defect in a square of 8 mm, and the square refined under it."""
    corners = np.array([[-4.0, -4.0, 0.0], [4.0, -4.0, 0.0], [4.0, 4.0, 0.0], [-4.0, 4.0, 0.0]])
    square = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.tile([0.0, 0.0, 1.0], (4, 1)))
    turn = math.radians(25.0)
    defect = PlacedDefect(
        name=entry.name,
        shape=entry.shape,
        position=np.array([0.3, -0.2, 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        along=np.array([math.cos(turn), math.sin(turn), 0.0]),
    )
    return defect, displaced.refined(square, [defect], 0.1)


SHAPES = [entry for entry in BUILT_IN_CATALOGUE if entry.shape.kind in SHAPE_KINDS]


@pytest.mark.parametrize("entry", SHAPES, ids=lambda entry: entry.name)
def test_a_displaced_mesh_has_the_depth_and_the_normals_of_the_model(entry: CatalogueEntry) -> None:
    """The facets are those of the heights, the vertices' normals those of the model's gradient."""
    defect, fine = disturbed_plane(entry)
    moved = displaced.displaced(fine, [defect])
    assert moved.normals is not None
    deepest = moved.vertices[np.abs(moved.vertices[:, 2]).argmax(), 2]
    upwards = entry.shape.kind in ("bump", "blister")
    assert deepest == pytest.approx(entry.shape.depth if upwards else -entry.shape.depth, rel=0.01)
    facets, model = face_normals(moved), moved.normals[moved.faces].mean(axis=1)
    assert moved.normals[:, 2].min() == pytest.approx(math.cos(entry.shape.slope), abs=1e-3)
    off = np.linalg.norm(facets - model, axis=1)
    assert off.max() < 0.15 * math.tan(entry.shape.slope)


@pytest.mark.parametrize("entry", SHAPES, ids=lambda entry: entry.name)
def test_a_refined_mesh_is_the_same_surface(entry: CatalogueEntry) -> None:
    defect, fine = disturbed_plane(entry)
    assert face_areas(fine).sum() == pytest.approx(64.0)
    assert np.abs(fine.vertices[:, 2]).max() == 0.0
    corners = fine.vertices[fine.faces]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    x, y, _ = surface_coordinates(defect, corners.mean(axis=1), np.tile(defect.normal, (len(corners), 1)))
    inside = radial_place(entry.shape, x, y) < 1.0
    assert sides[inside].max() <= min(0.1 / 3, entry.shape.width / 30)


def test_refined_normals_are_those_that_shading_interpolates() -> None:
    entry = SHAPES[1]
    defect, _ = disturbed_plane(entry)
    corners = np.array([[-4.0, -4.0, 0.0], [4.0, -4.0, 0.0], [0.0, 5.0, 0.0]])
    leaning = np.array([[-0.2, -0.2, 1.0], [0.2, -0.2, 1.0], [0.0, 0.2, 1.0]])
    leaning /= np.linalg.norm(leaning, axis=1)[:, None]
    fine = displaced.refined(TriangleMesh(corners, np.array([[0, 1, 2]], np.int32), leaning), [defect], 0.1)
    assert fine.normals is not None
    weights = np.linalg.solve(
        np.vstack([corners[:, :2].T, np.ones(3)]), np.vstack([fine.vertices[:, :2].T, np.ones(len(fine.vertices))])
    )
    expected = weights.T @ leaning
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    np.testing.assert_allclose(fine.normals, expected, atol=1e-12)


@pytest.mark.parametrize("light_deg", [25.0, 10.0])
def test_the_reach_of_a_shadow_is_that_of_rays(light_deg: float) -> None:
    """Rays along the ground towards a light find the last place in the shadow of a blister with walls of 22°."""
    entry = next(entry for entry in SHAPES if entry.shape.kind == "blister")
    shape = replace(entry.shape, slope=math.radians(22.0))
    defect, fine = disturbed_plane(replace(entry, shape=shape))
    moved = displaced.displaced(fine, [defect])
    x = np.linspace(0.5 * shape.width, 3.0, 400)
    ground = np.stack([defect.position[0] + x, np.full(len(x), defect.position[1]), np.zeros(len(x))], axis=1)
    elevation = math.radians(light_deg)
    light = defect.position + 1e3 * np.array([-math.cos(elevation), 0.0, math.sin(elevation)])
    dark = RayCaster(moved.vertices, moved.faces).occluded(
        ground,
        np.tile([0.0, 0.0, 1.0], (len(x), 1)),
        light[None],
        point_index=np.arange(len(x), dtype=np.int32),
        target_index=np.zeros(len(x), np.int32),
    )
    reach = x[dark].max(initial=0.5 * shape.width) - 0.5 * shape.width
    assert reach == pytest.approx(displaced.reach_bound(shape, elevation), abs=0.01)
    assert (reach > 0.0) == (light_deg < 22.0)


@pytest.mark.nightly
def test_the_benchmark_of_lights_from_images_fills_its_tables(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from benchmarks import from_images

    monkeypatch.setattr(sys, "argv", ["from_images", "--toy"])
    from_images.main()
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("  as filed, ") for line in lines) == 4  # of one frame, and of the mean of four
    assert sum(" of 8 " in line and " proven " in line for line in lines) == 1
    assert sum(" of 4 " in line for line in lines) >= 3


@pytest.mark.nightly
def test_the_benchmark_of_displaced_defects_compares_images_and_what_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = ["--parts", "cover-knob", "--seeds", "1", "--count", "14", "--width", "400", "--supersample", "2"]
    displaced.main([*size, "--toy", "--factors", "1", "4", "--out", str(tmp_path)])
    with (tmp_path / "displaced.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * len(SHAPE_KINDS)
    assert all(float(row["floor_max"]) < 0.05 for row in rows)
    own = {factor: [row for row in rows if row["factor"] == factor] for factor in ("1.0", "4.0")}
    assert all(0.9 < float(row["energy"]) < 1.1 and float(row["correlation"]) > 0.95 for row in own["1.0"])
    off = [np.median([float(row["inside_rms"]) for row in some]) for some in own.values()]
    assert off[1] > 4.0 * off[0]
    assert all(float(row["reach"]) <= float(row["reach_bound"]) + displaced.SLACK_MM for row in rows)
    assert "| 4 | blister | 2, 2 of 2 | 0, 0 |" in capsys.readouterr().out


@pytest.mark.nightly
def test_the_benchmark_of_calibration_counts_good_sets() -> None:
    from benchmarks import calibration

    rows = calibration.try_part(("cover-knob", 5, calibration.TOY, 0.5))
    cells = [row.strip("| ").split(" | ") for row in rows]
    assert [row[:2] for row in cells] == [["cover-knob", "residual"], ["cover-knob", "template"]]
    for row in cells:
        plain, held = (int(row[k].split(" of ")[0]) for k in (2, 4))
        assert plain >= 3
        assert held <= 2


@pytest.mark.nightly
def test_the_benchmark_of_references_counts_good_and_bad_parts(capsys: pytest.CaptureFixture[str]) -> None:
    from benchmarks import inspection, references

    before = inspection.PAGE.read_bytes()
    references.main(["--toy", "--workers", "1"])
    assert inspection.PAGE.read_bytes() == before
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| br")]
    assert [row[1] for row in rows] == ["model", "good-parts", "self"]
    assert rows[0][2].startswith("2 of 2 ")  # brush marks are not in the model
    assert rows[2][2].startswith("0 of 2 ")
    assert all(int(row[3].split(" of ")[0]) >= 5 for row in rows[1:])


def test_a_mesh_of_an_emitter_looks_as_large_from_the_origin_as_the_light() -> None:
    from benchmarks import light_kinds
    from lightopt.lights import RADIANCE, SurfaceLight

    for kind, case in light_kinds.CASES.items():
        config, light = light_kinds.built(kind)
        own, whole = light_kinds.placed_meshes(case, config)
        if isinstance(light, SurfaceLight):
            angle = sum(mesh.solid_angle() for mesh in whole)
            brightest = max(mesh.factor for mesh in own) / angle
            assert light.elements[:, RADIANCE].max() == pytest.approx(brightest, rel=1e-4), kind


@pytest.mark.nightly
def test_the_benchmarks_of_batches_and_datasets_print_what_they_measure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["batch", "--parts", "1", "--rounds", "1", "--tasks", "2"])
    batch.main()
    assert "batch, two workers" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["batch", "--plan", "--posture-step", "90"])
    batch.main()
    assert "_counts_of_row" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["dataset", "--parts", "cover-knob", "--images", "2", "--width", "160"])
    dataset.main()
    assert "| cover-knob | 8 | no | 8 |" in capsys.readouterr().out
