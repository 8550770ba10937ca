"""The light of an extended emitter: its surface cut into cells until each is small beside what varies over it.

An emitter is a list of patches: a place and an area vector (dA times where it shines to) for each (u, v), and a factor,
negative for what is cut out. Frame of an emitter: x across, y along, z outward, from its own centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ._shading import SMALLEST_COS_VIEW, dot, lambert, unit


@dataclass(frozen=True)
class Patch:
    """at: u, v (...) to places and area vectors per du dv (..., 3); pattern: u, v to a factor; period: its shortest"""

    at: Callable
    sides: tuple[float, float, float, float]
    factor: float = 1.0
    pattern: Callable | None = None
    period: float = np.inf

    def nodes(self, cells, n):
        """Places, area vectors (C, n², 3) and factors (C, n²) of n × n Gauss–Legendre nodes in cells (C, 4)."""
        x, w = np.polynomial.legendre.leggauss(n)
        x, w = 0.5 * x + 0.5, 0.5 * w
        u0, u1, v0, v1 = (c[:, None, None] for c in cells.T)
        u, v = np.broadcast_arrays(u0 + (u1 - u0) * x[:, None], v0 + (v1 - v0) * x[None, :])
        places, shining = self.at(u, v)
        shining = shining * (np.outer(w, w) * (u1 - u0) * (v1 - v0))[..., None]
        factor = self.factor * np.ones_like(u) if self.pattern is None else self.factor * self.pattern(u, v)
        return places.reshape(len(cells), -1, 3), shining.reshape(len(cells), -1, 3), factor.reshape(len(cells), -1)

    def grid(self, n):
        u, v = np.linspace(*self.sides[:2], n + 1), np.linspace(*self.sides[2:], n + 1)
        a, b = np.meshgrid(np.arange(n), np.arange(n))
        return np.stack([u[a], u[a + 1], v[b], v[b + 1]], axis=-1).reshape(-1, 4)


def vector(x, y, z):
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def rectangle(width, height, x=0.0, y=0.0, **more):
    """A plane that shines down."""

    def at(u, v):
        return vector(u, v, 0.0), vector(0.0 * u, 0.0, -1.0)

    return Patch(at, (x - width / 2, x + width / 2, y - height / 2, y + height / 2), **more)


def annulus(inner, outer, lean=0.0, turn=(0.0, 2 * np.pi), **more):
    """A ring about z between two radii that shines down, and inwards by its lean [rad]; half its height above z = 0."""
    rise = np.tan(lean)

    def at(phi, rho):
        place = vector(rho * np.cos(phi), rho * np.sin(phi), (0.5 * (inner + outer) - rho) * rise)
        return place, rho[..., None] * vector(-rise * np.cos(phi), -rise * np.sin(phi), -1.0)

    return Patch(at, (*turn, inner, outer), **more)


def tube(radius, height, turn=(0.0, 2 * np.pi), **more):
    """A cylinder about z that shines inwards."""

    def at(phi, z):
        x, y = np.cos(phi), np.sin(phi)
        return vector(radius * x, radius * y, z), -radius * vector(x, y, 0.0)

    return Patch(at, (*turn, -height / 2, height / 2), **more)


def vault(radius, length, turn, **more):
    """A piece of a cylinder about x that shines inwards; its angle is from y to z."""

    def at(phi, x):
        y, z = np.cos(phi), np.sin(phi)
        return vector(x, radius * y, radius * z), -radius * vector(0.0, y, z)

    return Patch(at, (*turn, -length / 2, length / 2), **more)


def cap(radius, low, high, turn=(0.0, 2 * np.pi), **more):
    """A zone of a sphere about the centre between two elevations [rad] that shines inwards."""

    def at(phi, e):
        out = vector(np.cos(e) * np.cos(phi), np.cos(e) * np.sin(phi), np.sin(e))
        return radius * out, -(radius**2) * np.cos(e)[..., None] * out

    return Patch(at, (*turn, low, high), **more)


@dataclass(frozen=True)
class Emitter:
    """patches in the emitter's frame; rotation (its axes in columns) and centre in the world; radiance of factor 1"""

    patches: list[Patch]
    rotation: np.ndarray
    centre: np.ndarray
    radiance: float = 1.0

    def world(self, places, shining, factor):
        return places @ self.rotation.T + self.centre, self.radiance * shining @ self.rotation.T, factor

    def flux(self, point, n=64):
        """∫ L cosα / r² dA at a point."""
        total = 0.0
        for patch in self.patches:
            places, shining, factor = self.world(*patch.nodes(patch.grid(n), 2))
            away = point - places
            total += (factor * np.maximum(0, dot(shining, away)) / dot(away, away) ** 1.5).sum()
        return total

    def light(self, point, normal, view, sigma, *, visible=None, diffuse_cells=48, form=lambert):
        """I_d per R_d and I_s per R_s (equations (2), (3) under an area light) at one point.

        visible: of places (..., 3) from the point; all where None
        form: diffuse light per unit of R_d, as `point_terms` takes it
        """
        diffuse = specular = 0.0
        for patch in self.patches:
            diffuse += self._sum(patch, patch.grid(diffuse_cells), point, normal, view, None, visible, form)
            cells = self._cut(patch, point, normal, view, sigma)
            specular += self._sum(patch, cells, point, normal, view, sigma, visible)
        return diffuse, specular

    def _sum(self, patch, cells, point, normal, view, sigma, visible, form=None):
        if not len(cells):
            return 0.0
        places, shining, factor = self.world(*patch.nodes(cells, 2 if sigma is None else 4))
        away = point - places
        r = np.sqrt(dot(away, away))
        to_light = -away / r[..., None]
        strength = factor * np.maximum(0, dot(shining, away)) / r**3
        cosine = dot(to_light, normal)
        if visible is not None:
            strength = strength * visible(places)
        if sigma is None:
            return float((strength * form(normal, view, to_light)).sum())
        # |N − H| = 2 sin(δ/2), which is accurate near zero
        away = normal - unit(to_light + view)
        delta = 2 * np.arcsin(np.minimum(1, np.sqrt(dot(away, away)) / 2))
        lobe = np.where(cosine > 0, np.exp(-(delta**2) / (2 * sigma**2)), 0)
        return float((strength * lobe).sum() / max(normal @ view, SMALLEST_COS_VIEW))

    def _cut(self, patch, point, normal, view, sigma):
        # cells no wider than σ [rad] as seen from the point, than a quarter period and, where the horizon N·L = 0
        # crosses them, than a hundredth of σ; without those further than 9σ from N
        done, cells = [], patch.grid(8)
        while len(cells):
            corners = np.stack([patch.at(cells[:, i], cells[:, j])[0] for i in (0, 1) for j in (2, 3)], axis=1)
            middle = patch.at(cells[:, :2].mean(axis=1), cells[:, 2:].mean(axis=1))[0]
            reach = 1.2 * np.sqrt(dot(corners - middle[:, None], corners - middle[:, None])).max(axis=1)
            towards = middle @ self.rotation.T + self.centre - point
            r = np.sqrt(dot(towards, towards))
            to_light = towards / r[:, None]
            wide = np.where(r > 1.2 * reach, np.arcsin(np.minimum(1, reach / r)), np.pi)
            half = unit(to_light + view)
            between = np.clip(0.5 * np.sqrt(dot(to_light + view, to_light + view)), 0.05, 1)
            delta = 2 * np.arcsin(np.minimum(1, 0.5 * np.sqrt(dot(normal - half, normal - half))))
            above = dot(to_light, normal)
            kept = (delta - wide / between < 9 * sigma) & (above > -wide)
            side = np.maximum(cells[:, 1] - cells[:, 0], cells[:, 3] - cells[:, 2])
            small = (wide < 0.5 * sigma) & (wide < 0.1) & (side < 0.25 * patch.period)
            small &= (np.abs(above) > wide) | (wide < 0.01 * sigma)
            done.append(cells[kept & small])
            u0, u1, v0, v1 = cells[kept & ~small].T
            u, v = (u0 + u1) / 2, (v0 + v1) / 2
            quarters = ([u0, u, v0, v], [u, u1, v0, v], [u0, u, v, v1], [u, u1, v, v1])
            cells = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        return np.concatenate(done)


