"""What several commands share: options, how their texts are read and their help is written, input files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar, copy_context
from fractions import Fraction
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import typer.core
from typer import Argument

from lightopt.cli._terminal import QUIET, VERBOSE, echo, set_up_log
from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.batch import Workers
    from lightopt.config import PartConfig, RigConfig
    from lightopt.core.transforms import Posture
    from lightopt.images import ImageSet


selection_option = partial(typer.Option, rich_help_panel="Selection")
model_option = partial(typer.Option, rich_help_panel="Model")
output_option = partial(typer.Option, rich_help_panel="Output")
hardware_option = partial(typer.Option, rich_help_panel="Hardware")
workers_option = partial(typer.Option, rich_help_panel="Workers")
run_option = partial(typer.Option, rich_help_panel="Run")  # headings of options in `--help`

PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None}  # of each typer.Typer

RigFile = Annotated[Path, Argument(metavar="RIG", help="Rig file (YAML): camera, lights, stage.")]
PartFile = Annotated[Path, Argument(metavar="PART", help="Part file (YAML): mesh, postures, reflectance.")]
Images = Annotated[Path, Argument(metavar="IMAGES", help="Image set, rendered or captured: folder or manifest.json.")]
Out = Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Output folder; created if missing.")]
Force = Annotated[bool, output_option("--force", help="Overwrite existing results.")]
Report = Annotated[bool, output_option("--report/--no-report", help="Write report.html.")]
JsonFile = Annotated[Path | None, output_option("--json", metavar="FILE", help="Write all results to this JSON file.")]
_SHEET_HELP = "Write a labelled contact sheet per exposure, contact-sheet*.png."
Sheet = Annotated[bool, output_option("--sheet", help=_SHEET_HELP)]
_LIGHT = selection_option("--light", metavar="NAME", help="Use only this light; repeatable.", show_default="all lights")
Lights = Annotated[list[str] | None, _LIGHT]
_POSTURE_HELP = "Use this posture: tilt and rotation [deg]; repeatable."
_POSTURE = selection_option("--posture", metavar="θ,φ", help=_POSTURE_HELP, show_default="the postures of PART")
Postures = Annotated[list[str] | None, _POSTURE]
_EXPOSURES_HELP = "Relative exposure times, such as 1,1/16."
Exposures = Annotated[str, selection_option("--exposure", metavar="X,…", help=_EXPOSURES_HELP)]
AS_RIG, AS_PART = "as the rig file says", "as the part file says"
POINTS_HELP = "Point lights per panel: 1, 4, 9, 16, … or auto (continuous panel)."
Points = Annotated[str | None, model_option(metavar="M", help=POINTS_HELP, show_default=AS_RIG)]
Shadows = Annotated[bool, model_option("--shadows/--no-shadows", help="Let the part cast shadows.")]
_BOUNCES = model_option(metavar="N", min=0, help="Add light that goes up to N times from the part to the part.")
Bounces = Annotated[int, _BOUNCES]
_PATCHES = model_option(metavar="N", min=1, help="Target number of visible surface patches.", show_default="200000")
Patches = Annotated[int | None, _PATCHES]
_DERIVED_HELP = "Also write the images derived from series: phases, differences of segments, merged exposures …"
Derived = Annotated[bool, output_option("--derived", help=_DERIVED_HELP)]
_REGISTER_HELP = "Find the part's placement on the stage; otherwise assume nominal placement."
Register = Annotated[bool, model_option("--register/--no-register", help=_REGISTER_HELP)]
_MIN_IMAGES_HELP = "Number of images of a posture that must show a defect."
MinImages = Annotated[int, model_option(metavar="K", min=1, help=_MIN_IMAGES_HELP)]
_THREADS_HELP = "Number of threads; results do not depend on it."
Threads = Annotated[int | None, run_option(metavar="N", min=1, help=_THREADS_HELP, show_default="all processors")]
WORKERS_HELP = "Number of processes, or of jobs of the batch system; 1: this process, without Dask."
_SCHEDULER_HELP = "Use the workers of this Dask scheduler, such as tcp://10.0.0.5:8786."
Scheduler = Annotated[str | None, workers_option(metavar="ADDRESS", help=_SCHEDULER_HELP)]
Slurm = Annotated[bool, workers_option("--slurm", help="Start workers as Slurm jobs (dask-jobqueue).")]
_KUBERNETES_HELP = "Start workers on Kubernetes (dask-kubernetes)."
Kubernetes = Annotated[bool, workers_option("--kubernetes", help=_KUBERNETES_HELP)]
_QUIET = run_option("--quiet", "-q", help="Print errors and warnings only.")
_VERBOSE = run_option("--verbose", "-v", callback=set_up_log, help="Print all details and the log.")
_SERIAL_LOG_HELP = "Append all bytes sent and received, with times, to this file."
SerialLog = Annotated[Path | None, output_option(metavar="FILE", help=_SERIAL_LOG_HELP)]


def with_output_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command with the options --quiet and --verbose, which lightopt.cli._terminal obeys."""

    def run_told(quiet: bool, verbose: bool, values: Mapping[str, Any]) -> None:
        QUIET.set(quiet)
        VERBOSE.set(verbose)
        command(**values)

    @wraps(command)
    def run(*, quiet: bool, verbose: bool, **values: Any) -> None:
        copy_context().run(run_told, quiet, verbose, values)

    own = signature(command, eval_str=True)
    more = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, option])
        for name, option in (("quiet", _QUIET), ("verbose", _VERBOSE))
    ]
    parameters = [*own.parameters.values(), *more]
    run.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


