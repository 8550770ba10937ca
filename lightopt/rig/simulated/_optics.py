"""Frames of the virtual bench's camera: the part under the current light levels, in the current posture."""

import hashlib
import math
import struct
import threading
from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from lightopt.config import LightConfig
from lightopt.core.arrays import Float32, Float64, UInt8
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight, picture_patterns
from lightopt.optics import expose
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.rig.simulated._bench_process import BenchTruth, LightWire
from lightopt.rig.simulated._firmware import SeenPicture
from lightopt.scene import Scene, display_picture, move_part

COMPARED_COLUMNS = 100  # pixels that pictures are compared in
MISFIT = 2e-3  # share of the full radiance that a sum of channels may be off, beside the rounding of levels
LEAST_SHARE = 2e-3  # of a channel: less is rounding
Levels = UInt8 | NDArray[np.uint16]
_CACHE_BYTES = 512 << 20
_MOST_PICTURES = 64  # that are kept, other than those of channels


def as_channels(
    picture: SeenPicture, lights: Sequence[LightConfig], *, folder: Path = Path()
) -> dict[str, float] | None:
    """Shares of channels of a display that a picture is the sum of, by name; None where it is no such sum."""
    rows, columns = picture.radiance.shape
    # blocks of whole pixels, whose means are those of the pattern
    common = math.gcd(rows, columns)
    side = max(k for k in range(1, common + 1) if common % k == 0 and k <= max(1, columns // COMPARED_COLUMNS))
    shape = rows // side, columns // side
    expected = np.stack([display_picture(light, shape[::-1], folder=folder).ravel() for light in lights], axis=1)
    seen, rounding = (_block_means(one, shape).ravel() for one in (picture.radiance, picture.rounding))
    found, _ = nnls(expected, seen)
    if (np.abs(expected @ found - seen) > MISFIT + rounding).any():
        return None
    return {light.name: float(share) for light, share in zip(lights, found, strict=True) if share > LEAST_SHARE}


def _block_means(picture: Float64, shape: tuple[int, int]) -> Float64:
    # means over so many rows and columns of blocks of whole pixels
    for axis, count in enumerate(shape):
        edges = np.arange(count + 1) * picture.shape[axis] // count
        sums = np.add.reduceat(picture, edges[:-1], axis=axis)
        picture = sums / np.expand_dims(np.diff(edges), 1 - axis)
    return picture


class BenchOptics:
    """Renders a part under given light levels: one cached linear layer per light and posture serves all exposures.

    Of a part that moves there is one per exposure.
    """

    def __init__(
        self, scene: Scene, truth: BenchTruth, displays: Sequence[LightConfig] = (), *, folder: Path = Path()
    ) -> None:
        rotation = rotation_from_vector(np.array(truth.part_rotation, np.float64))
        moved = move_part(scene, rotation, np.array(truth.part_offset_mm, np.float64))
        sensor = replace(scene.sensor, black_level=scene.sensor.black_level + truth.dark_level)
        self.scene = replace(moved, bounces=truth.bounces, sensor=sensor)
        self._truth = truth
        self._caster: RayCaster = cast_rays_at(self.scene)
        self._layers: OrderedDict[tuple[Posture, str, float | None], Float32] = OrderedDict()
        self._rendering = threading.Lock()
        self._taken: dict[bytes, int] = {}
        self._displays = {light.name: light for light in displays}
        self._folder = folder  # of the rig's file
        self._looking = threading.Lock()
        self._shown: dict[str, tuple[int, dict[str, float]]] = {}
        self._pictures: OrderedDict[str, PanelLight] = OrderedDict()

    def prepare(self, posture: Posture, names: Collection[str] = (), *, exposure: float = 1.0) -> None:
        """Render all lights at a posture, and what of the names is a picture, for frames to come."""
        for name in (self.scene.lights[0].name, *names):
            self._layer(posture, name, exposure)

    def shares(self, device: str, picture: SeenPicture, wires: Sequence[LightWire]) -> dict[str, float]:
        """What a picture on a screen lights: shares of its channels, or a name of its own, all for :meth:`frame`.

        A sum of pictures of channels takes no new rendering; any other picture is rendered.
        """
        with self._looking:
            number, shares = self._shown.get(device, (-1, {}))
            lights = [self._displays[wire.light] for wire in wires if wire.light in self._displays]
            if number == picture.number or not lights:
                return shares
            found = as_channels(picture, lights, folder=self._folder)
            if found is None:
                name = f"{device} picture {picture.number}"
                display = next(light for light in self.scene.lights if light.name == lights[0].name)
                assert isinstance(display, SurfaceLight)
                [pattern] = picture_patterns([picture.radiance], display.size)
                self._pictures[name] = replace(display, name=name, pattern=pattern)
                if len(self._pictures) > _MOST_PICTURES:
                    self._pictures.popitem(last=False)
                shares = {name: 1.0 / wires[0].share}
            else:
                shares = {wire.light: found[wire.light] / wire.share for wire in wires if wire.light in found}
            self._shown[device] = picture.number, shares
            return shares

    def frame(
        self,
        shares: Mapping[str, float],
        posture: Posture,
        *,
        exposure: float,  # relative
        gain_db: float = 0.0,  # of the camera [dB]: signal and noise alike, and fewer electrons per level
    ) -> Levels:
        """One frame with noise, quantised and saturated, under lights with `shares` of the brightness in the rig file.

        The noise depends on the seed, on what is seen, and on how many frames of it were taken before.
        """
        gain, sensor = 10.0 ** (gain_db / 20.0), self.scene.sensor
        electrons = None if sensor.electrons_per_level is None else sensor.electrons_per_level / gain
        noises = {"read_noise_levels": sensor.read_noise_levels * gain, "dsnu_levels": sensor.dsnu_levels * gain}
        sensor = replace(sensor, electrons_per_level=electrons, **noises)
        level = np.full((self.scene.camera.height, self.scene.camera.width), self._truth.ambient_level, np.float32)
        lit = {name: share for name, share in sorted(shares.items()) if share > 0.0}
        for name, share in lit.items():
            factor = self._truth.gains.get(name, 1.0)
            level += np.float32(share * factor) * self._layer(posture, name, exposure)
        full_scale, rng = self.scene.reflectance.full_scale, self._noise(lit, posture, exposure)
        return expose(level, sensor=sensor, exposure=exposure * gain, full_scale=full_scale, rng=rng)

    def _noise(self, lit: Mapping[str, float], posture: Posture, exposure: float) -> np.random.Generator:
        numbers = (*lit.values(), posture.elevation_deg, posture.rotation_deg, exposure)
        state = ",".join(lit).encode() + struct.pack(f"<{len(numbers)}d", *numbers)
        self._taken[state] = number = self._taken.get(state, -1) + 1
        digest = hashlib.sha256(state + struct.pack("<qq", number, self._truth.seed)).digest()
        return np.random.default_rng(int.from_bytes(digest[:16], "little"))

    def _layer(self, posture: Posture, light: str, exposure: float) -> Float32:
        blur = None if self.scene.motion is None else exposure
        with self._rendering:
            if (posture, light, blur) not in self._layers:
                # all lights at once: the rays are cast once, and the others are wanted next
                picture = self._pictures.get(light)
                scene = self.scene if picture is None else replace(self.scene, lights=(picture,))
                images = render_posture(
                    scene, posture, caster=self._caster, supersample=self._truth.rays, exposure=blur
                )
                self._layers |= {(posture, image.light, blur): image.level for image in images.lights}
            layer = self._layers[posture, light, blur]
            for name in (light, *(one.name for one in self.scene.lights)):
                if (posture, name, blur) in self._layers:
                    self._layers.move_to_end((posture, name, blur))
            while len(self._layers) > len(self.scene.lights) and len(self._layers) * layer.nbytes > _CACHE_BYTES:
                self._layers.popitem(last=False)
            return layer