def emitter(kind, *, elevation=90.0, azimuth=270.0, distance=0.0, gain=1.0, channel=0, segments=1, leak=0.0, **size):
    """A light of a kind, or a channel of it, whose whole surface gives light of `gain` to what faces it at the origin.

    Lengths in mm, angles in degrees; keys as the kinds have them.
    """
    e, a = np.radians([elevation, azimuth])
    outward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    across = np.array([-np.sin(a), np.cos(a), 0.0])
    rotation = np.stack([across, np.cross(outward, across), outward], axis=1)
    centre = distance * outward
    step = 2 * np.pi / segments
    turn = (channel * step, (channel + 1) * step)
    width, height = size.get("size", (0.0, 0.0))
    hole = size.get("hole", 0.0)
    waves = {"pattern": size.get("pattern"), "period": size.get("period", np.inf)}
    if kind in ("bar", "flat_dome", "coaxial", "display", "backlight"):
        whole = [rectangle(width, height)]
        own = [rectangle(width, height, **waves)]
        if "bars" in size:  # each a rectangle of its own, in the middle of a period where x is a multiple of it
            period, duty = size["bars"]
            middles = period * np.arange(-(width // period) - 1, width // period + 2)
            ends = [np.clip((x - duty * period / 2, x + duty * period / 2), -width / 2, width / 2) for x in middles]
            own = [rectangle(b - a, height, x=(a + b) / 2) for a, b in ends if b > a]
        if kind == "flat_dome" and hole:
            own = whole = [*whole, annulus(0.0, hole / 2, factor=-1.0)]
        if kind == "coaxial":
            gain = gain * size.get("transmission", 0.5) * size.get("reflection", 0.5)
    elif kind == "ring":
        lean = np.radians(size.get("tilt", 0.0))
        whole, own = ([annulus(size["inner"], size["outer"], lean, t)] for t in ((0.0, 2 * np.pi), turn))
    elif kind == "spot":
        own = whole = [annulus(0.0, distance * np.tan(np.radians(size["half_angle"])))]
    elif kind == "low_angle_ring":
        whole, own = ([tube(size["radius"], size["height"], t)] for t in ((0.0, 2 * np.pi), turn))
    elif kind == "tunnel":
        radius, cut = size["radius"], np.arcsin(size.get("slot", 0.0) / 2 / size["radius"])
        ends = ((0.0, np.pi / 2 - cut), (np.pi / 2 + cut, np.pi))
        own = whole = [vault(radius, size["length"], t) for t in ends]
    elif kind == "dome":
        low, high = np.radians(size.get("lower", 0.0)), np.arccos(hole / 2 / size["radius"])
        whole = [cap(size["radius"], low, high)]
        own = [cap(size["radius"], low, high, turn, factor=1.0 - leak, **waves)] if leak < 1 else []
        own += [cap(size["radius"], low, high, factor=leak / segments)] if leak else []
    elif kind == "led_array":
        (rows, columns), led = size["grid"], size["led"]
        at = [
            (width * ((i + 0.5) / columns - 0.5), height * ((j + 0.5) / rows - 0.5))
            for j in range(rows)
            for i in range(columns)
        ]
        whole = [rectangle(led, led, x, y) for x, y in at]
        own = [whole[channel]]
    else:
        raise ValueError(kind)
    radiance = gain / Emitter(whole, rotation, centre).flux(np.zeros(3))
    return Emitter(own, rotation, centre, radiance)
