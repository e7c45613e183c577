"""Values that expire in a recording: from robot.yaml to the verdict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dyknow_recordings.check import main
from dyknow_recordings.evaluation.column_states import ColumnStates
