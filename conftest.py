"""Settings that all tests share.

The packages are imported before pytest meets the folders of the same names that hold them.
"""

import gc
import os
from collections.abc import Sequence
from importlib.util import find_spec

import pytest
from hypothesis import HealthCheck, settings

import dyknow_bringup  # noqa: F401
import dyknow_command  # noqa: F401
import dyknow_common  # noqa: F401
import dyknow_configuration  # noqa: F401
import dyknow_coordinator  # noqa: F401
import dyknow_dashboard  # noqa: F401
import dyknow_federation  # noqa: F401
import dyknow_reactions  # noqa: F401
import dyknow_reasoning  # noqa: F401
import dyknow_recordings  # noqa: F401
import dyknow_semantics  # noqa: F401
import dyknow_space  # noqa: F401
import dyknow_stream_processing  # noqa: F401

USUAL_CASES = 40
"""Random cases of a property test, unless it needs others: `random_cases` tells them."""
RANDOM_CASES = int(os.environ.get('DYKNOW_RANDOM_CASES', '0'))
"""Random cases of each property test, if their number is unusual: `make test-long` has many."""
LONG_RUN = 100
"""More cases than this may take longer than the time limit of a test."""

# Tests assert what comes out, not how fast: other processes may have the machine. A run repeats the
# random cases of the one before, so that a failure belongs to a change; a long run seeks new ones.
settings.register_profile(
    'dyknow',
    max_examples=RANDOM_CASES or USUAL_CASES,
    deadline=None,
    derandomize=RANDOM_CASES <= LONG_RUN,
    database=None,
    suppress_health_check=list(HealthCheck),
)
settings.load_profile('dyknow')

# What is imported and collected stays until the end: collections of garbage would only walk it.
gc.disable()

# The cores of the packages need no ROS, and no more do their tests.
collect_ignore_glob = [] if find_spec('rclpy') else ['dyknow_*/test/ros/*']


def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    """Give the tests of a long run as much time as they need."""
    if RANDOM_CASES > LONG_RUN:
        for item in items:
            item.add_marker(pytest.mark.timeout(0), append=False)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Let collections of garbage see what tests make, and not what was collected before."""
    gc.freeze()
    gc.enable()


def pytest_report_header() -> list[str]:
    """Say which tests are left out."""
    return ['without ROS: the tests in test/ros are left out'] if collect_ignore_glob else []
