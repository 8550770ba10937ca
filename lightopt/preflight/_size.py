"""The part's size, and whether its unit can be right."""

from __future__ import annotations

from collections.abc import Iterator

from lightopt.preflight._report import Finding, percent
from lightopt.preflight._subject import SceneSubject
from lightopt.scene import guess_unit, is_absurd, view_size


def check_size(subject: SceneSubject) -> Iterator[Finding]:
    """Size of the part, and what other units of its file would make of it."""
    low, high = subject.scene.mesh.bounds
    sides = [float(side) for side in high - low]
    where = subject.part.source.at("mesh", "units")
    values = {"size_mm": sides}
    size = view_size(subject.scene.camera)
    text = f"{' × '.join(f'{side:.4g}' for side in sides)} mm"
    if size is None:
        yield Finding("ok", "size", text, where, values)
        return
    longest, view = max(sides), min(size)
    share = longest / view
    absurd = is_absurd(longest, view)
    times = f"{share:.3g} times the length" if absurd and share > 1.0 else percent(share)
    text += f", {times} of the view's shorter side of {view:.4g} mm"
    guess = guess_unit(subject.part, longest, view)
    if guess is not None:
        values = {**values, "unit": guess.unit, "likely_units": list(guess.likely)}
        yield Finding("warning", "size", f"{text}: {guess.text}", where, values)
    elif absurd:
        kind = "small" if longest < view else "large"
        yield Finding("warning", "size", f"{text}: very {kind} for this camera", where, values)
    else:
        yield Finding("ok", "size", text, where, values)
