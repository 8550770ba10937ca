"""``lightopt render``: what each option writes and says, and what running it again does."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from lightopt.core.provenance import file_sha256
from lightopt.images import read_exr, read_image_set, read_metadata, read_png
from lightopt.optics import Sensor, expose
from lightopt.report import contact_sheet
from lightopt.scene import build_camera, project

SPOUT = Path(__file__).resolve().parents[2] / "configs" / "parts" / "spout.stl"
FEW = ("--patches", "500")  # as few patches as there are triangles: fast
FULL = ("--layers", "--exposure", "1,1/16", *FEW)


@pytest.fixture(scope="module")
def rendered(shared_bench, tmp_path_factory):
    """A set with layers and two exposures that the tests of its content share."""
    from lightopt.cli._main import run

    out = tmp_path_factory.mktemp("rendered") / "set"
    assert run(["render", str(shared_bench.rig), str(shared_bench.part), "-o", str(out), "-q", *FULL]) == 0
    return read_image_set(out)


def lights_of(folder):
    return [(e.light, str(e.posture)) for e in read_image_set(folder).images]


# --- what is written and said


def test_all_lights_and_postures_are_rendered_and_listed(cli, bench):
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW)
    assert (ran.status, ran.err) == (0, "")
    first, second, third = ran.out.splitlines()
    assert first.startswith("4 images, ")
    assert first.endswith(" million rays")
    assert "visible patches" in second
    assert third == str(bench.out / "manifest.json")
    image_set = read_image_set(bench.out)
    assert [(e.light, e.posture.rotation_deg, e.exposure) for e in image_set.images] == [
        ("light1", 0.0, 1.0),
        ("light3", 0.0, 1.0),
        ("light1", 170.0, 1.0),
        ("light3", 170.0, 1.0),
    ]
    assert [(e.light_elevation_deg, e.light_azimuth_deg) for e in image_set.images[:2]] == [(60, 45), (45, 225)]
    written = {p.relative_to(bench.out).as_posix() for p in bench.out.rglob("*") if p.is_file()}
    folders = ("posture_0_0", "posture_-10_170")
    assert written == {"manifest.json", "patches.npz"} | {
        f"{folder}/{name}"
        for folder in folders
        for name in ("geometry.exr", "light1.exr", "light1.png", "light3.exr", "light3.png")
    }
    raw = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    assert raw["format"] == "lightopt-images/1"
    assert raw["kind"] == "simulated"
    assert str(bench.folder) not in json.dumps(raw), "the same files elsewhere must give the same manifest"


def test_quiet_says_nothing(cli, bench):
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--quiet")
    assert (ran.status, ran.out, ran.err) == (0, "", "")


def test_the_output_folder_is_made_with_its_parents(cli, bench):
    deep = bench.folder / "a" / "b" / "c"
    assert cli("render", bench.rig, bench.part, "-o", deep, *FEW, "-q").status == 0
    read_image_set(deep)


def test_light_selects_and_repeats(cli, bench):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--light", "light3").status == 0
    assert lights_of(bench.out) == [("light3", "(0°, 0°)"), ("light3", "(-10°, 170°)")]
    both = bench.folder / "both"
    ran = cli("render", bench.rig, bench.part, "-o", both, *FEW, "-q", "--light", "light3", "--light", "light1")
    assert ran.status == 0
    assert len(lights_of(both)) == 4


def test_a_light_left_out_at_first_is_added_to_the_same_set(cli, bench):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--light", "light1").status == 0
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW)
    assert ran.status == 0
    assert ran.out.startswith("4 images (2 of them existed already)")
    assert sorted(lights_of(bench.out)) == sorted(
        (light, posture) for light in ("light1", "light3") for posture in ("(0°, 0°)", "(-10°, 170°)")
    )


def test_posture_replaces_those_of_the_part_and_repeats(cli, bench):
    ran = cli(
        "render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--posture", "-12.5,30", "--posture", "0, 278"
    )
    assert ran.status == 0, ran.err
    postures = [(g.posture.elevation_deg, g.posture.rotation_deg) for g in read_image_set(bench.out).geometry]
    assert postures == [(-12.5, 30.0), (0.0, 278.0)]
    assert (bench.out / "posture_-12.5_30" / "light1.png").is_file()


def test_points_replace_those_of_the_rig(cli, bench):
    levels = {}
    for points in ("1", "4", "auto"):
        out = bench.folder / points
        assert cli("render", bench.rig, bench.part, "-o", out, *FEW, "-q", "--points", points).status == 0
        levels[points] = read_exr(out / "posture_0_0" / "light1.exr")["Y"]
    plain = bench.folder / "plain"
    assert cli("render", bench.rig, bench.part, "-o", plain, *FEW, "-q").status == 0
    assert np.array_equal(read_exr(plain / "posture_0_0" / "light1.exr")["Y"], levels["4"])  # the rig's own
    assert not np.array_equal(levels["1"], levels["4"])
    assert not np.array_equal(levels["auto"], levels["4"])


def test_exposure_scales_the_png_and_leaves_the_exr(cli, bench):
    out = {}
    for exposure in ("1", "1/16", "0.0625"):
        out[exposure] = bench.folder / exposure.replace("/", "_")
        ran = cli("render", bench.rig, bench.part, "-o", out[exposure], *FEW, "-q", "--exposure", exposure)
        assert ran.status == 0
    exr = [(folder / "posture_0_0" / "light1.exr").read_bytes() for folder in out.values()]
    assert exr[0] == exr[1] == exr[2]
    dark = out["1/16"] / "posture_0_0" / "light1_x0.0625.png"
    assert dark.read_bytes() == (out["0.0625"] / "posture_0_0" / "light1_x0.0625.png").read_bytes()
    assert [e.exposure for e in read_image_set(out["1/16"]).images] == [0.0625] * 4
    bright = read_png(out["1"] / "posture_0_0" / "light1.png")
    diffuse = (bright > 20) & (bright < 40)
    assert (read_png(dark)[diffuse] == np.floor(bright[diffuse] / 16 + 0.5)).mean() > 0.9


def test_no_shadows_only_adds_light(cli, bench):
    shutil.copyfile(SPOUT, bench.folder / "spout.stl")
    bench.edit("part.yaml", "knob.stl", "spout.stl")
    levels = []
    for option in ([], ["--no-shadows"]):
        out = bench.folder / f"out{len(option)}"
        assert cli("render", bench.rig, bench.part, "-o", out, *FEW, "-q", *option).status == 0
        levels.append(read_exr(out / "posture_0_0" / "light3.exr")["Y"])
    assert (levels[1] >= levels[0]).all()
    assert (levels[1] > levels[0] + 1).sum() > 100


def test_supersample_smooths_the_silhouette_and_keeps_the_geometry(cli, bench):
    sets = {}
    for n in ("1", "3"):
        out = bench.folder / n
        assert cli("render", bench.rig, bench.part, "-o", out, *FEW, "-q", "--supersample", n).status == 0
        sets[n] = {name: read_exr(out / "posture_0_0" / f"{name}.exr") for name in ("geometry", "light1")}
    for name, values in sets["1"]["geometry"].items():
        assert np.array_equal(values, sets["3"]["geometry"][name]), name
    missed = sets["1"]["geometry"]["Z"] == 0
    assert (sets["1"]["light1"]["Y"][missed] == 0).all()
    assert (sets["3"]["light1"]["Y"][missed] > 0).any()  # a pixel whose centre misses still sees some of the part


def test_patches_bounds_the_table(cli, bench):
    counts = []
    for budget in ("4000", "16000"):
        out = bench.folder / budget
        ran = cli("render", bench.rig, bench.part, "-o", out, "--patches", budget)
        assert ran.status == 0
        with np.load(out / "patches.npz") as table:
            visible = table["visible"].any(axis=0).sum()
            assert len(table["areas"]) == len(table["centroids"]) == table["visible"].shape[1]
        assert f"{visible:,} visible patches" in ran.out
        assert visible <= 1.1 * int(budget)
        counts.append(visible)
    assert counts[1] > 2 * counts[0]


def test_sheet_is_written_and_named(cli, bench):
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--sheet")
    assert ran.status == 0
    sheet = bench.out / "contact-sheet.png"
    assert ran.out.splitlines()[-1] == f"contact sheet, exposure 1: {sheet}"
    # under the names that the files give, not those of the files, and listed with its hash
    image_set = read_image_set(bench.out)
    assert image_set.manifest.files["contact-sheet.png"] == file_sha256(sheet)
    again = contact_sheet(image_set, bench.folder / "again.png", exposure=1, title="knob on small")
    assert sheet.read_bytes() == again.read_bytes()
    otherwise = contact_sheet(image_set, bench.folder / "files.png", exposure=1)
    assert sheet.read_bytes() != otherwise.read_bytes()


def test_every_exposure_gets_a_sheet(cli, bench):
    exposures = ("--exposure", "1/16,1")
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--sheet", *exposures)
    assert ran.status == 0
    names = ["contact-sheet_x0.0625.png", "contact-sheet.png"]
    reported = [f"contact sheet, exposure {e}: {bench.out / n}" for e, n in zip(("0.0625", "1"), names, strict=True)]
    assert ran.out.splitlines()[-2:] == reported
    assert set(read_image_set(bench.out).manifest.files) == {"patches.npz", *names}
    short, long = (bench.out / name for name in names)
    assert short.read_bytes() != long.read_bytes()
    before = short.read_bytes(), long.read_bytes()
    long.unlink()
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--sheet", *exposures).status == 0
    assert (short.read_bytes(), long.read_bytes()) == before


def test_a_sheet_does_not_replace_a_file_of_others(cli, bench):
    bench.out.mkdir()
    stranger = bench.out / "contact-sheet.png"
    stranger.write_bytes(b"mine")
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--sheet")
    assert ran.status == 2
    assert f"{stranger}: exists with other content; use --force" in ran.err
    assert stranger.read_bytes() == b"mine"


def test_one_image_is_not_one_images(cli, bench):
    one = ("--light", "light1", "--posture", "0,0")
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, *one).out.startswith("1 image, ")


def test_the_progress_bar_shows_on_a_terminal_and_not_when_quiet(cli, bench, monkeypatch):
    import sys

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW)
    assert ran.status == 0
    assert "rendering" in ran.err
    assert "rendering -10,170" in ran.err
    assert cli("render", bench.rig, bench.part, "-o", bench.folder / "b", *FEW, "--quiet").err == ""


# --- the images themselves


def test_layers_add_up_to_the_image(rendered):
    for entry in rendered.images[:2]:
        channels = read_exr(rendered.path(entry.exr))
        assert set(channels) == {"Y", "diffuse.Y", "specular.Y"}
        total = channels["diffuse.Y"].astype(np.float64) + channels["specular.Y"]
        assert np.abs(total - channels["Y"]).max() <= 2e-7 * channels["Y"].max()
        assert channels["specular.Y"].max() > channels["diffuse.Y"].max() > 0


def test_without_layers_there_is_only_the_image_and_it_is_the_same(cli, shared_bench, rendered, tmp_path):
    out = tmp_path / "out"
    assert cli("render", shared_bench.rig, shared_bench.part, "-o", out, *FEW, "-q").status == 0
    for entry in read_image_set(out).images:
        plain = read_exr(out / entry.exr)
        assert set(plain) == {"Y"}
        assert np.array_equal(plain["Y"], read_exr(rendered.path(entry.exr))["Y"])


def test_the_png_is_the_exposed_exr(rendered):
    assert len(rendered.images) == 8
    sensor = Sensor(bit_depth=8)
    for entry in rendered.images:
        levels = read_png(rendered.path(entry.png))
        linear = read_exr(rendered.path(entry.exr))["Y"]
        expected = expose(linear, sensor=sensor, exposure=entry.exposure, full_scale=255.0)
        assert levels.dtype == np.uint8
        assert np.array_equal(levels, expected)


def test_twelve_bits_come_in_a_sixteen_bit_container(cli, bench):
    bench.edit(
        "rig.yaml",
        "{bit_depth: 8, read_noise_levels: 0.8, electrons_per_level: 60}",
        "{bit_depth: 12, saturation_level: 4080, black_level: 64}",
    )
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--exposure", "1,1/64")
    assert ran.status == 0
    image_set = read_image_set(bench.out)
    sensor = Sensor(bit_depth=12, saturation_level=4080, black_level=64)
    assert (image_set.manifest.bit_depth, image_set.manifest.saturated_from) == (12, 4080)
    for entry in image_set.images:
        levels = read_png(image_set.path(entry.png))
        linear = read_exr(image_set.path(entry.exr))["Y"]
        assert levels.dtype == np.uint16
        assert levels.min() == 64  # where rays miss
        assert levels.max() <= 4095
        assert np.array_equal(levels, expose(linear, sensor=sensor, exposure=entry.exposure, full_scale=255.0))
        # right-aligned: 45 levels of 255 in 4095ths, not shifted up by 4 bits
        flat = (linear > 20) & (linear < 30) & (entry.exposure == 1.0)
        assert np.allclose(levels[flat], 64 + linear[flat] * 4095 / 255, atol=0.51)


def test_geometry_is_what_the_pixels_see(rendered, shared_bench):
    from lightopt import load_rig

    camera = build_camera(load_rig(shared_bench.rig))
    with np.load(rendered.folder / "patches.npz") as table:
        corners = table["vertices"][table["triangles"]]
        patch_normals = table["normals"]
    for entry in rendered.geometry:
        g = rendered.load_geometry(entry)
        assert set(g) == {"P.X", "P.Y", "P.Z", "N.X", "N.Y", "N.Z", "Z", "patch"}
        hit = g["Z"] > 0
        assert 5_000 < hit.sum() < 160 * 120
        for name, values in g.items():
            assert (values[~hit] == (-1 if name == "patch" else 0)).all(), name
        points = np.stack([g[f"P.{a}"][hit] for a in "XYZ"], axis=1).astype(np.float64)
        normals = np.stack([g[f"N.{a}"][hit] for a in "XYZ"], axis=1).astype(np.float64)
        columns, rows, depth = project(camera, points)
        seen_rows, seen_columns = np.nonzero(hit)
        assert np.abs(columns - (seen_columns + 0.5)).max() < 0.01
        assert np.abs(rows - (seen_rows + 0.5)).max() < 0.01
        assert np.allclose(np.linalg.norm(points - camera.position, axis=1), g["Z"][hit], rtol=1e-6)
        assert (g["Z"][hit] >= depth - 1e-3).all()  # along the ray, not along the axis
        assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
        # the patch named contains the point, in the part's frame
        index = g["patch"][hit]
        assert (index == index.astype(int)).all()
        index = index.astype(int)
        assert index.min() >= 0
        part_points = points @ entry.posture.matrix
        a, b, c = (corners[index][:, k] for k in range(3))
        cross = np.cross(b - a, c - a)
        area2 = np.einsum("ij,ij->i", cross, cross)
        weights = np.stack(
            [
                np.einsum("ij,ij->i", np.cross(q - p, part_points - p), cross) / area2
                for p, q in ((a, b), (b, c), (c, a))
            ]
        )
        scale = np.sqrt(area2) / np.linalg.norm(b - a, axis=1)
        height = np.einsum("ij,ij->i", part_points - a, cross) / np.sqrt(area2)
        assert np.abs(height).max() < 1e-3, "a point lies off its patch's plane"
        assert (weights * scale).min() > -2e-3, "a point lies outside its patch"
        # and the patch's normal is about the pixel's
        part_normals = normals @ entry.posture.matrix
        assert np.median(np.einsum("ij,ij->i", part_normals, patch_normals[index])) > 0.999


def test_files_found_alone_say_what_they_are(rendered):
    entry = rendered.images[0]
    facts = read_metadata(rendered.path(entry.exr))
    assert facts["light"] == "light1"
    assert facts["posture"] == {"elevation_deg": 0.0, "rotation_deg": 0.0}
    assert "exposure" not in facts
    assert "back_face_pixels" in read_metadata(rendered.path(rendered.geometry[0].exr))


# --- noise


def noisy(cli, bench, name, *options, seed="7"):
    out = bench.folder / name
    ran = cli("render", bench.rig, bench.part, "-o", out, *FEW, "-q", "--noise", seed, *options)
    assert ran.status == 0, ran.err
    return {(e.light, e.posture, e.exposure): (out / e.png).read_bytes() for e in read_image_set(out).images}


def test_noise_is_that_of_its_seed(cli, bench):
    once, again, other = (noisy(cli, bench, name, seed=seed) for name, seed in (("a", "7"), ("b", "7"), ("c", "8")))
    assert once == again
    assert all(once[key] != other[key] for key in once)
    plain = bench.folder / "plain"
    assert cli("render", bench.rig, bench.part, "-o", plain, *FEW, "-q").status == 0
    assert (plain / "posture_0_0/light1.exr").read_bytes() == (bench.folder / "a/posture_0_0/light1.exr").read_bytes()
    images = [read_png(folder / "posture_0_0/light1.png").astype(float) for folder in (plain, bench.folder / "a")]
    dark = read_exr(plain / "posture_0_0/light1.exr")["Y"] == 0
    assert 0.3 < (images[1] - images[0])[dark].std() < 0.8  # 0.8 levels, the lower half clipped at 0


@pytest.mark.parametrize(
    "options",
    [
        ("--exposure", "1/16,1"),
        ("--light", "light3"),
        ("--exposure", "1", "--light", "light1"),
        ("--posture", "-10,170"),
        ("--posture", "-10,170", "--posture", "0,0"),
        ("--posture", "30,5", "--posture", "0,0"),
        ("--threads", "1"),
        ("--layers",),
    ],
    ids=" ".join,
)
def test_noise_of_an_image_does_not_depend_on_what_else_is_requested(cli, bench, options):
    full = noisy(cli, bench, "full")
    some = noisy(cli, bench, "some", *options)
    shared = full.keys() & some.keys()
    assert shared
    assert all(full[key] == some[key] for key in shared)


def test_noise_differs_from_image_to_image(cli, bench):
    bench.edit("rig.yaml", "elevation_deg: 45, azimuth_deg: 225, gain: 0.8", "elevation_deg: 60, azimuth_deg: 45")
    noisy(cli, bench, "out")
    # now both lights stand at the same place: only the noise tells their images apart
    levels = [read_png(bench.folder / "out/posture_0_0" / f"{light}.png") for light in ("light1", "light3")]
    assert (levels[0] != levels[1]).mean() > 0.2


# --- running it again


def test_the_same_run_again_changes_no_byte_and_says_so(cli, bench, snapshot):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FULL).status == 0
    before = snapshot(bench.out)
    times = {path: path.stat().st_mtime_ns for path in bench.out.rglob("*.exr")}
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FULL)
    assert ran.status == 0
    assert ran.out.startswith("8 images (8 of them existed already), 0.0 million rays")
    assert snapshot(bench.out) == before
    assert {path: path.stat().st_mtime_ns for path in bench.out.rglob("*.exr")} == times


def test_the_same_inputs_elsewhere_give_the_same_bytes(cli, bench, shared_bench, rendered, snapshot):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, "-q", *FULL).status == 0
    assert snapshot(bench.out) == snapshot(rendered.folder)


@pytest.mark.parametrize("points", ["4", "auto"])
def test_threads_do_not_show_in_any_file(cli, shared_bench, snapshot, tmp_path, points, monkeypatch):
    from lightopt.rendering import _images

    monkeypatch.setattr(_images, "BLOCK_SAMPLES", 1000)  # many blocks, even of a small image
    for threads in ("1", "3"):
        options = ("--threads", threads, "--points", points, "--layers", "--noise", "3", "-q")
        assert cli("render", shared_bench.rig, shared_bench.part, "-o", tmp_path / threads, *FEW, *options).status == 0
    assert snapshot(tmp_path / "1") == snapshot(tmp_path / "3")


DIFFERENT = [
    (("--points", "9"), "options.points"),
    (("--noise", "1"), "options.noise"),
    (("--layers",), "options.layers"),
    (("--no-shadows",), "options.shadows"),
    (("--supersample", "2"), "options.supersample"),
    (("--patches", "4000"), "options.patch_budget"),
    (("--posture", "0,0"), "options.postures"),
]


@pytest.mark.parametrize(("options", "named"), DIFFERENT, ids=lambda x: " ".join(x) if isinstance(x, tuple) else x)
def test_other_options_are_refused_without_force(cli, bench, snapshot, options, named):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q").status == 0
    before = snapshot(bench.out)
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", *options)
    assert ran.status == 2
    assert ran.err.startswith(f"error: {bench.out}: holds the image set of another run ({named}: previously ")
    assert "--force" in ran.err
    assert snapshot(bench.out) == before
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--force", *options).status == 0
    assert snapshot(bench.out) != before
    read_image_set(bench.out)


@pytest.mark.parametrize("name", ["rig.yaml", "part.yaml", "knob.stl"])
def test_other_inputs_are_refused_without_force(cli, bench, snapshot, name):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q").status == 0
    before = snapshot(bench.out)
    if name == "knob.stl":
        shutil.copyfile(SPOUT, bench.mesh)
    else:
        bench.edit(name, "format:", "# changed\nformat:")
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q")
    assert ran.status == 2
    assert {"rig.yaml": "rig.sha256", "part.yaml": "part.sha256", "knob.stl": "mesh.sha256"}[name] in ran.err
    assert snapshot(bench.out) == before
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q", "--force").status == 0
    read_image_set(bench.out)


@pytest.mark.parametrize(
    "lost", ["patches.npz", "posture_0_0/geometry.exr", "posture_0_0/light1.exr", "posture_-10_170/light3_x0.0625.png"]
)
@pytest.mark.parametrize("how", ["deleted", "damaged"])
def test_what_was_lost_is_made_again(cli, bench, snapshot, lost, how):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, "-q", *FULL).status == 0
    before = snapshot(bench.out)
    path = bench.out / lost
    if how == "deleted":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-10])
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FULL)
    assert ran.status == 0
    assert snapshot(bench.out) == before


def test_files_of_others_in_the_way_are_left_alone(cli, bench):
    stranger = bench.out / "posture_0_0" / "light1.png"
    stranger.parent.mkdir(parents=True)
    stranger.write_text("mine")
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "-q")
    assert ran.status == 2
    assert ran.err.startswith(f"error: {stranger}: exists but belongs to no image set")
    assert stranger.read_text() == "mine"
    assert not (bench.out / "manifest.json").exists()


# --- light from the part to the part


def test_bounces_add_light_and_are_options_of_the_set(cli, bench):
    for name, options in (("direct", ()), ("bounced", ("--bounces", "1"))):
        out = bench.out.with_name(name)
        assert cli("render", bench.rig, bench.part, "-o", out, "--light", "light1", *FEW, *options).status == 0
    manifests = [json.loads((bench.out.with_name(n) / "manifest.json").read_text()) for n in ("direct", "bounced")]
    assert "bounces" not in manifests[0]["provenance"]["options"]
    assert manifests[1]["provenance"]["options"]["bounces"] == 1
    entry = manifests[0]["images"][0]["exr"]
    direct, bounced = (read_exr(bench.out.with_name(name) / entry)["Y"] for name in ("direct", "bounced"))
    assert np.all(bounced >= direct)
    assert bounced.sum() > direct.sum()


def test_too_many_bounces_are_refused(cli, bench):
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, "--bounces", "5")
    assert ran.status == 2
    assert "bounces: expected 0 to 4, found 5" in ran.err
