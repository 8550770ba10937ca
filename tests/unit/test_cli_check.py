"""``lightopt check``: what it prints, its exit statuses, JSON and drawing."""

from __future__ import annotations

import json

import pytest


def test_a_sound_rig_and_part(cli, bench, snapshot):
    before = snapshot(bench.folder)
    ran = cli("check", bench.rig, bench.part)
    assert ran.status == 0, ran.err
    assert ran.err == ""
    summary, *findings = ran.out.splitlines()
    assert summary.endswith(f"of {len(cli('check', bench.rig, bench.part, '-v').out.splitlines()) - 1} findings are ok")
    assert len(findings) <= 15
    levels = {line.split(":")[0] for line in findings}
    assert levels <= {"ok", "note", "warning"}
    assert "footprint" in ran.out
    assert "field of view: 70.4 × 52.8 mm" in ran.out
    assert f"({bench.rig}:7: camera.pixel_size_um)" in ran.out
    assert snapshot(bench.folder) == before, "checking writes nothing"


def test_the_rig_alone(cli, bench):
    ran = cli("check", bench.rig)
    assert (ran.status, ran.err) == (0, "")
    assert "pixel" in ran.out
    assert str(bench.part) not in ran.out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("distance_mm: 550", "distance_mm: 0.55", "magnification 100, which no lens of a machine has"),
        ("pixel_size_um: 44", "pixel_size_um: 0.044", "no sensor has pixels of 0.044 µm: are they in another unit?"),
    ],
)
def test_lengths_of_the_camera_in_another_unit_are_warned_of(cli, bench, old, new, said):
    bench.edit("rig.yaml", old, new)
    ran = cli("check", bench.rig)
    assert ran.status == 0
    assert said in ran.out


def test_a_mesh_in_place_of_the_part_file(cli, bench):
    ran = cli("check", bench.rig, bench.mesh)
    assert ran.status == 2
    assert "a mesh; expected a part file (YAML) that names it as mesh.file" in ran.err


def test_quiet_keeps_warnings_only(cli, bench):
    bench.edit("part.yaml", "sigma_rad: 0.0475", "sigma_rad: 0.003")
    loud = cli("check", bench.rig, bench.part).out.splitlines()
    quiet = cli("check", bench.rig, bench.part, "--quiet").out.splitlines()
    assert quiet == [line for line in loud if line.startswith(("warning:", "error:"))]
    assert any("points" in line and "light1" in line for line in quiet)


def test_json_holds_the_findings(cli, bench):
    path = bench.folder / "findings.json"
    ran = cli("check", bench.rig, bench.part, "--json", path, "--verbose")
    assert ran.status == 0
    report = json.loads(path.read_text(encoding="utf-8"))
    assert set(report["provenance"]["inputs"]) == {"rig", "part", "mesh"}
    assert report["worst"] in ("ok", "note", "warning")
    for finding, line in zip(report["findings"], ran.out.splitlines()[1:], strict=True):
        assert line.startswith(finding["level"] + ":")
        assert finding["topic"] in line
        assert finding["text"] in line


def test_a_finding_that_cannot_be_is_exit_status_one(cli, bench):
    # the lower light's panel reaches into the part
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 45", "distance_mm: 20, elevation_deg: 45")
    path = bench.folder / "findings.json"
    ran = cli("check", bench.rig, bench.part, "--json", path)
    assert ran.status == 1
    assert any(line.startswith("error:") and "light3" in line for line in ran.out.splitlines())
    assert ran.err.startswith("error: ")
    assert "must be corrected before rendering" in ran.err
    assert json.loads(path.read_text(encoding="utf-8"))["worst"] == "error"


def test_both_files_errors_come_at_once(cli, bench):
    bench.edit("rig.yaml", "distance_mm: 550", "distance_mm: far")
    bench.edit("rig.yaml", "pixel_size_um: 44", "pixel_size_um: -44")
    bench.edit("part.yaml", "R_d: 45.0", "R_d: -1")
    ran = cli("check", bench.rig, bench.part)
    assert ran.status == 2
    assert ran.out == ""
    lines = ran.err.splitlines()
    assert [line.split(": ")[1] for line in lines] == [f"{bench.rig}:4", f"{bench.rig}:7", f"{bench.part}:6"]
    assert all(line.startswith("error: ") for line in lines)


def test_drawing_is_written_and_named(cli, bench):
    path = bench.folder / "rig.png"
    ran = cli("check", bench.rig, bench.part, "--drawing", path)
    assert ran.status == 0
    assert ran.out.splitlines()[-1] == str(path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_drawing_needs_a_part_and_nothing_is_written_without(cli, bench, snapshot):
    before = snapshot(bench.folder)
    ran = cli("check", bench.rig, "--drawing", bench.folder / "rig.png", "--json", bench.folder / "findings.json")
    assert ran.status == 2
    assert ran.err == "error: --drawing: expected a part file as well\n"
    assert ran.out == ""
    assert snapshot(bench.folder) == before


@pytest.mark.parametrize("option", ["--json", "--drawing"])
def test_an_output_that_cannot_be_written(cli, bench, option):
    target = bench.folder / "no such folder" / "file.png"
    ran = cli("check", bench.rig, bench.part, option, target)
    assert ran.status == 2
    assert ran.err.startswith("error: ")
    assert str(target) in ran.err
    assert "Traceback" not in ran.err
    assert not target.parent.exists()


@pytest.mark.parametrize(
    ("unit", "status", "factor"), [("inch", 1, "a factor of 1/25.4"), ("m", 2, "a factor of 1/1000"), ("um", 1, "1000")]
)
def test_a_unit_mistake_is_named(cli, bench, unit, status, factor):
    bench.edit("part.yaml", "units: mm", f"units: {unit}")
    ran = cli("check", bench.rig, bench.part)
    assert ran.status == status
    said = next(line for line in (ran.out + ran.err).splitlines() if "a wrong unit?" in line)
    assert said.startswith(("warning:", "error:"))
    assert f"Read as {unit}" in said
    assert factor in said
    assert "if the file were in mm" in said
    assert f"{bench.part}:3: mesh.units" in said
