"""Frames per second of each camera driver beside the bare loop of its library: ``python -m benchmarks.cameras``.

The GigE camera is Aravis' own on the loopback, triggered; the GenTL camera is the one that the genicam wheel brings,
which runs freely. Bare is what the libraries' own examples do: trigger, take the buffer, copy it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.rig.devices import CameraSettings, open_camera
from lightopt.rig.simulated._camera_gige import GigeCamera

SIZE = (640, 480)
FASTEST = 200.0


def ratios(frames: int) -> dict[str, tuple[float, float]]:
    """Frames per second of the driver and of the bare loop, by driver."""
    image = np.zeros(SIZE[::-1], np.uint8)
    server = GigeCamera(lambda *_: image, resolution_px=SIZE, bit_depth=8)
    try:
        gige = _gige_driver(server, frames), _gige_bare(frames)
    finally:
        server.close()
    return {"aravis": gige, "genicam": (_gentl_driver(frames), _gentl_bare(frames))}


def _rate(frames: int, take: Callable[[], Any]) -> float:
    for _ in range(3):
        take()
    begun = time.perf_counter()
    for _ in range(frames):
        take()
    return frames / (time.perf_counter() - begun)


def _gige_driver(server: GigeCamera, frames: int) -> float:
    settings = CameraSettings(where="gige", resolution_px=SIZE, bit_depth=8, port=server.serial)
    camera = open_camera("aravis", settings)
    try:
        camera.set_exposure(100.0)
        return _rate(frames, lambda: camera.grab(timeout_s=5))
    finally:
        camera.close()


def _gige_bare(frames: int) -> float:
    library = import_module("gi.repository.Aravis")
    camera = library.Camera.new("127.0.0.1")
    camera.gv_set_stream_options(library.GvStreamOption.PACKET_SOCKET_DISABLED)
    camera.set_exposure_time(100.0)
    camera.set_trigger("Software")
    stream = camera.create_stream(None, None)
    stream.set_property("socket-buffer", library.GvStreamSocketBuffer.FIXED)  # else packets are lost
    stream.set_property("socket-buffer-size", 4 << 20)
    for _ in range(4):
        stream.push_buffer(library.Buffer.new_allocate(camera.get_payload()))
    camera.start_acquisition()

    def take() -> np.ndarray:
        while True:  # a frame that lost packets on a busy computer is taken again, as the driver does
            camera.software_trigger()
            buffer = stream.timeout_pop_buffer(5_000_000)
            if buffer is None:
                continue
            whole = buffer.get_status() == library.BufferStatus.SUCCESS
            frame = np.frombuffer(buffer.get_data(), np.uint8).copy()
            stream.push_buffer(buffer)
            if whole:
                return frame.reshape(SIZE[::-1])

    try:
        return _rate(frames, take)
    finally:
        camera.stop_acquisition()


def _producer() -> str:
    found = find_spec("genicam")
    assert found is not None
    return str(Path(found.origin or "").parent / "viky.cti")


def _gentl_driver(frames: int) -> float:
    settings = CameraSettings(
        where="gentl", resolution_px=SIZE, bit_depth=8, port="1", producer=_producer(), fixed_exposure_us=100.0
    )
    camera = open_camera("genicam", settings)
    try:
        camera._sdk.write("AcquisitionFrameRate", FASTEST)
        return _rate(frames, lambda: camera.grab(timeout_s=5))
    finally:
        camera.close()


def _gentl_bare(frames: int) -> float:
    harvester = import_module("harvesters.core").Harvester()
    harvester.add_file(_producer())
    harvester.update()
    acquirer = harvester.create({"serial_number": "1"})
    nodes = acquirer.remote_device.node_map
    nodes.PixelFormat.value, nodes.Width.value, nodes.Height.value = "Mono8", *SIZE
    nodes.AcquisitionFrameRate.value = FASTEST
    acquirer.num_buffers = 4
    acquirer.start()

    def take() -> np.ndarray:
        with acquirer.fetch(timeout=5) as buffer:
            return buffer.payload.components[0].data.reshape(SIZE[::-1]).copy()

    try:
        return _rate(frames, take)
    finally:
        acquirer.stop()
        acquirer.destroy()
        harvester.reset()


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cameras", description=__doc__)
    parser.add_argument("--frames", type=int, default=300)
    chosen = parser.parse_args(arguments)
    print("| driver | frames/s | bare loop of its library, frames/s | ratio |")
    print("|---|---:|---:|---:|")
    for driver, (ours, bare) in ratios(chosen.frames).items():
        print(f"| `{driver}` | {ours:.0f} | {bare:.0f} | {ours / bare:.2f} |")
    print(f"\n`python -m benchmarks.cameras --frames {chosen.frames}`, {SIZE[0]} × {SIZE[1]} pixels of 8 bits.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
