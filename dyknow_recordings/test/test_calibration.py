"""Calibration of forecasts: its quantile, its coverage, and the command."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from running_checks import run_check

from dyknow_common.executables import run_main
from dyknow_configuration import read_robot
from dyknow_recordings.calibrate import add_calibrate_options, calibrate
from dyknow_recordings.calibration import block_quantile, least_blocks
from dyknow_recordings.errors import RecordingError

DATA = Path(__file__).parents[3] / 'shared' / 'data'
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason='the recorded flights are not there')

ROBOT = """\
features:
  Height:
    unit: m
    from: {topic: /trace, field: z}
    forecast:
      by: constant_velocity
      fields: {rate: v}
      horizons: [500 ms, 1 s]
      step: 250 ms
      table: tables.yaml
formulas:
  - {name: fence, formula: 'always not soon[1 s] Height > 150 cm', every_state: true}
  - {name: fence now, formula: always Height <= 1.5 m}
"""
FLIGHT = """\
objects: {{UAV: [{uav}]}}
features:
  Altitude:
    of: {{u: UAV}}
    unit: m
    from: {{topic: '/{{u}}/odometry', field: pose.pose.position.z, max_delay: 1 s}}
    forecast:
      by: {by}
      horizons: {horizon}
      table: tables.yaml
formulas:
  - {{name: fence, formula: 'forall u in UAV: always not soon[{horizon}] Altitude[u] > 2 m'}}
