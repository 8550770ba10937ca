"""Designs that are computed and written, without pictures and report."""

from __future__ import annotations

from lightopt.design import DesignResult, RunContext, finish_design, optimize, write_design


def design(rig, part, folder, *, options=None, force=False, rays=None) -> DesignResult:
    run = RunContext(rays=rays)
    result = optimize(rig, part, folder, options=options, force=force, run=run)
    finish_design(write_design(result, force=force, run=run))
    return result
