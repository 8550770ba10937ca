"""Whether the camera that is there is the rig's."""

from __future__ import annotations

from lightopt.core.errors import InputError
from lightopt.rig.capture._devices import Devices


def check_camera(devices: Devices, *, resolution_px: tuple[int, int], bit_depth: int, where: str) -> None:
    """Refuse a camera that is not the rig's, before anything is lit or moved.

    Raises
    ------
    InputError
        When resolution or bit depth differ.
    """
    camera = devices.camera
    if camera.resolution_px != tuple(resolution_px) or camera.bit_depth != bit_depth:
        raise InputError(
            f"{where}: the rig has {resolution_px[0]} × {resolution_px[1]} pixels of {bit_depth} bits, the camera "
            f"delivers {camera.resolution_px[0]} × {camera.resolution_px[1]} of {camera.bit_depth}; set the "
            "camera or the rig"
        )