"""

scores = st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=5), min_size=3, max_size=12)


@given(scores, st.sampled_from((0.5, 0.7, 0.75)))
def test_the_quantile_is_the_least_value_with_enough_weight(
    blocks: list[list[int]], coverage: float
) -> None:
    arrays = [np.array(each, np.float64) for each in blocks]
    if len(blocks) < least_blocks(coverage):
        with pytest.raises(RecordingError, match='blocks of time to calibrate with'):
            block_quantile(arrays, coverage)
        return
    found = block_quantile(arrays, coverage)

    def weight(limit: float) -> float:
        inside = (sum(each <= limit for each in block) / len(block) for block in blocks)
        return sum(inside) / (len(blocks) + 1)

    assert weight(found) >= coverage - 1e-9
    below = [each for block in blocks for each in block if each < found]
    assert not below or weight(max(below)) < coverage + 1e-9


def test_least_blocks() -> None:
    assert [least_blocks(each) for each in (0.5, 0.9, 0.95, 0.99)] == [1, 9, 19, 99]


def test_new_blocks_are_covered_although_samples_of_a_block_are_alike() -> None:
    """Each block has its own scale, as each flight has its own wind."""
    random = np.random.default_rng(3)

    def block() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        count = int(random.integers(1, 40))
        return np.abs(random.normal(0, random.exponential(), count))

    inside = []
    for _ in range(1000):
        limit = block_quantile([block() for _ in range(30)], 0.95)
        inside.append(np.mean(block() <= limit))
    error = np.std(inside) / math.sqrt(len(inside))
    assert np.mean(inside) > 0.95 - 3 * error


def write_run(
    path: Path, seed: int, period_ms: int = 50, count: int = 1200, push: float = 0.5
) -> None:
    """Write a run whose height is pulled back to 0 and pushed by noise."""
    random = np.random.default_rng(seed)
    z = v = 0.0
    lines = ['time_ms,z,v']
    for index in range(count):
        step = period_ms / 1000
        z += v * step
        v += (-z - 0.5 * v) * step + random.normal(0, push) * math.sqrt(step)
        lines.append(f'{index * period_ms},{z!r},{v!r}')
    path.write_text('\n'.join(lines) + '\n')


def calibrated(folder: Path, *more: str, text: str = ROBOT) -> int:
    (folder / 'robot.yaml').write_text(text)
    parser = argparse.ArgumentParser()
    add_calibrate_options(parser)
    options = [str(folder / 'robot.yaml'), *more]
    return run_main('dyknow calibrate', lambda: calibrate(parser.parse_args(options)))


def test_simulated_runs_are_covered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [tmp_path / f'{seed}.csv' for seed in range(6)]
    for seed, path in enumerate(runs):
        write_run(path, seed)
    measured, held_out = map(str, runs[:3]), map(str, runs[3:])
    assert calibrated(tmp_path, *measured, '--held-out', *held_out) == 0
    forecast = read_robot(tmp_path / 'robot.yaml').forecasts[0]
    assert len(forecast.widening) == 5
    assert forecast.widening[0] == 0
    assert list(forecast.widening) == sorted(forecast.widening)
    output = capsys.readouterr().out
    inside = [
        float(line.split(', ')[1].split('%')[0]) for line in output.splitlines() if 'after' in line
    ]
    # 180 blocks of a second: 95 % with a standard deviation of 1.6 %.
    assert len(inside) == 2
    assert min(inside) > 95 - 2 * 1.6
    assert 'Height_high_1s > 1.5 m: ' in output


def test_answers_say_whether_forecasts_are_calibrated(tmp_path: Path) -> None:
    run = tmp_path / 'run.csv'
    write_run(run, 1)
    (tmp_path / 'robot.yaml').write_text(ROBOT)
    options = (run, '--config', tmp_path / 'robot.yaml', '--json')
    before = run_check(*options).out
    assert 'Height_high_1s = ' in before
    assert '(not calibrated: Height_high_1s)' in before
    assert calibrated(tmp_path, str(run)) == 0
    after = run_check(*options).out
    assert 'Height_high_1s = ' in after
    assert 'not calibrated' not in after


@needs_data
@pytest.mark.parametrize(
    ('name', 'uav', 'by', 'horizon'),
    [
        ('px4_sitl_flight', 'uav1', 'constant_velocity', '500 ms'),
        ('px4_sitl_flight', 'uav1', 'kalman', '500 ms'),
        ('px4_vtol_hop', 'uav2', 'constant_velocity', '100 ms'),
    ],
)
def test_real_flights_are_covered(
    tmp_path: Path, name: str, uav: str, by: str, horizon: str
) -> None:
    settings = {
        'constant_velocity': 'constant_velocity\n      fields: {rate: twist.twist.linear.z}',
        'kalman': 'kalman\n      settings: {acceleration: 1.0, noise: 0.02}',
    }
    text = FLIGHT.format(uav=uav, by=settings[by], horizon=horizon)
    assert calibrated(tmp_path, str(DATA / name), text=text) == 0


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('formulas: []', 'no feature has a forecast'),
        (ROBOT.replace('      table: tables.yaml\n', ''), 'names no table'),
        (ROBOT.replace('topic: /trace', 'stream: trace'), 'reads a stream'),
        (ROBOT.replace('{rate: v}', '{rate: w}'), "'w'"),
        (ROBOT.replace('{topic: /trace', '{topic: /other'), 'have no message'),
        (ROBOT.replace('by: constant_velocity', 'by: mean'), 'is no forecast that can be'),
        (ROBOT.replace('step: 250 ms', 'step: 250 ms\n      settings: {drag: 1}'), 'drag'),
        (ROBOT.replace('[500 ms, 1 s]', '10 s'), 'there are 3 blocks of time'),
    ],
)
def test_what_cannot_be_calibrated_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, reason: str
) -> None:
    write_run(tmp_path / 'run.csv', 1)
    assert calibrated(tmp_path, str(tmp_path / 'run.csv'), text=text) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / 'tables.yaml').exists()


def test_other_runs_than_those_measured_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calm, wild = tmp_path / 'calm.csv', tmp_path / 'wild.csv'
    write_run(wild, 1)
    calm.write_text('\n'.join(['time_ms,z,v', *(f'{50 * each},0.0,0.0' for each in range(1200))]))
    assert calibrated(tmp_path, str(calm), '--held-out', str(wild)) == 1
    assert 'covers less than 0.95 of the held-out truths' in capsys.readouterr().err


def test_runs_that_are_too_short_to_test_with_are_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / 'run.csv', 1)
    write_run(tmp_path / 'short.csv', 2, count=15)
    held_out = ('--held-out', str(tmp_path / 'short.csv'))
    assert calibrated(tmp_path, str(tmp_path / 'run.csv'), *held_out) == 2
    assert 'no held-out forecast has truths' in capsys.readouterr().err
    assert not (tmp_path / 'tables.yaml').exists()


def test_every_second_block_with_messages_is_held_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'run.csv'
    write_run(path, 1)
    path.write_text(path.read_text() + '60000,inf,0.0\n')
    assert calibrated(tmp_path, str(path), '--block', '25 ms') in {0, 1}
    output = capsys.readouterr().out
    assert 'in 601 blocks, tested with 600 blocks' in output
    assert 'nan' not in output
    with pytest.raises(SystemExit):
        calibrated(tmp_path, str(path), '--block', '0')


def test_drift_is_a_note_of_a_check(tmp_path: Path) -> None:
    like, wild = tmp_path / 'like.csv', tmp_path / 'wild.csv'
    for seed, path in enumerate((tmp_path / 'run.csv', like)):
        write_run(path, seed)
    write_run(wild, 2, push=3.0)
    assert calibrated(tmp_path, str(tmp_path / 'run.csv')) == 0
    options = ('--config', tmp_path / 'robot.yaml', '--json')
    found = [run_check(path, *options).document['notes'] for path in (like, wild)]
    assert found[0] == []
    (note,) = found[1]
    assert note.startswith("stream 'forecast_Height_high_1s': ")
    assert 'values, at most one in each 1 s, were outside' in note
