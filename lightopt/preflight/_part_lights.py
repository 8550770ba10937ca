"""The lights and the part in each other's way."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from lightopt.preflight._report import Finding, percent
from lightopt.preflight._subject import SceneSubject
from lightopt.rendering import panels_in_part
from lightopt.scene import segments_blocked


def check_hidden_part(subject: SceneSubject) -> Iterator[Finding]:
    """How much of the part's image a panel hides, standing between camera and part."""
    for (index, look), (at, light) in itertools.product(
        enumerate(subject.looks), enumerate(subject.scene.lights)
    ):
        hidden = segments_blocked(look.view.lights[at], look.view.camera.position, look.hits.points)
        count = int(np.count_nonzero(hidden))
        if not count:
            continue
        pixels, share = count * look.step**2, count / len(hidden)
        yield Finding(
            "warning",
            "light in view",
            f"posture {look.posture}: {light.name} stands between camera and part and hides about {pixels:,} px "
            f"({percent(share)}) of it. Renderings leave it out, a camera cannot",
            subject.rig.source.at("lights", at),
            {
                "light": light.name,
                "posture": subject.scene.postures[index].as_dict(),
                "pixels": pixels,
                "share": share,
            },
        )


def check_lights_in_part(subject: SceneSubject) -> Iterator[Finding]:
    """Panels that are inside the part, wholly or in places."""
    index = {light.name: i for i, light in enumerate(subject.rig.lights)}
    for found in panels_in_part(subject.scene):
        yield Finding(
            "error",
            "light in part",
            found.text,
            subject.rig.source.at("lights", index[found.light]),
            {"light": found.light, "posture": found.posture.as_dict(), "share": found.share},
        )
