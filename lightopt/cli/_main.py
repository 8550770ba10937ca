import importlib
import io
import keyword
import os
import re
import signal
import sys
import traceback
from collections import UserDict
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import typer
import typer.core

from lightopt.cli._process import DEBUG, DEFECT, INTERRUPTED, debugging, report_unexpected, system_refused
from lightopt.cli._terminal import echo_error, version_wanted
from lightopt.core.errors import LightoptError, did_you_mean, error_text
from lightopt.core.interrupts import interrupt

WRONG_INPUT = 2

# what typer raises for a wrong command line; it does not export the class itself
_UsageError: type[Exception] = typer.BadParameter.__mro__[2]  # pyright: ignore[reportAssignmentType]

# each command: the module that it is in, which is imported when the command is called or its help is shown
_COMMANDS = {
    "init": ("_files", "Write a sample rig, part and mesh to start from."),
    "check": ("_files", "Validate rig and part files and summarise the set-up."),
    "render": ("_images", "Render the images that the camera would take."),
    "import": ("_images", "Make rig, part and image set from photographs."),
    "capture": ("_rig", "Capture images on the rig or the virtual bench."),
    "defects": ("_files", "Place random defects on a part for testing."),
    "dataset": ("_images", "Render a labelled training set for defect detectors."),
    "calibrate": ("_rig", "Measure a rig from images of targets on its stage."),
    "fit-diffuse": ("_fit", "Fit the diffuse coefficient to images."),
    "fit-specular": ("_fit", "Fit specular coefficient and roughness to images."),
    "optimize": ("_optimize", "Find the best light positions by exact search."),
    "optimize --from-images": ("_lighting", "Choose lights from images of samples, without a CAD model."),
    "compare-lighting": ("_lighting", "Compare lighting systems by the defects that they show on a part."),
    "inspect": ("_inspect", "Find defects in images and locate them on the part."),
    "verify": ("_rig", "Name what has changed on the rig since its file, or a known good set, was made."),
    "inverse-pattern": ("_images", "Compute the display's picture that a good part mirrors as regular."),
    "batch": ("_batch", "Run commands for many rigs and parts, on this machine or a cluster."),
    "overlap": ("_files", "Report where saturated regions of images overlap."),
    "compare": ("_files", "Compare new images or image sets with golden ones."),
    "schema": ("_files", "Print the JSON schema of a kind of file."),
    "bench": ("_bench", "Test the devices of a rig one by one."),
}


_FOR_A_START = ("init", "schema")  # what they print is what they are called for


class _Commands(typer.core.TyperGroup):
    """The commands, made when they are called and not where they are only listed."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _MadeOnDemand()

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the arguments begin with; ``optimize`` with ``--from-images`` has other arguments."""
        if args[0] == "optimize" and "--from-images" in args:
            args = ["optimize --from-images", *(text for text in args[1:] if text != "--from-images")]
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])


class _MadeOnDemand(UserDict[str, Any]):
    def __missing__(self, name: str) -> Any:
        from lightopt.cli._common import PLAIN, HeadedCommand, with_output_options

        module, text = _COMMANDS[name]
        function = f"{name}_" if keyword.iskeyword(name) else re.sub(r"\W+", "_", name)
        found = getattr(importlib.import_module(f"lightopt.cli.{module}"), function)
        if not isinstance(found, typer.Typer):
            alone = typer.Typer(**PLAIN)
            shown = found if name in _FOR_A_START else with_output_options(found)
            alone.command(name, short_help=text, cls=HeadedCommand)(shown)
            found = alone
        self[name] = typer.main.get_command(found)
        return self[name]

    def __contains__(self, name: object) -> bool:
        return name in _COMMANDS

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


app = typer.Typer(
    name="lightopt",
    cls=_Commands,
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
    version: bool = typer.Option(False, "--version", callback=version_wanted, is_eager=True, help="Show the version."),
    debug: bool = typer.Option(  # taken from the arguments before they are parsed
        False, "--debug", help="Show the traceback of an unexpected error; also LIGHTOPT_DEBUG=1."
    ),
) -> None:
    pass


def take_ctrl_c() -> None:
    """Let Ctrl-C interrupt the main thread, unless a shell that runs a command in the background lets it be ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)


@cache
def parser() -> Callable[..., object]:
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
            status = parser()(rest, prog_name="lightopt", standalone_mode=False)
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


def refusal(error: BaseException) -> tuple[str, ...] | None:
    """Why a command line, or what it names, is refused; None where the error is another one."""
    if isinstance(error, LightoptError):
        return error.messages
    if isinstance(error, _UsageError):
        text: str = error.format_message()  # pyright: ignore[reportAttributeAccessIssue]
        return (_expectation(text, error.__cause__) or text,)
    if isinstance(error, OSError) and system_refused(error):
        return (error_text(error),)
    return None


def _failed(error: BaseException) -> int:
    messages = refusal(error)
    if messages is None:
        report_unexpected(error)
        return DEFECT
    if isinstance(error, OSError) and debugging():
        traceback.print_exception(error)
    echo_error(*messages)
    if isinstance(error, _UsageError) and (context := getattr(error, "ctx", None)) is not None:
        echo_error(f"see: {context.command_path} --help", label="")
    return error.exit_status if isinstance(error, LightoptError) else WRONG_INPUT


def _expectation(text: str, cause: BaseException | None) -> str | None:
    # what the parser says of a value, as the other commands' messages are; None for what is no value
    option = re.match(r"Invalid value for '([^']+)'", text)
    errors = getattr(cause, "errors", None)  # pydantic's ValidationError
    if option is None or errors is None:
        return None
    problem = errors()[0]
    found, limits = problem["input"], problem.get("ctx", {})
    words: list[str] = re.findall(r"'([^']*)'", problem["msg"])[1:]
    expected = {
        "int_parsing": "a whole number",
        "int_from_float": "a whole number",
        "float_parsing": "a number",
        "greater_than_equal": f"{limits.get('ge')} or more",
        "greater_than": f"more than {limits.get('gt')}",
        "less_than_equal": f"{limits.get('le')} or less",
        "less_than": f"less than {limits.get('lt')}",
        "value_error": " or ".join(filter(None, (", ".join(words[:-1]), *words[-1:]))),
    }.get(problem["type"])
    if not expected:
        return None
    shown = f'"{found}"' if isinstance(found, str) else f"{found}"
    return f"{option[1]}: expected {expected}, found {shown}{did_you_mean(str(found), words)}"


@contextmanager
def _debugging(arguments: list[str]) -> Generator[list[str]]:
    # --debug may stand anywhere, so that it can be added to a command that failed
    end = arguments.index("--") if "--" in arguments else len(arguments)
    rest = [text for text in arguments[:end] if text != "--debug"] + arguments[end:]
    before = os.environ.get(DEBUG)
    if len(rest) < len(arguments):
        os.environ[DEBUG] = "1"
    try:
        yield rest
    finally:
        os.environ.pop(DEBUG, None)
        os.environ.update({} if before is None else {DEBUG: before})
