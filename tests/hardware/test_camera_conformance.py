"""What every camera does, whatever its driver, against the camera itself: rendered, replayed, GigE Vision, GenTL."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from camera_worlds import needs, viky
from fault_cases import make_rig

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CaptureOptions, capture, connect_devices, wiring_of
from lightopt.rig.capture._software_cameras import FolderCamera, VirtualCamera
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.devices import Camera, CameraSettings, open_camera

KINDS = ("virtual", "folder", "aravis", "aravis-free", "genicam")
TELLS = {"virtual", "aravis", "aravis-free"}  # can be told an exposure time


@pytest.fixture(scope="module")
def beds(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The small rig with a GigE camera, and its part."""
    rig, part = make_rig(tmp_path_factory.mktemp("camera"))
    text = rig.read_text(encoding="utf-8")
    gige = rig.with_name("gige.yaml")
    gige.write_text(
        text.replace("camera: {driver: virtual}", "camera: {driver: aravis, port: virtual}"),
        encoding="utf-8",
        newline="\n",
    )
    return rig, part


@contextmanager
def opened_as(kind: str, beds: tuple[Path, Path], folder: Path) -> Iterator[Camera]:
    """The camera of a kind, opened; closed twice in the end, which has to do no harm."""
    driver = kind.partition("-")[0]
    rig_file, part_file = beds
    with ExitStack() as stack:
        if driver == "genicam":
            settings = CameraSettings(
                where="viky",
                resolution_px=(160, 120),
                bit_depth=8,
                port="1",
                producer=str(viky()),
                fixed_exposure_us=2000.0,
            )
            camera: Camera = open_camera("genicam", settings)
        elif driver == "folder":
            rig, part = load_rig(rig_file), load_part(part_file)
            capture(rig, part, folder / "set", options=CaptureOptions(postures=(Posture(0.0, 0.0),)))
            camera = FolderCamera(folder / "set", resolution_px=(160, 120), exposure_us=2000.0)
            camera.show("light1", Posture(0.0, 0.0), 1.0)
        else:
            rig = load_rig(rig_file.with_name("gige.yaml") if driver == "aravis" else rig_file)
            bench = stack.enter_context(start_bench(rig, wiring_of(rig), part=load_part(part_file)))
            if driver == "virtual":
                camera = VirtualCamera(bench)
            else:
                settings = CameraSettings(
                    where="gige",
                    resolution_px=(160, 120),
                    bit_depth=8,
                    port=bench.ports["camera"],
                    trigger="none" if kind == "aravis-free" else "auto",
                )
                camera = open_camera("aravis", settings)
        stack.callback(camera.close)
        stack.callback(camera.close)
        yield camera


@pytest.mark.parametrize("kind", KINDS)
def test_conformance(kind: str, beds: tuple[Path, Path], tmp_path: Path) -> None:
    """One test for each camera: there is room for one GigE camera on a computer."""
    if (driver := kind.partition("-")[0]) in ("aravis", "genicam"):
        needs(driver)
    with opened_as(kind, beds, tmp_path) as camera:
        is_as_the_rig_and_says_who_it_is(camera, kind)
        frames_are_levels_of_the_exposure_that_is_held(camera)
        frames_are_counted_and_come_in_order(camera)
        a_frame_is_not_changed_by_the_next(camera)
        if kind != "folder":  # it holds any exposure, and says at the frame which it lacks
            an_exposure_beyond_its_range_is_refused(camera)
        if kind in TELLS:
            another_exposure_is_held_and_seen(camera)


def is_as_the_rig_and_says_who_it_is(camera: Camera, kind: str) -> None:
    assert camera.resolution_px == (160, 120)
    assert camera.bit_depth == 8
    assert camera.identify()["driver"] == kind.partition("-")[0]
    assert camera.identify()["port"]
    assert camera.triggered == (kind not in ("aravis-free", "genicam"))


def frames_are_levels_of_the_exposure_that_is_held(camera: Camera) -> None:
    held = camera.set_exposure(2000.0)
    assert held == 2000.0
    low, high = camera.exposure_range_us
    assert low <= held <= high
    frame = camera.grab(timeout_s=10)
    assert frame.levels.shape == (120, 160)
    assert frame.levels.dtype == np.uint8
    assert frame.exposure_us == held


def frames_are_counted_and_come_in_order(camera: Camera) -> None:
    frames = [camera.grab(timeout_s=10) for _ in range(4)]
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))
    if camera.triggered:
        assert np.diff(numbers).tolist() == [1, 1, 1]
    stamps = [frame.timestamp_ns for frame in frames]
    if None not in stamps:
        assert stamps == sorted(set(stamps))


def a_frame_is_not_changed_by_the_next(camera: Camera) -> None:
    first = camera.grab(timeout_s=10).levels
    kept = first.copy()
    for _ in range(6):  # more than there are buffers
        camera.grab(timeout_s=10)
    assert np.array_equal(first, kept)


def an_exposure_beyond_its_range_is_refused(camera: Camera) -> None:
    low, high = camera.exposure_range_us
    for wrong in (low / 2, high * 2):
        with pytest.raises(InputError, match="expected an exposure of"):
            camera.set_exposure(wrong)
    assert camera.grab(timeout_s=10).exposure_us == 2000.0  # it still holds what it held


