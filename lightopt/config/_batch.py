"""The jobs of a batch: commands on rigs and parts, and which job uses the results of which."""

from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Annotated, Any, Literal

from pydantic import Field, ValidatorFunctionWrapHandler, field_validator

from lightopt.config import _fields as fields

_NO_DOT = fields.that(lambda name: "." not in name, "expected a name without a dot; results are in a folder of it")
JobName = Annotated[fields.FileName, _NO_DOT]
OptionValue = Annotated[
    bool | int | float | str | Annotated[tuple[int | float | str, ...], Field(strict=False, min_length=1)],
    fields.expecting("a number, text, true, false, or a list of numbers or texts"),
]
_FROM = ("rig_from", "part_from", "images_from")


class JobConfig(fields.Frozen):
    """A command, run for each rig and part."""

    name: JobName
    """Name of the job, and of the folder of its results."""
    command: fields.Text
    """Command of lightopt on a rig and a part: check, render, fit-specular, optimize, inspect, ..."""
    needs: Annotated[tuple[JobName, ...], Field(strict=False)] = ()
    """Jobs that must have succeeded for the same rig and part."""
    rig_from: JobName | None = None
    """Job whose rig file (rig.optimized.yaml, rig.fitted.yaml) takes the place of the rig."""
    part_from: JobName | None = None
    """Job whose part file (part.fitted.yaml, part.planned.yaml) takes the place of the part."""
    images_from: JobName | None = None
    """Job whose image set the command reads."""
    images: fields.Text | None = None
    """Image set that the command reads, relative to this file; {rig} and {part} stand for their names."""
    options: dict[str, OptionValue] = Field(default_factory=dict[str, OptionValue])
    """Options of the command, without the dashes: step: 5, joint: true, report: false."""

    @property
    def sources(self) -> Mapping[str, str]:
        """Jobs whose results take the place of an argument, by its name: rig, part, images."""
        return {key.removesuffix("_from"): name for key in _FROM if (name := getattr(self, key)) is not None}

    @property
    def all_needs(self) -> tuple[str, ...]:
        """All jobs that come before this one."""
        return tuple(dict.fromkeys((*self.needs, *self.sources.values())))


_Files = Annotated[tuple[fields.Text, ...], Field(strict=False, min_length=1, max_length=10_000)]


class BatchConfig(fields.FileConfig):
    """Jobs, each for every rig and every part."""

    format: Literal["lightopt-batch/1"]
    """Kind and version of this file: lightopt-batch/1."""
    rigs: _Files
    """Rig files, folders of them, or patterns such as rigs/*.yaml; relative to this file."""
    parts: _Files
    """Part files, folders of them, or patterns such as parts/*.yaml; relative to this file."""
    jobs: Annotated[tuple[JobConfig, ...], Field(strict=False, min_length=1, max_length=100)]
    """The jobs."""

    @field_validator("jobs", mode="wrap")
    @classmethod
    def _fit_together(cls, value: object, handler: ValidatorFunctionWrapHandler) -> Any:
        jobs = fields.entries(value)
        complaints = [*fields.same_names(jobs, "jobs", str.lower), *_misfits(jobs)]
        return fields.with_complaints(value, handler, complaints)

    @property
    def in_order(self) -> tuple[JobConfig, ...]:
        """The jobs, each after those that it needs."""
        jobs = {job.name: job for job in self.jobs}
        order = TopologicalSorter({name: job.all_needs for name, job in jobs.items()}).static_order()
        return tuple(jobs[name] for name in order)


def _misfits(jobs: Sequence[object]) -> Iterator[fields.Complaint]:
    # jobs that are not there, a cycle, and images given twice, by the path under ``jobs``
    names = [str(fields.value_of(job, "name")) for job in jobs]
    graph: dict[str, list[str]] = {name: [] for name in names}
    for i, job in enumerate(jobs):
        needs = [(("needs", k), name) for k, name in enumerate(fields.entries(fields.value_of(job, "needs")))]
        sources = [((key,), name) for key in _FROM if (name := fields.value_of(job, key)) is not None]
        for keys, name in (*needs, *sources):
            if name in names:
                graph[names[i]].append(str(name))
            elif isinstance(name, str):
                yield (i, *keys), f'no job "{name}"; the jobs are {", ".join(names)}'
        if fields.value_of(job, "images") is not None and fields.value_of(job, "images_from") is not None:
            yield (i, "images"), "given together with images_from; expected only one of them"
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        cycle = list(reversed(error.args[1]))
        yield (names.index(cycle[0]),), f"the jobs wait for each other: {' needs '.join(cycle)}"
