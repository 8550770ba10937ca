"""How a command is called: its arguments and options, and the words of a job's options."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from lightopt.config import BatchConfig

OptionValue = bool | int | float | str | tuple[int | float | str, ...]


@dataclass(frozen=True, kw_only=True)
class OptionForm:
    """An option of a command."""

    flag: bool = False  # without a value
    has_opposite: bool = False  # --no-NAME is a flag, too
    repeatable: bool = False
    file: bool = False  # its value names a file or folder that is read


@dataclass(frozen=True, kw_only=True)
class CommandForm:
    """What a command takes: arguments (rig, part, images, rigs: all rigs at once), and options by long name."""

    name: str
    arguments: tuple[str, ...]
    options: Mapping[str, OptionForm]
    writes_folder: bool = True  # takes -o DIR
    takes_threads: bool = True


def option_words(batch: BatchConfig, index: int, form: CommandForm) -> tuple[list[str], list[Path]]:
    """The options of a job as words of its command line, and the files that they name, relative to the batch file.

    Check :func:`option_problems` first.
    """
    words, files = list[str](), list[Path]()
    for name, value in batch.jobs[index].options.items():
        option = form.options[name]
        if isinstance(value, bool):
            words.append(f"--{name}" if value else f"--no-{name}")
            continue
        values = value if isinstance(value, tuple) else (value,)
        texts = [str(one) for one in values]
        if option.file:
            found = [batch.source.resolve(text).absolute() for text in texts]
            files += found
            texts = [str(file) for file in found]
        # --option=value: a value may begin with a dash
        words += [f"--{name}={text}" for text in (texts if option.repeatable else [",".join(texts)])]
    return words, files


def option_problems(batch: BatchConfig, index: int, form: CommandForm) -> Iterator[str]:
    """What is wrong with the options of a job, each with its line."""
    for name, value in batch.jobs[index].options.items():
        at, option = batch.source.at("jobs", index, "options", name), form.options.get(name)
        if option is None:
            plain = name.replace("_", "-")
            opposite = plain.removeprefix("no-")
            near = get_close_matches(plain, form.options, n=1, cutoff=0.6)
            hint = f'; did you mean "{near[0]}"?' if near else f"; its options are {', '.join(form.options)}"
            if opposite in form.options and form.options[opposite].has_opposite:
                hint = f"; write {opposite}: false"
            yield f"{at}: no such option of {form.name} in a batch{hint}"
        elif option.flag and not isinstance(value, bool):
            yield f"{at}: expected true or false, found {value}"
        elif isinstance(value, bool) and not option.flag:
            yield f"{at}: expected a value, found {str(value).lower()}"
        elif value is False and not option.has_opposite:
            yield f"{at}: expected true; leave the option out where it is not wanted"
        elif option.file:
            paths = [batch.source.resolve(str(one)) for one in (value if isinstance(value, tuple) else (value,))]
            yield from (f"{at}: no such file: {path}" for path in paths if not path.exists())
