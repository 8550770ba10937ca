"""What a check says about a part on a rig: each finding has a scene that causes it and one that does not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from test_preflight_rig import find, make_rig, only

from lightopt.config import PartConfig, load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.geometry import TriangleMesh, merge_rows, mesh_edges
from lightopt.preflight import _part, check_scene
from lightopt.preflight._findings import CheckResult
from lightopt.preflight._highlights import facet_angles, interpolation_errors
from lightopt.preflight._part import facing
from lightopt.scene._build import likely_units

CONFIGS = Path(__file__).parents[2] / "configs"

BOX_FACES = np.array(
    [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4),
     (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]
)  # fmt: skip
TOP = slice(2, 4)


def box(low, high):
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return np.array([(x, y, z) for z in (z0, z1) for x, y in ring], float)[BOX_FACES]


def grid_faces(rows, columns):
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (i * columns + j).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])


def dome(n, radius=20.0):
    """A smooth cap, n × n vertices, facing up."""
    angle = np.linspace(-0.9, 0.9, n)
    u, v = np.meshgrid(angle, angle, indexing="ij")
    normals = np.stack([np.tan(u), np.tan(v), np.ones_like(u)], -1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    faces = grid_faces(n, n)
    return (radius * normals)[faces]


def write_stl(path: Path, triangles) -> Path:
    lines = ["solid part"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid part", ""]), encoding="ascii")
    return path


WHOLE_BUDGET = _part.BUDGET


@pytest.fixture(autouse=True)
def few_patches(monkeypatch):
    """Surface that is not seen is counted on a tenth of the patches."""
    monkeypatch.setattr(_part, "BUDGET", 20_000)


@pytest.fixture
def check(tmp_path):
    """Check triangles on the test rig; `part` and `rig` go to the configurations."""

    def run(triangles, *, sigma=0.0475, mesh=None, rig=None, reflectance=None, **part) -> CheckResult:
        file = write_stl(tmp_path / "part.stl", triangles)
        config = PartConfig.model_validate(
            {
                "format": "lightopt-part/1",
                "name": "test",
                "mesh": {"file": str(file), "units": "mm", **(mesh or {})},
                "reflectance": {"R_d": 45, "R_s": 12500, "sigma_rad": sigma, **(reflectance or {})},
                **part,
            }
        )
        return check_scene(rig or make_rig(), config)

    return run


BLOCK = box((-20, -15, 0), (20, 15, 10))


def test_block_has_nothing_to_worry_about(check):
    report = check(BLOCK, rig=make_rig(light_source={"size_mm": [60, 60], "points": "auto"}))
    assert report.worst == "ok"
    topics = {"size", "mesh", "depth", "view", "points", "levels", "facets", "unseen surface", "lens"}
    assert topics <= {f.topic for f in report.findings}


@pytest.mark.slow
@pytest.mark.parametrize("part", ["cover-knob", "spout"])
def test_sample_parts(part):
    report = check_scene(load_rig(CONFIGS / "rigs" / "four-panel.yaml"), load_part(CONFIGS / "parts" / f"{part}.yaml"))
    for topic in ("size", "mesh", "levels", "facets"):
        assert only(report, topic).level == "ok"
    assert not find(report, "back faces")
    assert not find(report, "light in part")
    assert only(report, "points").level == "note"
    assert f"{part}.yaml:" in only(report, "size").where


# ---- size and units


@pytest.mark.parametrize(
    ("longest", "view", "unit", "expected"),
    [
        (50, 52.8, "mm", ()),
        (5, 52.8, "mm", ()),
        (2, 52.8, "mm", ("cm", "inch")),
        (0.05, 52.8, "mm", ("m", "ft")),
        (1270, 52.8, "inch", ("mm",)),
        (500, 52.8, "cm", ("mm",)),
        (50e3, 52.8, "m", ("mm",)),
        (1e-6, 52.8, "mm", ()),
    ],
)
def test_likely_units(longest, view, unit, expected):
    assert likely_units(longest, view, unit) == expected


@given(size=st.floats(15, 60), unit=st.sampled_from(["mm", "inch", "m"]), read=st.sampled_from(["mm", "inch", "m"]))
def test_right_unit_is_among_the_likely_ones(size, unit, read):
    from lightopt.core.units import MM_PER_UNIT

    found = likely_units(size / MM_PER_UNIT[unit] * MM_PER_UNIT[read], 52.8, read)
    assert (unit in found) == (unit != read)


def test_part_in_inches_read_as_millimetres(check):
    finding = only(check(BLOCK / 25.4), "size")
    assert finding.level == "warning"
    assert "inch (40 mm, a factor of 25.4)" in finding.text
    assert finding.values["likely_units"] == ["cm", "inch"]


def test_part_that_no_unit_explains(check):
    finding = only(check(BLOCK * 4), "size")
    assert finding.level == "warning"
    assert "very large" in finding.text


def test_size_of_a_good_part(check):
    finding = only(check(BLOCK), "size")
    assert (finding.level, finding.values["size_mm"]) == ("ok", [40, 30, 10])


def test_wrong_unit_is_proposed_where_no_scene_can_be_built(check):
    # 40 mm read as metres: the camera is inside the part
    with pytest.raises(InputError) as error:
        check(box((-20, -15, 0), (20, 15, 30)), mesh={"units": "m"})
    assert "inside the part" in error.value.messages[0]
    assert "mm (40 mm, a factor of 1/1000)" in error.value.messages[-1]


def test_no_unit_is_proposed_where_that_is_not_what_is_wrong(check):
    with pytest.raises(InputError) as error:
        check(BLOCK, placement={"translate_mm": [500, 0, 0]})
    assert len(error.value.messages) == 1


# ---- the mesh


def test_open_mesh_and_its_back(check):
    # a box without its lid shows the inside of its floor and walls, from their backs
    lidless = np.delete(BLOCK, TOP, axis=0)
    report = check(lidless)
    (mesh,) = find(report, "mesh", "note")
    assert mesh.values["open_edges"] == 4
    (back,) = find(report, "back faces")
    assert back.values["share"] > 0.9
    assert back.values["pixels"] == pytest.approx(40 * 30 / 0.044**2, rel=0.1)


def test_closed_mesh(check):
    report = check(BLOCK)
    assert only(report, "mesh").values == {"triangles": 12, "open_edges": 0, "nonmanifold_edges": 0}
    assert not find(report, "back faces")


def test_three_faces_at_an_edge(check):
    fin = np.array([[(-20, -15, 10), (20, -15, 10), (0, -15, 20)]], float)
    (mesh,) = find(check(np.concatenate([BLOCK, fin])), "mesh", "note")
    assert (mesh.values["open_edges"], mesh.values["nonmanifold_edges"]) == (2, 1)


def test_repairs_are_reported_once(check):
    turned = BLOCK.copy()
    turned[0] = turned[0][::-1]
    report = check(turned, placement={"translate_mm": [20, 0, 0]})
    warnings = [f for f in report.findings if f.topic == "mesh" and f.level == "warning"]
    assert len(warnings) == 1
    assert "wound" in warnings[0].text or "turned" in warnings[0].text
    assert len(find(report, "view", "warning")) == 1


def test_edges_of_a_box():
    corners, number = BLOCK.reshape(-1, 3), merge_rows(BLOCK.reshape(-1, 3))[1]
    assert number.max() == 7
    assert all((number[i] == number[j]) == (corners[i] == corners[j]).all() for i in range(36) for j in range(36))
    found = mesh_edges(number.reshape(-1, 3))
    assert len(found.ends) == 18
    assert set(found.uses.tolist()) == {2}
    shared = [set(number[3 * a : 3 * a + 3]) & set(number[3 * b : 3 * b + 3]) for a, b in found.faces.tolist()]
    assert shared == [set(ends) for ends in found.ends.tolist()]


# ---- framing


def test_margins_of_the_view(check):
    finding = only(check(BLOCK), "view")
    # the lid is 540 mm away: 55 / (540·0.0044) px per mm
    per_mm = 55 / (540 * 4.4e-3)
    margins = finding.values["margin_px"]
    assert finding.level == "ok"
    assert margins["left"] == pytest.approx(800 - 20 * per_mm)
    assert margins["bottom"] == pytest.approx(600 - 15 * per_mm)
    assert finding.values["margin_mm"]["left"] == pytest.approx(margins["left"] / per_mm)


def test_part_that_leaves_the_view(check):
    postures = [{"elevation_deg": 0, "rotation_deg": a} for a in (0, 90)]
    findings = find(check(BLOCK * 1.4, postures=postures), "view")
    assert [f.level for f in findings] == ["ok", "warning"]
    assert findings[1].values["margin_px"]["top"] < 0
    assert "at the top" in findings[1].text
    assert "at the left" not in findings[1].text


def test_depth_range(check):
    finding = only(check(BLOCK), "depth")
    assert (finding.values["nearest_mm"], finding.values["farthest_mm"]) == pytest.approx((540, 550))
    assert finding.values["nearest_footprint_mm"] == pytest.approx(0.0432)
    assert "43.2 µm" in finding.text


def test_share_out_of_focus(check):
    """Of two blocks side by side one is focused on, the other 20 mm lower."""
    blocks = [*box((-20, -15, 0), (0, 15, 30)), *box((0, -15, 0), (20, 15, 10))]
    lens = {"aperture": 4, "focus_distance_mm": 520}
    found = next(f for f in check(blocks, rig=make_rig(camera=lens)).findings if "lens blurs" in f.text)
    aperture = 1 / (1 / 520 + 1 / 55) / 4
    assert found.level == "warning"
    assert found.values["largest_px"] == pytest.approx(aperture * 55 * (1 / 520 - 1 / 540) / 0.0044, rel=0.06)
    assert found.values["out_of_focus_share"] == pytest.approx(0.5, abs=0.12)
    assert "stop the aperture down" in found.text
    stopped_down = make_rig(camera={"aperture": 90, "focus_distance_mm": 530, "wavelength_nm": 550})
    diffracted = next(f for f in check(blocks, rig=stopped_down).findings if "lens blurs" in f.text)
    assert diffracted.level == "warning"
    assert "by diffraction; open the aperture" in diffracted.text
    sharp = check(blocks, rig=make_rig(camera={"aperture": 200, "focus_distance_mm": 530}))
    assert [f.level for f in sharp.findings if "lens blurs" in f.text] == ["ok"]
    assert not [f for f in check(blocks).findings if f.topic == "focus"]


def test_part_behind_the_camera(check):
    # a frame around the camera, so that the camera is not inside it
    frame = np.concatenate([box((-90, -90, 0), (-60, 90, 700)), box((-20, -20, 0), (20, 20, 5))])
    report = check(frame)
    assert only(report, "depth").level == only(report, "view").level == "warning"
    assert "behind the camera" in only(report, "view").text


@pytest.mark.parametrize(("tilt", "lift", "level"), [(0, 0, None), (0, -3, "warning"), (20, 0, "note"), (20, 15, None)])
def test_part_below_the_table(check, tilt, lift, level):
    report = check(
        BLOCK, placement={"translate_mm": [0, 0, lift]}, postures=[{"elevation_deg": tilt, "rotation_deg": 0}]
    )
    findings = find(report, "table")
    assert [f.level for f in findings] == ([] if level is None else [level])
    if level == "warning":
        assert findings[0].values["lowest_mm"] == pytest.approx(-3)
    if level == "note":
        assert findings[0].values["lowest_mm"] == pytest.approx(-15 * math.sin(math.radians(20)))


# ---- lights and the part


@pytest.mark.parametrize(
    ("light", "level"),
    [
        ({}, None),
        ({"distance_mm": 5, "elevation_deg": 90, "size_mm": [4, 4]}, "error"),
        ({"distance_mm": 20, "elevation_deg": 90, "size_mm": [4, 4]}, None),
    ],
)
def test_light_inside_the_part(check, light, level):
    findings = find(check(BLOCK, rig=make_rig(light=light)), "light in part")
    assert [f.level for f in findings] == ([] if level is None else [level])


def test_light_partly_inside_the_part(check):
    light = {"distance_mm": 20, "elevation_deg": 4, "azimuth_deg": 0, "size_mm": [10, 10]}
    finding = only(check(BLOCK, rig=make_rig(light=light)), "light in part")
    assert 0.2 < finding.values["share"] < 1


def test_light_that_hides_the_part(check):
    light = {"distance_mm": 275, "elevation_deg": 90, "azimuth_deg": 0, "size_mm": [5, 5]}
    (finding,) = [f for f in find(check(BLOCK, rig=make_rig(light=light)), "light in view") if "hides" in f.text]
    assert finding.values["pixels"] == pytest.approx((5 / 0.022) ** 2, rel=0.05)
    assert finding.values["light"] == "light1"


def test_light_beside_the_part_hides_nothing(check):
    light = {"distance_mm": 275, "elevation_deg": 86, "azimuth_deg": 0, "size_mm": [5, 5]}
    report = check(BLOCK * [0.1, 1, 1], rig=make_rig(light=light))
    assert not [f for f in find(report, "light in view") if "hides" in f.text]


# ---- lobe and levels


@pytest.mark.parametrize(("sigma", "points", "level"), [(0.05, 16, "ok"), (0.0475, 4, "note"), (0.003, 4, "warning")])
def test_points(check, sigma, points, level):
    source = {"size_mm": [60, 60], "points": points}
    finding = only(check(BLOCK, sigma=sigma, rig=make_rig(light_source=source)), "points")
    assert finding.level == level
    assert ("points: auto" in finding.text) == (level != "ok")
    assert "light1, light2" in finding.text


def test_points_of_unlike_panels_are_distinguished(check):
    findings = find(check(BLOCK, rig=make_rig(light={"points": "auto"})), "points")
    assert [f.level for f in findings] == ["ok", "note"]
    assert findings[0].where.endswith("lights[0].points")


@pytest.mark.parametrize(
    ("reflectance", "source", "level"),
    [
        ({}, {}, "ok"),
        ({"R_d": 300}, {}, "warning"),
        ({"R_d": 300, "full_scale": 4095}, {}, "ok"),
        ({"R_d": 100}, {"normalisation": "sum"}, "warning"),
        ({"R_d": 0, "R_s": 0}, {}, "warning"),
    ],
)
def test_levels(check, reflectance, source, level):
    rig = make_rig(light_source={"size_mm": [60, 60], "points": 4, **source})
    assert only(check(BLOCK, rig=rig, reflectance=reflectance), "levels").level == level


@pytest.mark.parametrize(
    ("sensor", "full_scale", "says"),
    [
        ({"bit_depth": 8}, 255, "saturation is at 255"),
        ({"bit_depth": 8, "black_level": 4}, 255, "is at 251 (the sensor's 255 less its black level of 4)"),
        (
            {"bit_depth": 12, "saturation_level": 4080, "black_level": 64},
            255,
            "is at 250.1 (the sensor's 4080 less its black level of 64, in levels of full_scale 255)",
        ),
    ],
)
def test_the_level_of_saturation_is_explained(check, sensor, full_scale, says):
    rig = make_rig(sensor=sensor)
    text = only(check(BLOCK, rig=rig, reflectance={"full_scale": full_scale}), "levels").text
    assert text.endswith(says)


# ---- facets


def spheroid(n, *, height, radius=20.0):
    """Open spheroid with exact normals, and a function for the normals anywhere on it."""
    u, v = np.meshgrid(np.linspace(0.4, 2.4, n), np.linspace(0, 2, n), indexing="ij")
    on_sphere = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1).reshape(-1, 3)
    scale = np.array([radius, radius, height])

    def normals_at(points):
        gradient = points / scale**2
        return gradient / np.linalg.norm(gradient, axis=1)[:, None]

    vertices = on_sphere * scale
    return TriangleMesh(vertices, grid_faces(n, n), normals_at(vertices)), scale, normals_at


def true_errors(mesh, scale, normals_at):
    """Interpolated normal in the middle of each edge against the surface's, where the chord's middle projects to it."""
    ends = mesh_edges(mesh.faces).ends
    p, q = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]]
    middle = mesh.normals[ends].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    along = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    at = 0.5 * (p + q)
    for _ in range(50):  # along the interpolated normal onto the surface
        value = np.sum((at / scale) ** 2, axis=1) - 1
        at = at - (value / np.einsum("ij,ij->i", 2 * at / scale**2, middle))[:, None] * middle
    return np.abs(np.einsum("ij,ij->i", middle - normals_at(at), along))


@pytest.mark.parametrize("n", [10, 30])
def test_interpolation_error_of_a_spheroid(n):
    mesh, scale, normals_at = spheroid(n, height=8.0)
    found = interpolation_errors(mesh, bent=0.0)
    length = np.linalg.norm(np.diff(mesh.vertices[mesh_edges(mesh.faces).ends], axis=1)[:, 0], axis=1)
    actual = true_errors(mesh, scale, normals_at)
    order = np.argsort(actual)
    share = np.cumsum(length[order]) / length.sum()
    assert found.high == pytest.approx(actual[order][np.searchsorted(share, 0.9)], rel=0.25)


def test_interpolation_error_is_of_second_order_and_none_on_a_sphere():
    coarse, fine = (interpolation_errors(spheroid(n, height=8.0)[0], bent=0.0).high for n in (21, 41))
    assert coarse / fine == pytest.approx(4, rel=0.15)
    assert interpolation_errors(spheroid(20, height=20.0)[0], bent=0.0).high < 1e-12


def test_angles_between_the_facets_of_a_prism():
    n = 24
    angle = np.arange(n + 1) * 2 * math.pi / n
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    vertices = np.array([(x, y, z) for z in (0.0, 3.0) for x, y in 10 * ring[:-1]])
    i = np.arange(n)
    j = (i + 1) % n
    faces = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    found = facet_angles(TriangleMesh(vertices, faces), bent=0.001, crease=0.5)
    assert (found.median, found.high) == pytest.approx((2 * math.pi / n,) * 2)
    assert found.edge == pytest.approx(3)
    # all of it is an edge of the part, and the diagonals of its flat sides do not bend
    assert facet_angles(TriangleMesh(vertices, faces), bent=0.001, crease=0.2) is None


@pytest.mark.parametrize(
    ("n", "normals", "sigma", "level"),
    [
        (12, "facet", 0.0475, "warning"),
        (120, "facet", 0.0475, "ok"),
        (24, "smooth", 0.0475, "ok"),
        (24, "smooth", 0.003, "warning"),
        (120, "smooth", 0.003, "ok"),
    ],
)
def test_facets_against_the_lobe(check, n, normals, sigma, level):
    finding = only(check(dome(n), sigma=sigma, mesh={"normals": normals}), "facets")
    assert finding.level == level
    assert ("STEP" in finding.text) == (level == "warning")


def test_flat_part_has_no_facets(check):
    for normals in ("facet", "smooth"):
        finding = only(check(BLOCK, sigma=0.003, mesh={"normals": normals}), "facets")
        assert (finding.level, dict(finding.values)) == ("ok", {})


# ---- surface that is not seen


def test_top_of_a_block_is_all_that_is_seen(check):
    finding = only(check(BLOCK), "unseen surface")
    assert finding.level == "ok"
    assert finding.values["area_mm2"] == pytest.approx(2 * (40 * 30 + 40 * 10 + 30 * 10))
    assert finding.values["unseen_mm2"] == pytest.approx(finding.values["area_mm2"] - 40 * 30)
    assert finding.values["unseen_upper_share"] == 0


def test_surface_under_a_bridge(check, monkeypatch):
    monkeypatch.setattr(_part, "BUDGET", WHOLE_BUDGET)
    # a plate 10 mm wide, 12 mm above the block's middle
    bridge = box((-5, -15, 22), (5, 15, 24))
    finding = only(check(np.concatenate([BLOCK, bridge])), "unseen surface")
    assert finding.level == "warning"
    # its shadow from a camera 550 mm high, at the block's top
    width, length = (side * (550 - 10) / (550 - 24) for side in (10, 30))
    assert finding.values["unseen_upper_mm2"] == pytest.approx(width * min(30, length), rel=0.03)
    low, high = finding.values["unseen_upper_box_mm"]
    assert (low[2], high[2]) == (10, 10)
    assert -6 < low[0] < -5 < 5 < high[0] < 6
    assert "facing up" in finding.text


def test_postures_that_look_under_the_bridge(check):
    bridge = box((-5, -15, 22), (5, 15, 24))
    postures = [{"elevation_deg": e, "rotation_deg": 90} for e in (-40, 0, 40)]
    finding = only(check(np.concatenate([BLOCK, bridge]), postures=postures), "unseen surface")
    assert finding.values["unseen_upper_share"] < 0.01


def test_part_outside_the_image_is_not_seen(check, monkeypatch):
    monkeypatch.setattr(_part, "BUDGET", WHOLE_BUDGET)
    finding = only(check(BLOCK, placement={"translate_mm": [35, 0, 0]}), "unseen surface")
    assert finding.values["unseen_upper_share"] == pytest.approx(0.5, abs=0.02)
    assert finding.values["unseen_upper_box_mm"][0][0] == pytest.approx(34.6, abs=0.5)


@pytest.mark.parametrize(
    ("mean", "words"),
    [
        ((0, 0, 1), "facing up"),
        ((0, -0.8, -0.6), "facing −Y and down"),
        ((0.6, 0.6, 0.5), "facing +X and +Y and up"),
        ((0.1, 0, 0.2), "facing several ways"),
    ],
)
def test_directions_in_words(mean, words):
    assert facing(np.array(mean)) == words


# ---- the part in itself


def test_a_convex_part_mirrors_nothing_of_itself(check):
    assert not find(check(BLOCK), "mirrored part")


CORNERS = np.array([(x, y, abs(x)) for x in (-10.0, 0.0, 10.0) for y in (-10.0, 10.0)])
GROOVE = CORNERS[np.array([(0, 2, 1), (1, 2, 3), (2, 4, 3), (3, 4, 5)])]


def test_a_groove_mirrors_its_other_side(check):
    """Walls at 45° in a groove: each mirrors a view from above to the other, all of it."""
    finding = only(check(GROOVE), "mirrored part")
    assert finding.level == "warning"
    assert finding.values["share"] > 0.9
    assert "render --bounces 1" in finding.text
    assert not find(check(GROOVE, reflectance={"R_s": 0}), "mirrored part")


def test_the_posture_that_mirrors_most_of_the_part_is_named(check):
    """Tilted, the walls mirror less of each other."""
    postures = [{"elevation_deg": tilt, "rotation_deg": 90} for tilt in (30, 0)]
    finding = only(check(GROOVE, postures=postures), "mirrored part")
    first, second = (one["share"] for one in finding.values["postures"])
    assert finding.values["share"] == second > first
    assert finding.text.startswith("posture (0°, 90°): ")
    assert "itself, the most of 2 postures (the least: " in finding.text
