"""The hardware section of a rig file: what it may say, and every misfit told with its line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st

from lightopt.config import (
    AxisConfig,
    CameraDeviceConfig,
    ChannelConfig,
    ControllerConfig,
    HardwareConfig,
    RigConfig,
    StageDeviceConfig,
    copied_text,
    load_lights,
    load_rig,
)
from lightopt.config._hardware import PictureConfig, TemplateConfig, TimingConfig
from lightopt.core.errors import InputError
from lightopt.rig.devices import LIGHT_DRIVERS

CONFIGS = Path(__file__).parents[2] / "configs"

RIG = """\
format: lightopt-rig/1
name: test
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 44
  image_distance_mm: 55
  exposure_us: 8000
  sensor: {bit_depth: 8}
light_source: {size_mm: [60, 60], points: 4}
lights:
  - {name: left, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}
  - {name: right, distance_mm: 330, elevation_deg: 60, azimuth_deg: 225}
hardware:
  controllers:
    main: {driver: ccs, port: COM3, channels: 2, dialect: serial, baud: 9600}
    extra:
      driver: template
      port: COM4
      top_level: 1023
      template:
        set: "L{channel}{level:04d}\\r\\n"
        set_reply: 'OK|A'
        off: "O{channel0}{letter}\\x03"
        off_reply: OK
        read: "?{channel}"
        read_reply: '(?P<level>\\d+)'
        end: "\\r\\n"
  lights:
    left: {controller: main, channel: 1, level: 200, max_level: 220, max_on_s: 5}
    right: {controller: extra, channel: 4, level: 1000}
  stage:
    driver: grbl
    port: /dev/ttyUSB0
    elevation: {axis: X, steps_per_deg: -1.5, zero: -90}
    rotation: {axis: Y}
  camera:
    driver: folder
    folder: frames
  timing: {light_ms: 50, discard_frames: 2}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def problems(folder: Path, text: str) -> list[str]:
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load_rig(path)
    return [m.removeprefix(f"{path}:") for m in caught.value.messages]


def test_everything_that_it_can_say(tmp_path: Path) -> None:
    hardware = load_rig(write(tmp_path, RIG)).hardware
    assert hardware is not None
    main, extra = hardware.controllers["main"], hardware.controllers["extra"]
    assert (main.driver, main.port, main.channels, main.dialect, main.baud, main.top_level) == (
        ("ccs", "COM3", 2, "serial", 9600, 255)
    )
    assert extra.template is not None
    assert (extra.template.set, extra.template.off) == ("L{channel}{level:04d}\r\n", "O{channel0}{letter}\x03")
    assert extra.template.read_reply == r"(?P<level>\d+)"
    left = hardware.lights["left"]
    assert (left.controller, left.channel, left.level, left.max_level, left.max_on_s) == ("main", 1, 200, 220, 5)
    assert hardware.stage is not None
    assert hardware.stage.elevation is not None
    assert (hardware.stage.elevation.steps_per_deg, hardware.stage.elevation.zero) == (-1.5, -90)
    assert (hardware.stage.home_timeout_s, hardware.stage.elevation.home_sense) == (180, -1)
    assert hardware.camera.folder == "frames"
    assert (hardware.timing.light_ms, hardware.timing.stage_ms, hardware.timing.discard_frames) == (50, 200, 2)


def test_without_the_section_there_is_none(tmp_path: Path) -> None:
    assert load_rig(write(tmp_path, RIG[: RIG.index("hardware:")])).hardware is None


def test_the_sample_says_the_same_rig_as_the_plain_one() -> None:
    """The sample with devices is the sample without, so that images of one are images of the other."""
    plain, wired = (load_rig(CONFIGS / "rigs" / f"{name}.yaml") for name in ("four-panel", "four-panel-serial"))
    assert wired.hardware is not None
    ports = [c.port for c in wired.hardware.controllers.values()]
    assert {*ports, wired.hardware.stage.port if wired.hardware.stage else ""} == {"virtual"}
    left_out = {"name", "hardware"}
    first, second = (rig.model_dump(exclude=left_out) for rig in (plain, wired))
    assert (first["camera"].pop("exposure_us"), second["camera"].pop("exposure_us")) == (None, 10000)
    assert first == second


