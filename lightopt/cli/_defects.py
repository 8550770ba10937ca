from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import Force, PartFile, Quiet, RigFile, Threads, Verbose, make_folder
from lightopt.cli._terminal import echo
from lightopt.core.errors import counted
from lightopt.core.run_context import RunContext


def defects(
    rig: RigFile,
    part: PartFile,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Part file to write; its folder is made if missing.")
    ],
    seed: Annotated[int, typer.Option(metavar="N", help="Random seed; the same seed gives the same defects.")],
    count: Annotated[int, typer.Option(metavar="K", help="Number of defects, 1 to 500.")],
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
    _verbose: Verbose = False,
) -> None:
    """Place random defects on the surface of PART that the camera of RIG sees in at least one posture, for testing.

    Takes the entries of the part's defect_catalogue, or of the built-in one (docs/how-to/defects.md), in turn. The
    places are uniform by area, off silhouettes and creases, and apart from each other. Writes PART with a list of
    defects at its end, its comments kept; render shows them.

    Example: lightopt defects rig.yaml part.yaml --seed 1 --count 14 -o part.defects.yaml
    """
    from lightopt.inspection import (
        place_random_defects,
        random_defect_provenance,
        random_defects_text,
        write_random_defects,
    )

    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    comment = f"{counted(count, 'defect')}, scattered by: lightopt defects --seed {seed} --count {count}"
    run = RunContext(threads=threads)
    placed = place_random_defects(loaded_rig, loaded_part, count=count, seed=seed, run=run)
    made_from = random_defect_provenance(loaded_rig, loaded_part, count=count, seed=seed)
    text = random_defects_text(loaded_part, placed, folder=out.parent, comment=comment, made_from=made_from)
    make_folder(out.parent)
    write_random_defects(out, text, force=force)
    if not quiet:
        kinds = Counter(defect.entry.name for defect in placed)
        echo(f"{counted(len(placed), 'defect')}: {', '.join(f'{n} × {name}' for name, n in kinds.items())}")
        echo(f"{out}")