LEAST_EXPOSURE, MOST_EXPOSURE = 1e-9, 1e9  # relative to exposure 1; it is a part of file names


def parse_postures(texts: Sequence[str] | None) -> tuple[Posture, ...] | None:
    """Read each ``θ,φ`` in degrees; None where there is none."""
    return tuple(_parse_posture(text) for text in texts) if texts else None


def _parse_posture(text: str) -> Posture:
    from lightopt.core.transforms import Posture

    try:
        elevation, rotation = map(float, text.split(","))
    except ValueError:
        elevation = rotation = math.nan
    if not (math.isfinite(elevation) and math.isfinite(rotation)):
        raise InputError(f'--posture: expected tilt,rotation in degrees, such as 0,82, found "{text}"')
    return Posture(elevation, rotation)


def parse_exposures(text: str) -> tuple[float, ...]:
    return tuple(map(parse_exposure, text.split(",")))


def parse_exposure(text: str) -> float:
    value = _number(text)
    if not LEAST_EXPOSURE <= value <= MOST_EXPOSURE:
        limits = f"{LEAST_EXPOSURE:g} to {MOST_EXPOSURE:g}"
        raise InputError(f'--exposure: expected a number from {limits} or a fraction such as 1/16, found "{text}"')
    return value


def parse_share(text: str, *, option: str, expected: str, limits: tuple[float, float] = (-math.inf, math.inf)) -> float:
    """Read a number, a fraction such as 10/255, or per cent such as 95%; `expected` says of what, with an example."""
    number, percents, rest = text.partition("%")
    value = _number(number) / (100.0 if percents else 1.0)
    if rest or not math.isfinite(value) or not limits[0] <= value <= limits[1]:
        raise InputError(f'{option}: expected a share {expected}, found "{text}"')
    return value


def _number(text: str) -> float:
    # of a number or a fraction; nan where it is neither
    try:
        return float(Fraction(text))
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def parse_points(text: str | None) -> int | Literal["auto"] | None:
    if text is None or text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise InputError(f'--points: expected a square (1, 4, 9, 16, …) or auto, found "{text}"') from None


ONLY_OPTIONS = ContextVar("ONLY_OPTIONS", default=False)  # whether a command only checks its options, for a batch