def test_drivers_of_the_file_are_those_that_exist() -> None:
    schema = ControllerConfig.model_json_schema()["properties"]["driver"]["enum"]
    assert set(schema) == set(LIGHT_DRIVERS)


MAIN = "main: {driver: ccs, port: COM3, channels: 2, dialect: serial, baud: 9600}"
LEFT = "left: {controller: main, channel: 1, level: 200, max_level: 220, max_on_s: 5}"
RIGHT = "right: {controller: extra, channel: 4, level: 1000}"
BAD = [
    (
        MAIN,
        "main: {driver: css, port: COM3}",
        "controllers.main.driver",
        ["ccs, sa or template, which suits devices of other makers", 'found "css"'],
    ),
    (MAIN, "main: {driver: ccs, prot: COM3}", "controllers.main", ['did you mean "port"?']),
    (MAIN, "main: {driver: ccs}", "controllers.main", ['missing key "port"', "/dev/serial/by-id"]),
    (MAIN, "main: 3", "controllers.main", ['"key: value"', "found 3"]),
    (MAIN, "main: {driver: sa, port: COM3, channels: 7}", "controllers.main.channels", ["at most 6", "sa", "7"]),
    (
        MAIN,
        "main: {driver: sa, port: COM3, dialect: serial}",
        "controllers.main.dialect",
        ["driver sa has no such key; it belongs to ccs"],
    ),
    (MAIN, "main: {driver: ccs, port: COM3, baud: 1}", "controllers.main.baud", ["300 to 4000000", "found 1"]),
    (MAIN, "main: {driver: template, port: COM3}", "controllers.main", ['missing key "template"']),
    (
        MAIN,
        "main: {driver: ccs, port: COM3, template: {set: 'L{level}'}}",
        "controllers.main.template",
        ["driver ccs has no such key; it belongs to template"],
    ),
    (MAIN, MAIN[:-1] + ", monitor: 2}", "controllers.main.monitor", ["driver ccs has no such key", "to screen"]),
    (
        MAIN,
        MAIN[:-1] + ", picture: {resolution_px: [4, 3]}}",
        "controllers.main.picture",
        ["driver ccs has no such key; it belongs to screen, command"],
    ),
    (MAIN, MAIN + "\n    bad name: {driver: sa, port: COM9}", "controllers.bad name", ["a name of letters", '"bad']),
    (LEFT, "", "lights", ['light "left"', "no channel", "left: {controller"]),
    (RIGHT, RIGHT + "\n    rihgt: {controller: main, channel: 2, level: 9}", "lights.rihgt", ['mean "right"?']),
    (
        RIGHT,
        "right: {controller: main, channel: 1, level: 9}",
        "lights.right.channel",
        ['"1" is already that of lights.left'],
    ),
    (RIGHT, "right: {controller: exra, channel: 1, level: 9}", "lights.right.controller", ["main, extra", '"exra"']),
    (
        RIGHT,
        "right: {controller: extra, channel: 5, level: 9}",
        "lights.right.channel",
        ["at most 4, the channels of extra", "5"],
    ),
    (RIGHT, "right: {controller: extra, channel: 0, level: 9}", "lights.right.channel", ["from 1", "found 0"]),
    (RIGHT, "right: {controller: extra, channel: 1, level: 0}", "lights.right.level", ["from 1", "found 0"]),
    (RIGHT, "right: {controller: extra, channel: 4, level: 1024}", "lights.right.level", ["1023", "extra", "1024"]),
    (LEFT, "left: {controller: main, channel: 1, level: 256}", "lights.left.level", ["at most 255", "found 256"]),
    (
        LEFT,
        "left: {controller: main, channel: 1, level: 200, max_level: 199}",
        "lights.left.level",
        ["at most max_level, 199", "found 200"],
    ),
    (
        LEFT,
        "left: {controller: main, channel: 1, level: 200, max_level: 300}",
        "lights.left.max_level",
        ["at most 255", "found 300"],
    ),
    ('        set: "L{channel}{level:04d}\\r\\n"\n', "", "controllers.extra.template", ['missing key "set"']),
    ("{level:04d}", "{levl}", "controllers.extra.template.set", ["no field {levl}", "{channel}, {channel0}, {letter}"]),
    ("{level:04d}", "7", "controllers.extra.template.set", ["{level} is missing"]),
    ("{level:04d}", "{level:04x}", "controllers.extra.template.set", ["{level:04x}", "{level:03d}"]),
    ("{level:04d}", "{level!r}", "controllers.extra.template.set", ["no field"]),
    ("{level:04d}", "{level", "controllers.extra.template.set", ["not a template", "written twice"]),
    ('"?{channel}"', "'?{channel}\\r'", "controllers.extra.template.read", ["double quotes", "\\r"]),
    ('"?{channel}"', '"?…"', "controllers.extra.template.read", ['"…" is no single byte']),
    ("'OK|A'", "'OK('", "controllers.extra.template.set_reply", ["not a regular expression"]),
    ("(?P<level>\\d+)", "\\d+", "controllers.extra.template.read_reply", ["(?P<level>...)"]),
    ("        read_reply: '(?P<level>\\d+)'\n", "", "controllers.extra.template.read_reply", ["(?P<level>...)"]),
    ('        read: "?{channel}"\n', "", "controllers.extra.template.read_reply", ["no `read`"]),
    ('        off: "O{channel0}{letter}\\x03"\n', "", "controllers.extra.template.off_reply", ["no `off`"]),
    ("steps_per_deg: -1.5", "steps_per_deg: 0", "stage.elevation.steps_per_deg", ["other than 0"]),
    ("{axis: Y}", "{axis: Q}", "stage.rotation", ["X, Y or Z", '"Q"']),
    ("{axis: Y}", "{axis: 1}", "stage.rotation.axis", ["in quotes", "found 1"]),
    ("{axis: Y}", "{axis: X}", "stage.rotation", ['"X" is already that of elevation']),
    ("{axis: Y}", "{axis: Y, home_sense: 0}", "stage.rotation.home_sense", ["other than 0"]),
    ("driver: grbl", "driver: grlb", "stage.driver", ["shot, gsc, grbl or zaber", '"grlb"']),
    ("/dev/ttyUSB0", "COM3", "stage.port", ['"COM3" is already that of controllers.main']),
    ("port: COM4", "port: com3", "controllers.extra.port", ['"com3" is already that of controllers.main']),
    ("    folder: frames\n", "", "camera", ['missing key "folder"']),
    ("driver: folder", "driver: virtual", "camera.folder", ["driver virtual has no such key; it belongs to folder"]),
    ("driver: folder", "driver: pylon", "camera.driver", ["virtual, folder, aravis or genicam", '"pylon"']),
    ("  exposure_us: 8000\n", "", "camera", ["exposure_us", "µs", "exposure 1"]),
    ("discard_frames: 2", "discard_frames: 2.5", "timing.discard_frames", ["whole number from 0 to 20"]),
]


