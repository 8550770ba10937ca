import io
import os
import signal
import sys
import traceback
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache

import typer

from lightopt.cli._bench import bench
from lightopt.cli._capture import capture
from lightopt.cli._common import HeadedCommand
from lightopt.cli._files import check, defects, init, schema
from lightopt.cli._fit import fit_diffuse, fit_specular
from lightopt.cli._image_sets import compare, overlap
from lightopt.cli._inspect import inspect
from lightopt.cli._optimize import optimize
from lightopt.cli._process import DEBUG, DEFECT, INTERRUPTED, debugging, report_unexpected, system_refused
from lightopt.cli._render import render
from lightopt.cli._terminal import echo_error, version_wanted
from lightopt.core.errors import LightoptError, error_text
from lightopt.core.interrupts import interrupt

WRONG_INPUT = 2

# what typer raises for a wrong command line; it does not export the class itself
_UsageError: type[Exception] = typer.BadParameter.__mro__[2]  # pyright: ignore[reportAssignmentType]

app = typer.Typer(
    name="lightopt",
    help="Plan the lights, postures and exposures of an appearance-inspection machine, and inspect parts.",
    epilog="Start with: lightopt init DIR. Exit status: 0 done, 1 a check failed, 2 wrong input, 3 hardware failed, "
    "70 unexpected error (bug), 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


@app.callback()
def _common(
    version: bool = typer.Option(
        False, "--version", callback=version_wanted, is_eager=True, help="Show the version and exit."
    ),
    debug: bool = typer.Option(  # taken from the arguments before they are parsed
        False, "--debug", help="Show the traceback of an unexpected error; also LIGHTOPT_DEBUG=1."
    ),
) -> None:
    pass


app.command(short_help="Write a sample rig, part and mesh to start from.", cls=HeadedCommand)(init)
app.command(short_help="Validate rig and part files and summarise the set-up.", cls=HeadedCommand)(check)
app.command(short_help="Render the images that the camera would take.", cls=HeadedCommand)(render)
app.command(short_help="Capture images on the rig or the virtual bench.", cls=HeadedCommand)(capture)
app.command(short_help="Place random defects on a part for testing.", cls=HeadedCommand)(defects)
app.command("fit-diffuse", short_help="Fit the diffuse coefficient to images.", cls=HeadedCommand)(fit_diffuse)
app.command("fit-specular", short_help="Fit specular coefficient and roughness to images.", cls=HeadedCommand)(
    fit_specular
)
app.command(short_help="Find the best light positions by exact search.", cls=HeadedCommand)(optimize)
app.command(short_help="Find defects in images and locate them on the part.", cls=HeadedCommand)(inspect)
app.command(short_help="Report where saturated regions of images overlap.", cls=HeadedCommand)(overlap)
app.command(short_help="Compare new images or image sets with golden ones.", cls=HeadedCommand)(compare)
app.add_typer(bench, name="bench", short_help="Test the devices of a rig one by one.")
app.command(short_help="Print the JSON schema of a rig or part file.", cls=HeadedCommand)(schema)


def take_ctrl_c() -> None:
    """Let Ctrl-C interrupt the main thread, unless a shell that runs a command in the background lets it be ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)


@cache
def _command() -> Callable[..., object]:
    """The parser of all commands, which takes a while to be made."""
    return typer.main.get_command(app)


def run(arguments: list[str]) -> int:
    """Run a command line and return its exit status; errors are printed to standard error, none is raised."""
    with _debugging(arguments) as rest:
        try:
            # redirected output on Windows is in a code page that knows neither θ nor σ
            for stream in (sys.stdout, sys.stderr):
                if isinstance(stream, io.TextIOWrapper):
                    encoding = stream.encoding if stream.isatty() else "utf-8"
                    stream.reconfigure(encoding=encoding, errors="replace")
            status = _command()(rest, prog_name="lightopt", standalone_mode=False)
        except (KeyboardInterrupt, typer.Abort):
            status = INTERRUPTED
        except typer.Exit as leave:
            return leave.exit_code
        except SystemExit as leave:
            # the parser's answer to a broken pipe, which of our own streams none is: one to a device
            return _failed(leave.__context__ or leave)
        except BaseException as error:  # noqa: BLE001  (the one boundary)
            return _failed(error)
    if status == INTERRUPTED:  # typer's own answer to Ctrl-C
        echo_error("interrupted; files that were finished are complete", label="")
    return status if isinstance(status, int) else 0


def _failed(error: BaseException) -> int:
    """Say what went wrong; the exit status."""
    if isinstance(error, LightoptError):
        echo_error(*error.messages)
        return error.exit_status
    if isinstance(error, _UsageError):
        context = getattr(error, "ctx", None)
        echo_error(error.format_message())  # pyright: ignore[reportAttributeAccessIssue]
        if context is not None:
            echo_error(f"see: {context.command_path} --help", label="")
        return WRONG_INPUT
    if isinstance(error, OSError) and system_refused(error):
        if debugging():
            traceback.print_exception(error)
        echo_error(error_text(error))
        return WRONG_INPUT
    report_unexpected(error)
    return DEFECT


@contextmanager
def _debugging(arguments: list[str]) -> Generator[list[str]]:
    # --debug may stand anywhere, so that it can be added to a command that failed
    end = arguments.index("--") if "--" in arguments else len(arguments)
    rest = [text for text in arguments[:end] if text != "--debug"] + arguments[end:]
    if len(rest) == len(arguments):
        yield rest
        return
    before = os.environ.get(DEBUG)
    os.environ[DEBUG] = "1"
    try:
        yield rest
    finally:
        if before is None:
            del os.environ[DEBUG]
        else:
            os.environ[DEBUG] = before
