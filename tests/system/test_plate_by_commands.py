"""A flat plate, glossy or matte, through the commands: what it does not show is said, and nothing is made up."""

from __future__ import annotations

import json
import math

import pytest
import trimesh

GLOSS = "R_d: 45.0, R_s: 12500, sigma_rad: 0.0475"
MATTE = "R_d: 45.0, R_s: 0.001, sigma_rad: 0.0475"


def figures(folder, name):
    return json.loads((folder / name).read_text(encoding="utf-8"))


@pytest.fixture(params=[GLOSS, MATTE], ids=["glossy", "matte"])
def seen(request, bench, cli):
    """A box of 40 × 25 × 3 mm, rendered with noise."""
    trimesh.creation.box(extents=(40, 25, 3)).export(bench.mesh)
    bench.edit("part.yaml", GLOSS, request.param)
    ran = cli(
        "render", bench.rig, bench.part, "-o", bench.folder / "set", "--noise", 1, "--patches", 500, "-q",
        "--posture", "0,0",
    )  # fmt: skip
    assert ran.status == 0
    return bench, bench.folder / "set", request.param == GLOSS


@pytest.mark.slow
def test_a_plate_is_inspected_and_fitted_where_it_lies(seen, cli):
    bench, images, glossy = seen
    ran = cli("inspect", bench.rig, bench.part, images, "-o", bench.out, "--fail-on-defect", "--no-report")
    assert ran.status == 0, ran.err
    found = figures(bench.out, "defects.json")
    assert found["defects"] == []
    assert found["registration"]["converged"] is True
    assert found["registration"]["cost_per_pixel_after"] <= found["registration"]["cost_per_pixel_before"]
    lies_in_place(found["placement"])

    # nothing is unexplained where there is no variance to explain
    fixed = bench.folder / "fixed"
    ran = cli("inspect", bench.rig, bench.part, images, "-o", fixed, "--fail-on-defect", "--no-register", "--no-report")
    assert (ran.status, figures(fixed, "defects.json")["defects"]) == (0, []), ran.err

    ran = cli("fit-diffuse", bench.rig, bench.part, images, "-o", bench.folder / "diffuse", "--register", "-q")
    assert ran.status == 0, ran.err
    fitted = figures(bench.folder / "diffuse", "fit.json")
    lies_in_place(fitted["placement"])
    assert fitted["values"]["R_d"]["value"] == pytest.approx(45.0, rel=0.01)

    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.folder / "specular", "--no-validate", "-q")
    if glossy:
        # so little of a highlight is on the plate that R_s is known within a factor; that is what the interval says
        assert ran.status == 0, ran.err
        values = figures(bench.folder / "specular", "fit.json")["values"]
        for name, truth in (("R_s", 12500.0), ("sigma_rad", 0.0475)):
            low, high = values[name]["interval_95"]
            assert low < truth < high
    else:
        assert ran.status == 2
        assert "highlight" in ran.err


def lies_in_place(placement):
    assert math.hypot(placement["x_mm"], placement["y_mm"]) < 0.05
    assert abs(placement["turn_deg"]) < 0.05