@pytest.mark.parametrize(("old", "new", "keys", "words"), BAD, ids=lambda v: str(v)[:40])
def test_what_does_not_fit(tmp_path: Path, old: str, new: str, keys: str, words: list[str]) -> None:
    assert RIG.count(old) == 1
    found = problems(tmp_path, RIG.replace(old, new))
    assert len(found) == 1, found
    match = re.match(r"(\d+): hardware\.([^:]*(?:\.[^:]*)*): ", found[0])
    assert match is not None
    assert match[2] == keys
    for word in words:
        assert word in found[0]


def test_the_line_is_the_one_of_the_key(tmp_path: Path) -> None:
    text = RIG.replace("level: 1000", "level: 1024")
    line = text[: text.index("level: 1024")].count("\n") + 1
    assert problems(tmp_path, text)[0].startswith(f"{line}: hardware.lights.right.level: ")


def test_all_at_once(tmp_path: Path) -> None:
    text = RIG.replace("driver: ccs", "driver: css").replace("level: 1000", "level: 5000").replace("COM4", "COM3")
    assert [m.split(": ")[1] for m in problems(tmp_path, text)] == [
        "hardware.controllers.main.driver",
        "hardware.controllers.extra.port",
        "hardware.lights.right.level",
    ]


def test_values_that_are_no_words_are_told_as_well(tmp_path: Path) -> None:
    (found,) = problems(tmp_path, RIG.replace("driver: folder", "driver: {folder: 1}"))
    assert "hardware.camera.driver" in found
    assert load_lights(write(tmp_path, RIG.replace("controller: extra", "controller: [extra]"))).lights_unknown == (
        "right",
    )


