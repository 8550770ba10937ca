"""Benches of the hardware tests have faults, which other tests' benches do not know."""

from __future__ import annotations

from collections.abc import Generator

import pytest
from faulty_bench import with_faults


@pytest.fixture(scope="module", autouse=True)
def faulty_benches() -> Generator[None]:
    with with_faults():
        yield