class OptionsRead(Exception):  # noqa: N818 - no error
    """A command on a rig and a part has read its options, and found nothing wrong; it was to do no more."""


def options_are_read() -> None:
    """End a command here that was to check its options only; each command calls it before it reads rig and part."""
    if ONLY_OPTIONS.get():
        raise OptionsRead


def chosen_workers(
    number: int | None, scheduler: str | None, slurm: bool, kubernetes: bool, *, here: int, system: int
) -> Workers:
    """Where work runs; without --workers so many processes of this machine, or so many jobs of a batch system."""
    from lightopt.batch import Workers

    given = [name for name, value in (("--slurm", slurm), ("--kubernetes", kubernetes)) if value]
    if scheduler is not None:
        given.append("--scheduler")
        if number is not None:
            raise InputError("--workers: has no effect with --scheduler, whose workers are taken as they are")
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)}: expected one of them")
    return Workers(
        number=number or (system if slurm or kubernetes else here),
        scheduler=scheduler,
        system="slurm" if slurm else "kubernetes" if kubernetes else None,
    )


def load_inputs(rig: Path, part: Path) -> tuple[RigConfig, PartConfig]:
    """Read a rig file and a part file, and report all errors of both at once."""
    options_are_read()
    from lightopt.config import load_part, load_rig

    try:
        loaded = load_rig(rig)
    except InputError as error:
        try:
            load_part(part)
        except InputError as more:
            raise InputError(*error.messages, *more.messages) from None
        raise
    return loaded, load_part(part)


def load_rig_and_maybe_part(rig: Path, part: Path | None) -> tuple[RigConfig, PartConfig | None]:
    """The same where a part file may be left out."""
    options_are_read()
    from lightopt.config import load_rig

    return (load_rig(rig), None) if part is None else load_inputs(rig, part)


def add_sheets(folder: Path, rig: RigConfig, *, exposures: tuple[float, ...], title: str, force: bool) -> None:
    """Add a contact sheet per exposure to an image set, and print where they are."""
    from lightopt.report import add_contact_sheets

    shown = dict.fromkeys(one for light in rig.lights for one in rig.exposures(light.name, exposures))
    exposures = tuple(shown)
    sheets = add_contact_sheets(folder, exposures=exposures, title=title, overwrite=force)
    for exposure, path in zip(exposures, sheets, strict=True):
        echo(f"contact sheet, exposure {exposure:g}: {path}")


def add_derived(rig: RigConfig, part: PartConfig, images: Path | ImageSet, folder: Path, *, force: bool) -> None:
    """Write the derived images of a set below a folder, and print what they are."""
    from lightopt.images import read_image_set
    from lightopt.series import DERIVED_FOLDER, write_derived

    image_set = read_image_set(images) if isinstance(images, Path) else images
    for line in write_derived(rig, part, image_set, folder / DERIVED_FOLDER, force=force):
        echo(line)


class HeadedCommand(typer.core.TyperCommand):
    """A command whose ``--help`` has a section for each heading of its options, in plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections: arguments, options without a heading, and the headings as they first occur."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                sections.setdefault(heading(parameter), []).append(_plain(parameter, *record))
        for name, records in sections.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line: ``RIG`` is required, ``[PART]`` is optional."""
        return [re.sub(r"^\{(.*)\}", r"\1", piece) for piece in super().collect_usage_pieces(ctx)]


def _plain(parameter: Any, name: str, text: str) -> tuple[str, str]:
    # without typer's Python types, its brackets around a default in words, and its x for a number
    if parameter.param_type_name == "argument":
        name = name.partition(" <")[0]
    text = re.sub(r"\[default: \((.*?)\)(; .*)?\]$", r"[default: \1\2]", text)
    return name, re.sub(r"\bx>=(\S+?)(?:\.0)?\]$", r"at least \1]", text)


def heading(parameter: Any) -> str:
    other = "Arguments" if parameter.param_type_name == "argument" else "Options"
    return getattr(parameter, "rich_help_panel", None) or other