def another_exposure_is_held_and_seen(camera: Camera) -> None:
    begun = time.monotonic()
    assert camera.set_exposure(200_000.0) == 200_000.0
    frame = camera.grab(timeout_s=10)
    assert frame.exposure_us == 200_000.0
    if camera.triggered:
        assert time.monotonic() - begun >= 0.2  # it began when it was asked for
    assert camera.set_exposure(2000.0) == 2000.0


def test_no_frame_in_time_is_an_error_that_says_so() -> None:
    needs("aravis")
    from faulty_bench import FaultyGigeCamera

    server = FaultyGigeCamera(lambda *_: np.zeros((120, 160), np.uint16), resolution_px=(160, 120), bit_depth=12)
    settings = CameraSettings(where="rig.yaml:3: camera", resolution_px=(160, 120), bit_depth=12, port=server.serial)
    opened = open_camera("aravis", settings)
    try:
        server.inject("lost", {"count": None})
        begun = time.monotonic()
        with pytest.raises(HardwareError, match=r"rig\.yaml:3: camera: no frame came within .*taken 3 times"):
            opened.grab(timeout_s=0.6)
        assert time.monotonic() - begun < 20
    finally:
        opened.close()
        server.close()


@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono12p", "Mono12Packed", "Mono10", "Mono10p", "Mono10Packed"])
def test_levels_of_every_packing_arrive_over_the_network(pixel_format: str) -> None:
    needs("aravis")
    from lightopt.rig.simulated._camera_gige import GigeCamera

    bits = int(pixel_format[4:6])
    image = np.random.default_rng(1).integers(0, 1 << bits, (120, 161)).astype(np.uint16)
    server = GigeCamera(lambda *_: image, resolution_px=(161, 120), bit_depth=bits)
    settings = CameraSettings(
        where="rig", resolution_px=(161, 120), bit_depth=bits, port=server.serial, pixel_format=pixel_format
    )
    opened = open_camera("aravis", settings)
    try:
        frame = opened.grab(timeout_s=5)
        assert np.array_equal(frame.levels, image)
        assert frame.levels.dtype == np.uint16
        assert frame.details["pixel_format"] == pixel_format
    finally:
        opened.close()
        server.close()


@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono12p"])
def test_a_part_of_the_sensor_is_that_part_of_its_pixels(pixel_format: str) -> None:
    needs("aravis")
    from lightopt.rig.simulated._camera_gige import GigeCamera

    image = np.random.default_rng(2).integers(0, 4096, (120, 160)).astype(np.uint16)
    server = GigeCamera(lambda *_: image, resolution_px=(160, 120), bit_depth=12)
    settings = CameraSettings(
        where="rig",
        resolution_px=(64, 32),
        bit_depth=12,
        port=server.serial,
        pixel_format=pixel_format,
        offset_px=(40, 24),
    )
    opened = open_camera("aravis", settings)
    try:
        assert np.array_equal(opened.grab(timeout_s=5).levels, image[24:56, 40:104])
    finally:
        opened.close()
        server.close()


@pytest.mark.slow
def test_gain_and_exposure_act_on_the_image(beds: tuple[Path, Path]) -> None:
    """Light from everywhere: four times the exposure is four times the level, and 6 dB twice."""
    needs("aravis")
    from dataclasses import replace

    from lightopt.rig.simulated import BenchTruth

    rig_file, part_file = beds
    rig, part = load_rig(rig_file.with_name("gige.yaml")), load_part(part_file)
    wiring = wiring_of(rig)
    means = []
    with start_bench(rig, wiring, part=part, truth=BenchTruth(ambient_level=20.0)) as bench:
        settings = CameraSettings(
            where="gige", resolution_px=(160, 120), bit_depth=8, port=bench.ports["camera"], gain=0.0
        )
        for gain, exposure_us in ((0.0, 2000.0), (0.0, 8000.0), (6.0, 8000.0)):
            opened = open_camera("aravis", replace(settings, gain=gain))
            opened.set_exposure(exposure_us)
            means.append(float(opened.grab(timeout_s=5).levels.mean()))
            opened.close()
    assert means == pytest.approx([20.0, 80.0, 80.0 * 10 ** (6 / 20)], rel=0.01)


@pytest.mark.slow
def test_the_sets_of_the_rendered_and_of_the_gige_camera_are_the_same(beds: tuple[Path, Path], tmp_path: Path) -> None:
    """What goes over the network is what the bench renders, bit for bit."""
    needs("aravis")
    from fault_runs import OPTIONS, differences

    rig_file, part_file = beds
    part = load_part(part_file)
    for name, file in (("rendered", rig_file), ("gige", rig_file.with_name("gige.yaml"))):
        rig = load_rig(file)
        done = capture(
            rig,
            part,
            tmp_path / name,
            options=OPTIONS,
            connect=lambda plan, rig=rig: connect_devices(rig, plan.wiring, part=part, plan=plan),
        )
        assert done.images == 8
    assert differences(tmp_path / "gige", tmp_path / "rendered") == []
