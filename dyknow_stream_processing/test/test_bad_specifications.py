"""Errors of specifications that make no sense, as golden files."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_flow import Flow

from dyknow_common import DyKnowError, LanguageError, StreamConstraints, ValueType
from dyknow_stream_processing import ALL, load_units

BAD = sorted((Path(__file__).parent / 'bad_specifications').glob('*.stream'))
FLOAT, STRING = ValueType.FLOAT, ValueType.STRING


@pytest.fixture
def known(flow_class: type[Flow]) -> Flow:
    units = load_units()
    names = ('distance', 'electrical_power', 'mean', 'minimum')
    flow = flow_class({name: units[name] for name in names})
    flow.types = {
        '/battery': {'voltage': FLOAT, 'current': FLOAT, 'present': ValueType.BOOLEAN},
        '/scan': {'ranges[0..]': FLOAT, 'covariance[0..35]': FLOAT, 'points[0..].x': FLOAT},
        '/tf': {'transforms[0..].child_frame_id': STRING},
        '/dock/_action/status': {'data': FLOAT},
        '/d': {'frame': STRING, 's[0..].name': STRING, 's[0..].z': ValueType.INT},
        '/odometry': {'x': FLOAT, 'y': FLOAT},
        'a': {'x': ValueType.INT, 'y': ValueType.INT, 't': STRING},
        '/fleet': {'id': STRING, 'pose.position.z': FLOAT, 'speed': FLOAT},
    }
    return flow.create('"/fleet"', name='fleet')


@pytest.mark.parametrize('path', BAD, ids=lambda path: path.stem)
def test_bad_specifications(known: Flow, path: Path) -> None:
    with pytest.raises(LanguageError) as error:
        known.create(path.read_text(encoding='utf-8'))
    assert f'{error.value}\n' == path.with_suffix('.expected').read_text(encoding='utf-8')
    assert known.dataflow.names() == ('fleet',)
    assert dict(known.dataflow.sources()) == {'/fleet': {ALL}}


def test_bad_specifications_are_found() -> None:
    assert len(BAD) > 40


def test_constraints_of_the_caller_that_contradict(known: Flow) -> None:
    with pytest.raises(DyKnowError, match='cannot be both 5 ms and 6 ms'):
        known.create(
            'fleet with sample_period = 5 ms',
            constraints=StreamConstraints(sample_period=6_000_000),
        )
