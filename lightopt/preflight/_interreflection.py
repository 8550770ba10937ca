"""How much of the surface in view mirrors the part itself."""

from collections.abc import Iterator

import numpy as np

from lightopt.preflight._fields import POINTS
from lightopt.preflight._findings import CheckedScene, Finding, percent

NOTED_SHARE, WARNED_SHARE = 0.01, 0.05  # of the surface in view


def check_mirrored_part(checked: CheckedScene) -> Iterator[Finding]:
    """Share of the surface in view that mirrors the part, in place of the lights and the dark box; none if it is 0."""
    if all(one.R_s == 0.0 for one in checked.scene.shown):
        return
    for index, sample in enumerate(checked.samples):
        front = np.flatnonzero(sample.surface.front)
        if not len(front):
            continue
        some = sample.surface.take(front[:: max(1, len(front) // POINTS)])
        mirrored = 2.0 * np.einsum("ik,ik->i", some.normals, some.views)[:, None] * some.normals - some.views
        meets = checked.caster.next_hit(some.points, some.facets, mirrored) >= 0
        share = float(np.mean(checked.glossy(some) & meets & (np.einsum("ik,ik->i", mirrored, some.facets) > 0.0)))
        if share == 0.0:
            continue
        text = f"posture {sample.posture}: {percent(share)} of the surface in view mirrors the part itself"
        if share > NOTED_SHARE:
            text += (
                ". Images without its light are too dark there: use render --bounces 1, virtual_bench.bounces and "
                "inspection.bounces. Fits and plans leave this light out"
            )
        level = "warning" if share > WARNED_SHARE else "note" if share > NOTED_SHARE else "ok"
        values = {"posture": sample.posture.as_dict(), "share": share}
        yield Finding(level, "mirrored part", text, checked.at_posture(index), values)
