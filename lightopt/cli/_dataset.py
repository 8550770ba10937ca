from pathlib import Path

from typer import Option

from lightopt.cli import _common as common
from lightopt.cli._common import model_option, output_option
from lightopt.cli._terminal import echo, echo_paths, run_context
from lightopt.core.errors import counted


def dataset(
    rig: common.RigFile,
    part: common.PartFile,
    out: common.Out,
    images: int = Option(..., metavar="N", min=1, help="Number of samples, each of one image per light."),
    seed: int = Option(0, metavar="N", min=0, help="Random seed; the same seed gives the same bytes."),
    ranges: Path | None = model_option(
        None, metavar="FILE", help="What is randomised, and within which limits (YAML).", show_default="see the how-to"
    ),
    exposure: str = model_option("1", metavar="X", help="Relative exposure time, such as 1/4."),
    false_alarms: float = model_option(
        0.05, metavar="N", help="False alarms per posture at which a defect counts as visible."
    ),
    fusion: str = output_option(
        "paper", metavar="RULE", help="Rule of the fused image: paper, median, minimum, second-largest or none."
    ),
    stacks: bool = output_option(False, "--stacks", help="Also write the images of each pose as HDF5 (needs h5py)."),
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Render a labelled training set for defect detectors: good and defective pieces of PART under the lights of RIG.

    Randomises placement, reflectance, gains, waviness, dust, noise and the defects of PART's defect_catalogue. Writes a
    folder per light, and one for the fused image, with MVTec-AD folders (images/), COCO (coco-*.json) and YOLO
    (data.yaml) annotations; normals and the nominal images of each pose; samples.csv with the split; and datasheet.md,
    which says what was randomised. Defects that no detector could find in the noise are marked. The same command
    continues an interrupted run.

    Example: lightopt dataset rig.yaml part.yaml -o set --images 500 --seed 1
    """
    from lightopt.config import load_ranges
    from lightopt.dataset import DatasetOptions, make_dataset

    options = DatasetOptions(
        images=images,
        seed=seed,
        exposure=common.parse_exposure(exposure),
        fusion=None if fusion == "none" else fusion,  # type: ignore[arg-type]  # checked by the library
        stacks=stacks,
        false_alarms=false_alarms,
    )
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    chosen = None if ranges is None else load_ranges(ranges)
    with run_context(threads) as run:
        done = make_dataset(loaded_rig, loaded_part, out, options=options, ranges=chosen, force=force, run=run)
    resumed = f" ({done.resumed} of them existed already)" if done.resumed else ""
    echo(f"{counted(done.samples, 'sample')}, {counted(done.images, 'image')}, {counted(done.poses, 'pose')}{resumed}")
    echo(f"{counted(done.defects, 'defect')}, {done.visible} of them visible in the images of their sample")
    echo_paths(*done.files)