def test_stage_without_an_axis(tmp_path: Path) -> None:
    text = RIG.replace("    elevation: {axis: X, steps_per_deg: -1.5, zero: -90}\n", "")
    (found,) = problems(tmp_path, text.replace("    rotation: {axis: Y}\n", ""))
    assert 'missing key "elevation" or "rotation"' in found
    assert load_rig(write(tmp_path, text)).hardware is not None  # one is enough


def test_exposure_time_is_not_needed_where_the_camera_is_virtual(tmp_path: Path) -> None:
    text = RIG.replace("  exposure_us: 8000\n", "").replace("driver: folder\n    folder: frames", "driver: virtual")
    assert load_rig(write(tmp_path, text)).camera.exposure_us is None


def test_many_virtual_ports_are_no_clash(tmp_path: Path) -> None:
    text = RIG.replace("COM3", "virtual").replace("COM4", "virtual").replace("/dev/ttyUSB0", "virtual")
    assert load_rig(write(tmp_path, text)).hardware is not None


def test_wrong_lights_do_not_hide_behind_the_devices(tmp_path: Path) -> None:
    found = problems(tmp_path, RIG.replace("azimuth_deg: 225", "azimuth_deg: north"))
    assert len(found) == 1
    assert "lights[1].azimuth_deg" in found[0]


def test_models_made_in_code_are_taken_as_they_are() -> None:
    rig = load_rig(CONFIGS / "rigs" / "four-panel-serial.yaml")
    again = RigConfig.model_validate(rig.model_dump())
    assert again.hardware == rig.hardware
    assert isinstance(again.hardware, HardwareConfig)
    assert isinstance(again.hardware.stage, StageDeviceConfig)


# ---- copies of the file in other folders


@pytest.mark.parametrize("where", [".", "out", "out/deeper"])
def test_a_copy_elsewhere_still_finds_the_folder_to_replay(tmp_path: Path, where: str) -> None:
    rig = load_rig(write(tmp_path, RIG))
    home = tmp_path / where
    home.mkdir(parents=True, exist_ok=True)
    text = copied_text(rig, home)
    assert (text == RIG) == (where == ".")
    copy = home / "copy.yaml"
    copy.write_text(text, encoding="utf-8")
    again = load_rig(copy)
    assert again.hardware is not None
    assert again.source.resolve(str(again.hardware.camera.folder)).resolve() == (tmp_path / "frames").resolve()


def test_a_rig_that_names_no_files_is_copied_as_it_is(tmp_path: Path) -> None:
    for name in ("four-panel-serial.yaml", "four-panel.yaml"):
        rig = load_rig(CONFIGS / "rigs" / name)
        comment, rest = rig.source.text.split("\n", 1)
        assert "$schema=" in comment
        assert copied_text(rig, tmp_path).split("\n", 1)[1] == rest


