"""Cameras that answer, those that do not, and what is said where a camera's software is not there."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from camera_worlds import needs, viky
from fault_cases import make_rig

from lightopt.cli._main import run
from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import CameraSettings, check_camera_driver, find_cameras, open_camera
from lightopt.rig.devices._camera_features import PIXEL_FORMATS, levels_of
from lightopt.rig.devices._camera_genicam import GenicamSdk
from lightopt.rig.devices._drivers import CAMERA_DRIVERS
from lightopt.rig.simulated._camera_gige import FORMATS, packed

SETTINGS = {"where": "rig.yaml:3: camera", "resolution_px": (160, 120), "bit_depth": 8}


def rig_with(folder: Path, camera: str) -> Path:
    rig, _ = make_rig(folder)
    text = rig.read_text(encoding="utf-8").replace("camera: {driver: virtual}", f"camera: {camera}")
    rig.write_text(text, encoding="utf-8", newline="\n")
    return rig


def test_cameras_of_a_producer_are_listed() -> None:
    needs("genicam")
    cameras, _ = find_cameras(viky())
    assert [camera.serial for camera in cameras if camera.driver == "genicam"] == ["0", "1", "2"]


def test_producers_that_installers_have_named_are_queried(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("genicam")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(viky().parent))
    cameras, _ = find_cameras()
    assert "VikyTL_DEV_red" in [camera.identifier for camera in cameras]


def test_bench_devices_lists_cameras_and_whether_the_rigs_is_there(tmp_path: Path, capsys) -> None:
    needs("genicam")
    for port, there in (("1", "yes"), ("7", "NO: 0 answer")):
        folder = tmp_path / port
        rig = rig_with(folder, f'{{driver: genicam, producer: {viky()}, port: "{port}"}}')
        assert run(["bench", "devices", str(rig)]) == 0
        said = capsys.readouterr().out
        assert "VikyTL_DEV_green" in said
        assert said.splitlines()[-1].endswith(there)


def test_a_producer_that_is_none_is_refused(tmp_path: Path) -> None:
    needs("genicam")
    settings = CameraSettings(**SETTINGS, producer=str(tmp_path / "x.cti"))
    with pytest.raises(InputError, match=r"no GenTL producer .*x\.cti"):
        open_camera("genicam", settings)
    (tmp_path / "x.cti").write_bytes(b"nothing")
    with pytest.raises(HardwareError, match=r"x\.cti cannot be used"):
        open_camera("genicam", settings)


def test_a_camera_that_does_not_answer_is_refused() -> None:
    needs("aravis")
    with pytest.raises(InputError, match=r"rig\.yaml:3: camera: no camera NO-SUCH; there is .*bench devices"):
        open_camera("aravis", CameraSettings(**SETTINGS, port="NO-SUCH"))


def test_the_only_exposure_of_viky_is_the_one_that_is_vouched_for() -> None:
    needs("genicam")
    with pytest.raises(InputError, match="write fixed_exposure_us"):
        open_camera("genicam", CameraSettings(**SETTINGS, producer=str(viky()), port="0"))


@pytest.mark.parametrize(("driver", "module"), [("aravis", "gi"), ("genicam", "harvesters.core")])
def test_software_that_is_not_there_is_named_with_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, driver: str, module: str
) -> None:
    def lacking(name: str):
        if name == module:
            raise ImportError(f"No module named '{name}'")
        return import_module(name)

    monkeypatch.setattr(f"lightopt.rig.devices._camera_{driver}.import_module", lacking)
    with pytest.raises(InputError) as raised:
        check_camera_driver(driver, None)
    assert f"pip install 'lightopt[{driver}]'" in str(raised.value)
    producer = f", producer: {__file__}" if driver == "genicam" else ""
    rig = rig_with(tmp_path, f"{{driver: {driver}{producer}}}")
    part = rig.with_name("part.yaml")
    assert run(["capture", str(rig), str(part), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"{rig}:" in said
    assert "lightopt[" in said
    assert not list((tmp_path / "out").rglob("*.png"))
    assert run(["bench", "devices"]) == 0  # a computer without cameras has serial ports all the same


def test_packed_pixels_of_a_producer_are_read_by_our_tables() -> None:
    """No producer at hand packs pixels; the bytes are those of the simulated GigE camera."""
    sent = np.random.default_rng(1).integers(0, 4096, (3, 5))
    code = FORMATS["Mono12p"][0]
    module = SimpleNamespace(
        frame_id=7,
        is_complete=lambda: True,
        padding_x=0,
        pixel_format=code,
        timestamp_ns=9,
        raw_buffer=b"head" + packed(sent, code) + b"tail",
    )
    part = SimpleNamespace(width=5, height=3, data_offset=4)
    sdk = GenicamSdk.__new__(GenicamSdk)
    sdk._where, sdk._lost = "rig", None
    buffer = SimpleNamespace(module=module, payload=SimpleNamespace(components=[part]))
    raw = sdk._raw(buffer)
    assert (raw.number, raw.code, raw.timestamp_ns, raw.problem) == (7, code, 9, None)
    assert np.array_equal(levels_of(raw.data, PIXEL_FORMATS["Mono12p"], width=5, height=3), sent)
    module.padding_x = 2
    with pytest.raises(HardwareError, match="end with 2 bytes that are no pixels"):
        sdk._raw(buffer)
    module.is_complete = lambda: False
    assert sdk._raw(buffer).problem == "parts of it were lost"


def test_every_driver_that_rig_files_may_name_is_there() -> None:
    assert set(CAMERA_DRIVERS) == {"aravis", "genicam"}


BAD = [
    ("{driver: genicam}", 'missing key "producer"'),
    ("{driver: aravis, producer: x.cti}", "driver aravis has no such key; it belongs to genicam"),
    ("{driver: genicam, producer: x.cti, packet_size: 1500}", "driver genicam has no such key; it belongs to aravis"),
    ("{driver: virtual, gain: 3}", "driver virtual has no such key; it belongs to aravis, genicam"),
    ("{driver: virtual, trigger: none}", "driver virtual has no such key; it belongs to aravis, genicam"),
    ("{driver: aravis, trigger: hardware}", "auto, software or none"),
    ("{driver: aravis, offset_px: [1, -1]}", "two whole numbers of pixels"),
    ("{driver: genicam, producer: x.cti, port: virtual}", "only driver: aravis has a simulated camera"),
    ("{driver: aravis, packet_size: 100}", "bytes, from 576 to 65535"),
    ("{driver: aravis, folder: x}", "driver aravis has no such key; it belongs to folder"),
]


@pytest.mark.parametrize(("camera", "words"), BAD)
def test_settings_that_no_camera_takes_are_refused_with_their_line(tmp_path: Path, capsys, camera, words) -> None:
    rig = rig_with(tmp_path, camera)
    line = next(i for i, text in enumerate(rig.read_text("utf-8").splitlines(), 1) if camera in text)
    assert run(["bench", "status", str(rig)]) == 2
    said = capsys.readouterr().err
    assert f"rig.yaml:{line}: hardware.camera" in said
    assert words in said
