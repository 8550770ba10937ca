"""What a batch reuses from set to set: meshes, predictions, their derivatives with respect to the placement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.defects import CatalogueEntry
from lightopt.estimate.registration import Observation, Placement, Registration
from lightopt.estimate.verification import RigAdjustment, adjust_rig
from lightopt.geometry import RayCaster
from lightopt.inspection.prediction import _nearby_placement as nearby
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._predict import Prediction, SurfaceMap, map_surface, predict
from lightopt.inspection.prediction._template_bank import TemplateBank, bank_bytes, template_bank
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene

Key = tuple[Posture, tuple[str, ...]]  # a posture and the lights that there are images of
ExposuresKey = tuple[tuple[tuple[float, int], ...], ...]  # of each light: relative exposures and numbers of frames

SAME_PLACE_MM = 0.002
SAME_TURN_RAD = 5e-5  # a part that was found this near to the previous one takes over its prediction as it is

# Derivatives are stored up to this size: six images for each image of a set. Where they are larger, each part is
# searched for.
MOST_BYTES = 1 << 30


@dataclass
class PredictionCache:
    """The part inspected last, at its placement, for the next sets of a batch."""

    # scenes with the part where its file has it, by postures and lights
    nominal_scenes: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] = field(default_factory=dict)
    adjustment: RigAdjustment | None = None  # of a calibrated rig, by the first set
    # where the last part lay, and the scene with it there
    placement: Placement | None = None
    scene: Scene | None = None
    caster: RayCaster | None = None
    rendered: dict[Key, Prediction] = field(default_factory=dict)  # predictions with the part there
    derivatives: dict[Key, nearby.PlacementDerivatives] = field(default_factory=dict)
    registration: Registration | None = None
    misfit: float | None = None
    # pixels that determine the placement, by posture and lights, light, and whether derivatives are known
    samples: dict[tuple[Key, str, bool], nearby.PixelSample] = field(default_factory=dict)
    surface_maps: dict[tuple[Posture, ...], SurfaceMap] = field(default_factory=dict)
    banks: dict[tuple[Key, ExposuresKey], TemplateBank] = field(default_factory=dict)

    def adjusted(
        self, rig: RigConfig, scene: Scene, observations: Sequence[Observation], *, register: bool, run: RunContext
    ) -> Scene:
        """The scene with a calibrated rig as the first set's images show it.

        As it is if nothing was calibrated, and if other light than that of the lights themselves reaches the part,
        which the fit does not know.
        """
        if rig.calibration is None or scene.bounces or scene.is_surrounded:
            return scene
        if self.adjustment is None:
            self.adjustment = adjust_rig(rig, scene, observations, register=register, run=run)
        return scene if self.adjustment is None else self.adjustment.apply(scene)

    def restore_adjustment(self, adjustment: RigAdjustment | None) -> None:
        """Take back the rig of a set that was refused, with what was predicted for that rig."""
        if self.adjustment is not adjustment:
            self.adjustment, self.placement = adjustment, None

    def use_placement(self, scene: Scene, placement: Placement) -> tuple[Scene, Placement]:
        """The scene and placement to predict with: those of the previous part, if that lay in the same place.

        Postures and lights stay those of `scene`: sets of one batch may show different ones.
        """
        if self.placement is not None and self.scene is not None and _same(self.placement, placement):
            return replace(self.scene, postures=scene.postures, lights=scene.lights), self.placement
        self.placement, self.scene, self.caster, self.misfit = placement, scene, None, None
        for cached in (self.rendered, self.derivatives, self.samples, self.surface_maps, self.banks):
            cached.clear()
        return scene, placement

    def prediction(
        self, scene: Scene, posture: Posture, exposures: Mapping[str, Sequence[float]], *, threads: int | None = None
    ) -> Prediction:
        """The prediction of a posture under some lights, for a scene from :meth:`use_placement`.

        exposures: Of the images of each light, in the scene's order
        """
        key = posture, tuple(exposures)
        if key not in self.rendered or scene.motion is not None:
            how: dict[str, Any] = {"lights": key[1], "exposures": exposures, "threads": threads}
            self.rendered[key] = predict(scene, posture, self._caster(scene), **how)
        return self.rendered[key]

    def shifted_prediction(
        self, scene: Scene, posture: Posture, lights: Sequence[str], offset: Float64, *, threads: int | None
    ) -> Prediction:
        """The prediction of a posture for a part slightly displaced from the previous one: :meth:`nearby_placement`."""
        key = posture, tuple(lights)
        moved = offset * nearby.difference_steps(scene)
        return nearby.shift_prediction(self.rendered[key], self.derivatives[key], moved, threads=threads)

    def nearby_placement(
        self, nominal: Scene, observations: Sequence[Observation], *, threads: int | None = None
    ) -> tuple[Scene, Placement, Float64] | None:
        """Placement of a part that is close to the previous one; None if it is not close, or is the first.

        The scene of the predictions, the part's placement, and its offset from the predictions in steps of the
        derivatives, shape (3,). What the images do not determine is as for the previous part.

        nominal: the part where its file has it, with the postures and lights of the set.
        """
        if self.placement is None or self.scene is None or self.misfit is None or nominal.motion is not None:
            return None
        if self.registration is not None and self.registration.outline:
            # the levels inside the outline, which the offset is fitted to, do not say where the part is
            return None
        scene = replace(self.scene, postures=nominal.postures, lights=nominal.lights)
        keys = _keys(scene, observations)
        if any(key not in self.rendered for key in keys.values()):
            return None
        if any(key not in self.derivatives for key in keys.values()):
            pixels = sum(len(key[1]) for key in keys.values()) * scene.camera.width * scene.camera.height
            if 6 * 4 * pixels > MOST_BYTES:
                return None
            found = self._fit(scene, observations, keys, moves=True, threads=threads)
            if not found.near or found.misfit > nearby.LOOSE * self.misfit:
                return None
            for key in keys.values():
                if key not in self.derivatives:
                    self.derivatives[key] = nearby.placement_derivatives(
                        scene, self.placement, key[0], self.rendered[key], self._caster(scene), threads=threads
                    )
        found = self._fit(scene, observations, keys, moves=True, threads=threads)
        if not found.near or found.misfit > nearby.TIGHT * self.misfit:
            return None
        return scene, found.placement(scene, self.placement), found.offset

    def measure_misfit(self, scene: Scene, observations: Sequence[Observation], *, threads: int | None = None) -> None:
        """Remember how well a part's images fit the predictions that were made for it."""
        if self.misfit is None:
            keys = _keys(scene, observations)
            self.misfit = self._fit(scene, observations, keys, moves=False, threads=threads).misfit

    def surface_map(
        self, scene: Scene, expected: Sequence[Posture] = (), *, threads: int | None = None
    ) -> SurfaceMap | None:
        """Patches of the surface and the pixels that see them; None for a single posture.

        scene: with the postures that there are images of.
        expected: those that there should be images of.
        """
        postures = tuple(dict.fromkeys((*scene.postures, *expected)))
        if len(postures) < 2:
            return None
        if postures not in self.surface_maps:
            here = replace(scene, postures=postures)
            self.surface_maps[postures] = map_surface(here, self._caster(scene), threads=threads)
        return self.surface_maps[postures]

    def template_bank(
        self,
        scene: Scene,
        view: PostureView,
        exposures: Mapping[str, tuple[tuple[float, int], ...]],
        catalogue: Sequence[CatalogueEntry],
        *,
        threads: int | None = None,
    ) -> TemplateBank:
        """What the defects of a part's catalogue would change in a view of the scene of its prediction.

        For a part that lies a little off the previous one it is that of the previous one, if its images have the same
        exposures. Banks are kept up to :data:`MOST_BYTES`.
        """
        key = (view.posture, view.lights), tuple(exposures[light] for light in view.lights)
        if (kept := self.banks.get(key)) is not None:
            return kept
        bank = template_bank(scene, view, catalogue, self._caster(scene), threads=threads)
        if sum(map(bank_bytes, (*self.banks.values(), bank))) <= MOST_BYTES:
            self.banks[key] = bank
        return bank

    def _caster(self, scene: Scene) -> RayCaster:
        if self.caster is None:
            self.caster = cast_rays_at(scene)
        return self.caster

    def _fit(
        self,
        scene: Scene,
        observations: Sequence[Observation],
        keys: dict[Posture, Key],
        *,
        moves: bool,
        threads: int | None,
    ) -> nearby.PlacementOffset:
        assert self.placement is not None
        placement = self.placement
        asked = [(keys[o.posture], o.light, keys[o.posture] in self.derivatives) for o in observations]
        fresh = [mine for mine in dict.fromkeys(asked) if mine not in self.samples]

        def sample(mine: tuple[Key, str, bool]) -> nearby.PixelSample:
            key, light, _ = mine
            return nearby.sample_pixels(scene, placement, self.rendered[key], self.derivatives.get(key), light)

        self.samples |= dict(zip(fresh, in_threads(sample, fresh, threads), strict=True))
        samples = [self.samples[mine] for mine in asked]
        return nearby.fit_placement_offset(scene, placement, observations, samples, moves=moves)


def observed_lights(scene: Scene, observations: Sequence[Observation]) -> tuple[str, ...]:
    """Names of the lights that there are images of, in the scene's order."""
    return tuple(light.name for light in scene.lights if any(o.light == light.name for o in observations))


def _keys(scene: Scene, observations: Sequence[Observation]) -> dict[Posture, Key]:
    # of each posture, the lights that the set has for it in the rig's order
    return {
        posture: (posture, observed_lights(scene, [o for o in observations if o.posture == posture]))
        for posture in scene.postures
    }


def _same(a: Placement, b: Placement) -> bool:
    distance = max(abs(a.x - b.x), abs(a.y - b.y))
    return distance <= SAME_PLACE_MM and abs(a.turn - b.turn) <= SAME_TURN_RAD
