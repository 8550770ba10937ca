"""A slow, plain NumPy float64 renderer, written from the equations alone, that the fast one must match.

It takes numbers and arrays, knows nothing of lightopt, and keeps every choice in sight: lengths in mm, angles
in degrees, triangles as (F, 3, 3) corners in the world frame with (F, 3, 3) unit normals at those corners.
"""

from __future__ import annotations

from ._casting import Hits, blocked, closest, crossed_between, trace
from ._emitters import Emitter, emitter
from ._frames import Camera, Light, posed, posed_normals
from ._lobes import diffuse, fresnel, specular
from ._matched_filter import matched_filter, summed_blocks
from ._panel import equally_spaced, hidden_share, panel_radiance, product_rule, subtract_convex
from ._shading import LayerImage, in_shadow, lambert, point_terms, render

__all__ = [
    "Camera",
    "Emitter",
    "Hits",
    "LayerImage",
    "Light",
    "blocked",
    "closest",
    "crossed_between",
    "diffuse",
    "emitter",
    "equally_spaced",
    "fresnel",
    "hidden_share",
    "in_shadow",
    "lambert",
    "matched_filter",
    "panel_radiance",
    "point_terms",
    "posed",
    "posed_normals",
    "product_rule",
    "render",
    "specular",
    "subtract_convex",
    "summed_blocks",
    "trace",
]
