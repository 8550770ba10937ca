"""Names of the files of an image set, relative to its folder."""

from collections.abc import Iterable
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture

MANIFEST_NAME = "manifest.json"

ImageKey = tuple[str, Posture, float]


def _number(value: float) -> str:
    """Shortest decimal text that reads back as the same number: 0, 82, −12.5, 0.0625."""
    return np.format_float_positional(float(value) + 0.0, trim="-")


def posture_folder(posture: Posture) -> str:
    return f"posture_{_number(posture.elevation_deg)}_{_number(posture.rotation_deg)}"


def png_name(light: str, posture: Posture, exposure: float) -> str:
    return f"{posture_folder(posture)}/{light}{_exposure_suffix(exposure)}.png"


def dark_name(posture: Posture, exposure: float) -> str:
    return f"{posture_folder(posture)}/dark{_exposure_suffix(exposure)}.png"


def sheet_name(exposure: float) -> str:
    return f"contact-sheet{_exposure_suffix(exposure)}.png"


def _exposure_suffix(exposure: float) -> str:
    return "" if exposure == 1 else f"_x{_number(exposure)}"


def exr_name(light: str, posture: Posture) -> str:
    return f"{posture_folder(posture)}/{light}.exr"


def geometry_name(posture: Posture) -> str:
    return f"{posture_folder(posture)}/geometry.exr"


class FileNames:
    """File names of a run, each reserved by one image: two images must not share a file on any platform."""

    def __init__(self) -> None:
        self._owners: dict[str, str] = {MANIFEST_NAME: "the manifest"}

    def claim(self, name: str, owner: str) -> None:
        """Reserve a file for `owner`; InputError when another has it (case is ignored, as on some platforms)."""
        other = self._owners.setdefault(name.casefold(), owner)
        if other != owner:
            advice = "give the lights names that differ in more than case and that do not end like an exposure (_x2)"
            raise InputError(f"{other} and {owner} would both be written to {name}; {advice}")

    def claim_images(self, keys: Iterable[ImageKey]) -> None:
        """Reserve the files of images and of their postures' geometry; InputError where two would share one."""
        for light, posture, exposure in keys:
            where = posture_folder(posture)
            self.claim(geometry_name(posture), f"the geometry of {where}")
            self.claim(exr_name(light, posture), f"light {light!r} in {where}")
            self.claim(png_name(light, posture, exposure), f"light {light!r} at exposure {exposure:g} in {where}")


def inside_problem(name: str) -> str | None:
    """Why a manifest's path does not name a file inside the set's folder, or None when it does."""
    windows = PureWindowsPath(name)
    if "\\" in name:
        return "expected forward slashes"
    if not name or windows.drive or windows.root or "\x00" in name:
        return "expected a path relative to the manifest's folder"
    if ".." in PurePosixPath(name).parts or PurePosixPath(name) == PurePosixPath():
        return "expected a file inside the manifest's folder"
    return None
