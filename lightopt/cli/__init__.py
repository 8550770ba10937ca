"""The command line: parses, calls one function of the library, says where the result is.

The one place that turns errors into messages and exit statuses. Importing it must stay cheap: commands import what
they need when they run.
"""


def main() -> None:
    """Run the command line and leave with its exit status."""
    import os
    import sys

    # before NumPy is loaded: the matrices are small, so that threads of BLAS cost more than they gain, beside those of
    # lightopt; and sums would depend on how many there are
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from lightopt.cli._process import run_process

    sys.exit(run_process(_run))


def _run(arguments: list[str]) -> int:
    # imported here: an installation that lacks something leaves with the status of a defect, too
    from lightopt.cli._main import run, take_ctrl_c

    take_ctrl_c()
    return run(arguments)