@pytest.mark.parametrize("where", [".", "out", "out/deeper"])
def test_the_schema_that_editors_read_is_found_from_a_copy(tmp_path: Path, where: str) -> None:
    schema = tmp_path / "schema" / "rig.json"
    schema.parent.mkdir()
    schema.write_text("{}", encoding="utf-8")
    rig = load_rig(write(tmp_path, "# yaml-language-server: $schema=schema/rig.json\n" + RIG))
    first, rest = copied_text(rig, tmp_path / where).split("\n", 1)
    assert (tmp_path / where / first.partition("$schema=")[2]).resolve() == schema.resolve()
    assert rest.startswith(RIG.split("\n", 1)[0])


@pytest.mark.parametrize("name", ["https://example.org/rig.json", "not/there.json"])
def test_a_schema_that_is_no_file_stays_as_it_is_named(tmp_path: Path, name: str) -> None:
    rig = load_rig(write(tmp_path, f"# yaml-language-server: $schema={name}\n" + RIG))
    assert copied_text(rig, tmp_path / "out").startswith(f"# yaml-language-server: $schema={name}\n")


# ---- whatever is written there, it is told in messages with a line

_SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 2000),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(["", "ccs", "virtual", "COM3", "{level}", "main", "left", "X", "\\r", "("]),
)
_ANYTHING = st.recursive(
    _SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=2), st.dictionaries(st.sampled_from(["main", "port", "set", "bad name"]), inner)
    ),
    max_leaves=6,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_value_anywhere(tmp_path: Path, data: st.DataObject) -> None:
    document = yaml.safe_load(RIG)
    here = document["hardware"]
    while True:
        key = data.draw(st.sampled_from(sorted(here, key=str)))
        if not isinstance(here[key], dict) or data.draw(st.booleans()):
            break
        here = here[key]
    here[key] = data.draw(_ANYTHING)
    path = write(tmp_path, yaml.safe_dump(document, sort_keys=False))
    try:
        load_rig(path)
    except InputError as error:
        for message in error.messages:
            assert re.match(rf"{re.escape(str(path))}:\d+: hardware", message), message


def test_a_camera_driver_that_is_none_says_nothing_of_exposure_times(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    text = RIG.replace("  exposure_us: 8000\n", "")
    assert "driver: folder" in text
    path.write_text(text.replace("driver: folder", "driver: floder"), encoding="utf-8")
    with pytest.raises(InputError) as raised:
        load_rig(path)
    assert 'expected virtual, folder, aravis or genicam, found "floder"' in str(raised.value)
    assert "exposure_us" not in str(raised.value)


def test_the_page_has_every_key_with_its_default() -> None:
    sections = {
        "`controllers.NAME`": ControllerConfig,
        "`controllers.NAME.template`": TemplateConfig,
        "`controllers.NAME.picture`": PictureConfig,
        "`lights.NAME`": ChannelConfig,
        "`stage`": StageDeviceConfig,
        "`stage.elevation`, `stage.rotation`": AxisConfig,
        "`camera`": CameraDeviceConfig,
        "`timing`": TimingConfig,
    }
    expected: list[tuple[str, str, str]] = []
    for section, model in sections.items():
        for key, field in model.model_fields.items():
            default = field.default
            text = f"{default:g}" if isinstance(default, float) else str(default).lower()
            expected.append((section, f"`{key}`", "required" if field.is_required() else text))
    page = (CONFIGS.parent / "docs" / "reference" / "devices.md").read_text(encoding="utf-8")
    _, _, table = page.partition("## All keys of `hardware`")
    rows = [line.strip("| ").split(" | ")[:3] for line in table.splitlines() if line.startswith("| `")]
    assert [tuple(row) for row in rows] == expected
