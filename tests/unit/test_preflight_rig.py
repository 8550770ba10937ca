"""What a check says about a rig: each finding has a rig that causes it and one that does not."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lightopt.config import RigConfig, load_rig
from lightopt.core.errors import InputError
from lightopt.lights import PanelLight, panel_corners, place_light, rectangles_meet
from lightopt.preflight import check_rig
from lightopt.preflight._findings import CheckResult, Finding
from lightopt.scene import pixel_directions, place_camera
from lightopt.scene._camera import Distortion
from lightopt.scene._image_area import image_area

SAMPLE = Path(__file__).parents[2] / "configs" / "rigs" / "four-panel.yaml"

RIG = {
    "format": "lightopt-rig/1",
    "name": "test",
    "camera": {
        "distance_mm": 550,
        "elevation_deg": 90,
        "resolution_px": [1600, 1200],
        "pixel_size_um": 4.4,
        "image_distance_mm": 55,
        "sensor": {"bit_depth": 8},
    },
    "light_source": {"size_mm": [60, 60], "points": 4},
    "lights": [
        {"name": "light1", "distance_mm": 330, "elevation_deg": 60, "azimuth_deg": 45},
        {"name": "light2", "distance_mm": 330, "elevation_deg": 60, "azimuth_deg": 225},
    ],
}


def make_rig(camera=None, sensor=None, light=None, **top) -> RigConfig:
    """The rig above with other values in the camera, the sensor, the first light, or at the top."""
    data = copy.deepcopy(RIG)
    data["camera"].update(camera or {})
    data["camera"]["sensor"].update(sensor or {})
    data["lights"][0].update(light or {})
    data.update(top)
    return RigConfig.model_validate(data)


def find(report: CheckResult, topic: str, level: str | None = None) -> list[Finding]:
    return [f for f in report.findings if f.topic == topic and level in (None, f.level)]


def only(report: CheckResult, topic: str) -> Finding:
    (finding,) = find(report, topic)
    return finding


# ---- the report


def test_sample_rig_is_fine_and_says_where():
    report = check_rig(load_rig(SAMPLE))
    assert report.worst == "ok"
    line = (
        SAMPLE.read_text(encoding="utf-8")
        .splitlines()
        .index(
            "  pixel_size_um: 4.4            # on the sensor; here "
            "one pixel sees 4.4 µm × 550 / 55 = 0.044 mm of the table"
        )
        + 1
    )
    assert only(report, "resolution").where == f"{SAMPLE}:{line}: camera.pixel_size_um"


def test_report_is_json_and_frozen():
    report = check_rig(make_rig(light={"elevation_deg": 3}))
    data = json.loads(json.dumps(report.as_dict(), allow_nan=False))
    assert data["worst"] == report.worst == "warning"
    assert len(data["findings"]) == len(report.findings)
    assert set(data["findings"][0]) == {"level", "topic", "text", "where", "values"}
    with pytest.raises(TypeError):
        report.findings[0].values["x"] = 1  # type: ignore[index]


@pytest.mark.parametrize(
    ("levels", "worst"),
    [((), "ok"), (("ok", "note"), "note"), (("warning", "note"), "warning"), (("error", "warning", "ok"), "error")],
)
def test_worst_level(levels, worst):
    assert CheckResult(tuple(Finding(level, "t", "x") for level in levels)).worst == worst


# ---- camera and sensor


def test_lens_resolution_and_view_in_numbers():
    report = check_rig(make_rig())
    lens = only(report, "lens")
    assert lens.values["focal_length_mm"] == pytest.approx(50)
    assert lens.values["magnification"] == pytest.approx(0.1)
    assert "focal length 50 mm" in lens.text
    resolution = only(report, "resolution")
    assert resolution.values["footprint_mm"] == pytest.approx(0.044)
    assert "44 µm" in resolution.text
    view = only(report, "field of view")
    assert (view.values["width_mm"], view.values["height_mm"]) == pytest.approx((70.4, 52.8))


def test_focal_length_and_image_distance_are_the_same_lens():
    camera = {"focal_length_mm": 50, "image_distance_mm": None}
    lens = only(check_rig(make_rig(camera=camera)), "lens")
    assert lens.values["image_distance_mm"] == pytest.approx(55)
    assert lens.where.endswith("focal_length_mm")


def test_depth_of_field_in_numbers():
    lens = {"aperture": 8, "focus_distance_mm": 540, "wavelength_nm": 550}
    found = only(check_rig(make_rig(camera=lens)), "depth of field")
    aperture = 1 / (1 / 540 + 1 / 55) / 8
    step = 0.0044 / (aperture * 55)
    assert found.values["near_mm"] == pytest.approx(1 / (1 / 540 + step))
    assert found.values["far_mm"] == pytest.approx(1 / (1 / 540 - step))
    assert found.values["airy_px"] == pytest.approx(2.44 * 0.55 * 55 / aperture / 4.4)
    assert "f/8, focused at 540 mm" in found.text
    assert not find(check_rig(make_rig()), "depth of field")
    lens_text = only(check_rig(make_rig(camera=lens)), "lens").text
    assert "focused at 540 mm" in lens_text


def test_photons_of_a_data_sheet():
    sensor = {"electrons_per_level": 40, "quantum_efficiency_percent": 50, "read_noise_levels": 0.1}
    found = only(check_rig(make_rig(sensor=sensor)), "photons")
    assert found.values["photons_at_saturation"] == pytest.approx(255 * 40 / 0.5)
    noise = (0.1**2 + 1 / 12) ** 0.5
    assert f"dynamic range {20 * math.log10(255 / noise):.2g} dB" in found.text


def test_view_of_a_leaning_camera_is_longer_on_the_table():
    view = only(check_rig(make_rig(camera={"elevation_deg": 45})), "field of view")
    # the plane through the pinhole and the image's middle column, cut by hand
    half = math.atan(0.5 * 1200 * 4.4e-3 / 55)
    height = 550 * math.sin(math.radians(45))
    near, far = (height / math.tan(math.radians(45) + sign * half) for sign in (1, -1))
    assert view.values["height_mm"] == pytest.approx(far - near)
    assert view.values["width_mm"] == pytest.approx(70.4)


def test_view_beyond_the_horizon_is_said():
    assert only(check_rig(make_rig(camera={"elevation_deg": 2})), "field of view").level == "note"


def test_folding_lens_is_refused():
    with pytest.raises(InputError, match="distortion"):
        check_rig(make_rig(camera={"distortion": {"k1": -50}}))


@pytest.mark.parametrize(
    ("sensor", "level"),
    [
        ({}, "ok"),
        ({"bit_depth": 12, "saturation_level": 4080, "black_level": 64}, "ok"),
        ({"bit_depth": 12, "saturation_level": 255}, "warning"),
        ({"black_level": 100}, "warning"),
    ],
)
def test_usable_levels(sensor, level):
    assert only(check_rig(make_rig(sensor=sensor)), "sensor").level == level


@pytest.mark.parametrize(("electrons", "warned"), [(60, False), (2, True)])
def test_full_well(electrons, warned):
    findings = find(check_rig(make_rig(sensor={"electrons_per_level": electrons})), "sensor", "warning")
    assert bool(findings) == warned
    if warned:
        assert findings[0].values["electrons_at_saturation"] == 510


# ---- lights in the view


def test_light_in_view_is_measured():
    # straight above at half the camera's distance: 15 mm there are twice as large as on the table
    light = {"distance_mm": 275, "elevation_deg": 90, "size_mm": [15, 15]}
    finding = only(check_rig(make_rig(light=light)), "light in view")
    assert finding.level == "warning"
    assert "light1" in finding.text
    assert finding.values["pixels"] == pytest.approx((15 / 0.022) ** 2)


def test_light_that_fills_the_view():
    light = {"distance_mm": 500, "elevation_deg": 90}
    assert only(check_rig(make_rig(light=light)), "light in view").values["share"] == pytest.approx(1)


@pytest.mark.parametrize("light", [{}, {"distance_mm": 600, "elevation_deg": 90}])
def test_light_aside_or_behind_the_camera_is_not_in_view(light):
    assert only(check_rig(make_rig(light=light)), "light in view").level == "ok"


def test_light_that_can_move_into_the_view():
    light = {"elevation_range_deg": [30, 120]}
    finding = only(check_rig(make_rig(light=light)), "light in view")
    assert finding.level == "note"
    low, high = finding.values["elevation_deg"]
    assert 80 <= low <= 90 <= high <= 100


# ---- lights and the table, lights and lights


@pytest.mark.parametrize(
    ("light", "level"),
    [
        ({"elevation_deg": 60}, None),
        ({"elevation_deg": 3}, "warning"),
        ({"elevation_range_deg": [30, 90]}, None),
        ({"elevation_range_deg": [2, 90]}, "note"),
    ],
)
def test_panel_below_the_table(light, level):
    findings = find(check_rig(make_rig(light=light)), "light below table")
    assert [f.level for f in findings] == ([] if level is None else [level])


def test_depth_below_the_table():
    finding = only(check_rig(make_rig(light={"elevation_deg": 3})), "light below table")
    expected = 330 * math.sin(math.radians(3)) - 30 * math.cos(math.radians(3))
    assert finding.values["lowest_mm"] == pytest.approx(expected)


@pytest.mark.parametrize(("apart_deg", "collide"), [(40, False), (14, False), (8, True), (0, True)])
def test_panels_that_collide(apart_deg, collide):
    light = {"azimuth_deg": 225 + apart_deg, "elevation_deg": 30}
    lights = [{**RIG["lights"][1], "elevation_deg": 30}, {**RIG["lights"][0], **light}]
    findings = find(check_rig(make_rig(lights=lights)), "lights collide")
    assert bool(findings) == collide
    if collide:
        assert findings[0].level == "warning"
        assert findings[0].values["lights"] == ["light2", "light1"]


def test_panels_that_can_collide():
    lights = [{**light, "elevation_range_deg": [60, 86]} for light in RIG["lights"]]
    finding = only(check_rig(make_rig(lights=lights)), "lights collide")
    assert finding.level == "note"
    assert "elevation 86°" in finding.text
    lights = [{**light, "elevation_range_deg": [60, 80]} for light in RIG["lights"]]
    assert not find(check_rig(make_rig(lights=lights)), "lights collide")


# ---- rectangles


def segments_blocked(light, start, ends):
    """Whether the way from one point to others [mm] passes through a panel."""
    height, from_height = (ends - light.centre) @ light.outward, float((start - light.centre) @ light.outward)
    crosses = height * from_height < 0.0
    share = np.where(crosses, from_height / np.where(crosses, from_height - height, 1.0), 0.0)
    at = start + share[:, None] * (ends - start) - light.centre
    inside = (np.abs(at @ light.across) <= 0.5 * light.size[0]) & (np.abs(at @ light.along) <= 0.5 * light.size[1])
    return crosses & inside


def panel(elevation, azimuth, *, distance=300.0, size=(60.0, 40.0)) -> PanelLight:
    return place_light(name="p", distance=distance, elevation=elevation, azimuth=azimuth, size=size, points=4)


angles = st.tuples(st.floats(0.1, 3.0), st.floats(-3.0, 3.0))


@given(a=angles, turn=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)), distance=st.floats(280, 320))
def test_collisions_against_crossing_edges(a, turn, distance):
    first, second = panel(*a), panel(a[0] + turn[0], a[1] + turn[1], distance=distance)

    def pierces(p: PanelLight, q: PanelLight) -> bool:
        ring = panel_corners(p)
        return any(bool(segments_blocked(q, ring[i - 1], ring[i : i + 1])[0]) for i in range(4))

    expected = pierces(first, second) or pierces(second, first)
    if abs(distance - 300) > 0.1:  # in one plane, edges pierce nothing
        assert rectangles_meet(first, second) == expected
    assert rectangles_meet(first, second) == rectangles_meet(second, first)


def test_panels_in_one_plane():
    first = panel(1.0, 0.0)
    beside = PanelLight(**{**vars(first), "centre": first.centre + 60.5 * first.across})
    over = PanelLight(**{**vars(first), "centre": first.centre + 59.5 * first.across})
    behind = PanelLight(**{**vars(first), "centre": first.centre + 1.0 * first.outward})
    assert [rectangles_meet(first, other) for other in (beside, over, behind)] == [False, True, False]


@given(
    centre=st.tuples(*(st.floats(-80, 80),) * 2, st.floats(20, 700)),
    tilt=st.tuples(st.floats(-1.5, 1.5), st.floats(-3, 3)),
    size=st.tuples(*(st.floats(5, 80),) * 2),
)
def test_image_area_against_counted_pixels(centre, tilt, size):
    camera = place_camera(
        distance=550, elevation=1.2, azimuth=-1.5, roll=0.4, width=160, height=120, pixel_size=0.044, image_distance=55
    )
    base = panel(*tilt, size=size)
    light = PanelLight(**{**vars(base), "centre": np.array(centre)})
    x, y = np.meshgrid(np.arange(320) / 2 + 0.25 - 80, np.arange(240) / 2 + 0.25 - 60)
    scale = 0.044 / 55
    directions = camera.forward + scale * (x[..., None] * camera.right - y[..., None] * camera.up)
    ends = camera.position + 5000 * directions.reshape(-1, 3)
    counted = np.count_nonzero(segments_blocked(light, camera.position, ends)) / 4
    area = image_area(camera, panel_corners(light))
    assert 0 <= area <= 160 * 120 * (1 + 1e-9)
    assert area == pytest.approx(counted, abs=60 + 0.02 * area)


@given(
    centre=st.tuples(*(st.floats(-80, 80),) * 2, st.floats(20, 700)),
    tilt=st.tuples(st.floats(-1.5, 1.5), st.floats(-3, 3)),
    size=st.tuples(*(st.floats(5, 80),) * 2),
    lens=st.sampled_from([Distortion(k1=-15.0), Distortion(k1=20.0, p1=0.1), Distortion(k1=-10.0, k2=500.0)]),
)
def test_image_area_through_a_lens_against_counted_pixels(centre, tilt, size, lens):
    camera = place_camera(
        distance=550,
        elevation=1.2,
        azimuth=-1.5,
        roll=0.4,
        width=160,
        height=120,
        pixel_size=0.044,
        image_distance=55,
        distortion=lens,
    )
    base = panel(*tilt, size=size)
    light = PanelLight(**{**vars(base), "centre": np.array(centre)})
    x, y = np.meshgrid(np.arange(320) / 2 + 0.25, np.arange(240) / 2 + 0.25)
    ends = camera.position + 5000 * pixel_directions(camera, x.ravel(), y.ravel())
    counted = np.count_nonzero(segments_blocked(light, camera.position, ends)) / 4
    area = image_area(camera, panel_corners(light))
    assert 0 <= area <= 160 * 120 * (1 + 1e-9)
    assert area == pytest.approx(counted, abs=60 + 0.02 * area)


def test_a_single_light_confirms_nothing():
    assert find(check_rig(make_rig()), "number of images") == []
    finding = only(check_rig(make_rig(lights=RIG["lights"][:1])), "number of images")
    assert finding.level == "note"
    assert "light1 is the only light" in finding.text
