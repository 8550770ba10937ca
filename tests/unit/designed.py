"""Designs that are computed and written, without pictures and report."""

from __future__ import annotations

from lightopt.core.run_context import RunContext
from lightopt.design import DesignResult, finish_design, optimize, write_design


def design(rig, part, folder, *, options=None, force=False, progress=None) -> DesignResult:
    run = RunContext(progress=progress)
    result = optimize(rig, part, folder, options=options, force=force, run=run)
    finish_design(write_design(result, force=force, run=run))
    return result
