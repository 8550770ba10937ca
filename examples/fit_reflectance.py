"""Fit reflectance to images: here rendered with noise, in practice photographs with a manifest."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.estimate.reflectance import FitOptions, fit_specular
from lightopt.images import read_image_set
from lightopt.rendering import RenderOptions, render_image_set

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    # two exposures: the long one for the diffuse light, the short one for the highlights
    render_image_set(rig, part, out / "images", options=RenderOptions(noise=1, exposures=(1.0, 1 / 16)))
    result = fit_specular(rig, part, read_image_set(out / "images"), options=FitOptions(joint=True, validate=False))
    for value in result.values:
        print(f"{value.name} = {value.value:.5g} ± {value.standard_error:.2g}, 95 % interval {value.interval}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-fit"))
