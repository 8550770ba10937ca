"""The panels of the drawing of conventions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lightopt.report._canvas import Canvas
from lightopt.report._frames_devices import draw_camera, draw_pixels, draw_posture
from lightopt.report._frames_directions import draw_direction, draw_light, draw_zenith
from lightopt.report._frames_pen import E_PHI, E_THETA, PHI_J, THETA_J
from lightopt.report._labels import Box, Label


@dataclass(frozen=True)
class FramePanel:
    """One convention: a title, a picture drawn into a box, which gives its labels, and a few lines of text."""

    title: str
    draw: Callable[[Canvas, Box], list[Label]]
    text: tuple[str, ...]


def frame_panels() -> tuple[FramePanel, ...]:
    """The conventions, in the order of reading."""
    return (
        FramePanel(
            "Direction (elevation θ, azimuth φ)",
            draw_direction,
            (
                "d = (cosθ·cosφ, cosθ·sinφ, sinθ);  table plane Z = 0",
                f"{E_THETA} and {E_PHI}: where d goes as θ, φ grow;  {E_PHI} × {E_THETA} = d",
            ),
        ),
        FramePanel(
            "Elevation passes 90°",
            draw_zenith,
            (
                "θ is measured from the table plane: 90° is straight above, and",
                f"105° leans 15° beyond the zenith, where {E_THETA} carries on smoothly.",
            ),
        ),
        FramePanel(
            "Light",
            draw_light,
            (
                "centred at distance·d, facing the origin; it shines along −d",
                f"size_mm: [along {E_PHI}, along {E_THETA}];  points: k × k cell centres",
            ),
        ),
        FramePanel(
            "Camera with roll ρ",
            draw_camera,
            (
                f"image right = cosρ·{E_PHI} + sinρ·{E_THETA};  at distance·d,",
                f"image up = −sinρ·{E_PHI} + cosρ·{E_THETA};  looking along −d",
            ),
        ),
        FramePanel(
            "Pixels",
            draw_pixels,
            (
                "Pixel (column, row) = (0, 0) is the top left one; centres at +0.5.",
                "Elevation 90°, azimuth 270°, roll 0: X to the right, Y up.",
            ),
        ),
        FramePanel(
            f"Posture ({THETA_J}, {PHI_J})",
            draw_posture,
            (
                f"p' = pivot + Rx({THETA_J})·Rz({PHI_J})·(p − pivot): the part turns on the",
                "rotary axis, and the cradle tilts axis and part about X.",
            ),
        ),
    )
