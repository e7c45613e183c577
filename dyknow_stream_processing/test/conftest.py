"""Fixtures of the tests of streams; `recorded_flow.py` is importable by all of them."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from recorded_flow import Flow


@pytest.fixture
def flow() -> Flow:
    return Flow()


@pytest.fixture(scope='session')
def flow_class() -> type[Flow]:
    return Flow
