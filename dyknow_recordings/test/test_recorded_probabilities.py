"""Probabilities of formulas over recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from running_checks import run_check
from small_bags import messages, write

ROBOT = """\
objects: {Rover: [r1]}
features:
  Height:
    of: {r: Rover}
    unit: m
    uncertainty: {variance: 'pose.covariance[14]', time_constant: %s}
    from: {topic: /odom, field: pose.pose.position.z}
  Armed: {type: boolean, from: {topic: /armed, field: data}}
"""
BOUNDED_ROBOT = ROBOT.replace(
    "{variance: 'pose.covariance[14]', time_constant: %s}", '{interval: %s}'
)
HEIGHT = 'normal("/odom".pose.pose.position.z, sqrt("/odom".pose.covariance[14]), %s)'
TRACE = 'time_s,x,var,busy\n0,3,1,true\n1,2,1,true\n2,3,0.5,false\n'


def recorded(tmp_path: Path, text: str) -> tuple[str, ...]:
    """The options of a recording, and of a robot.yaml with a text."""
    bag, robot = tmp_path / 'bag', tmp_path / 'robot.yaml'
    write(bag, 'mcap', 'none', messages(60))
    robot.write_text(text)
    return str(bag), '--config', str(robot)


def formulas(*options: str) -> list[dict[str, Any]]:
    found = run_check(*options, '--probability', '--json').formulas
    assert not [each['error'] for each in found if each['error']]
    return found


@pytest.mark.parametrize('constant', ['0 s', '100 ms'])
def test_a_robot_states_its_uncertainty(tmp_path: Path, constant: str) -> None:
    found = formulas(
        *recorded(tmp_path, ROBOT % constant),
        *('--formula', 'forall r in Rover: always Height[r] > -900 cm'),
        *('--formula', f'P(always {HEIGHT % constant} > -9.0) > 0'),
        *('--formula', 'always P(Height[r1] > 60 m) < 0.5'),
        *('--formula', 'always Armed'),
    )
    stated, written, nested, certain = found
    # The features give the same as what is written out.
    assert stated['probability']['assumption']
    assert stated['probability']['lower'] == 0.0
    assert 0.01 < stated['probability_so_far']['upper'] < 0.9999
    assert written['probability'] is None
    assert written['outcome'] == 'undecided'
    assert (
        'normal(Height[r1], sqrt(Height_variance[r1])' in nested['episodes'][0]['residual_formula']
    )
    assert certain['probability'] is None


LIMITS = '> 0.32', '> 0.68'
PLANE = """\
objects: {Rover: [r1]}
features:
  X:
    of: {r: Rover}
    uncertainty: {variance: 'pose.covariance[14]', covariances: {Y: 'pose.covariance[0]'}}
    from: {topic: /odom, field: pose.pose.position.x}
  Y:
    of: {r: Rover}
    uncertainty: {variance: 'pose.covariance[21]'}
    from: {topic: /odom, field: pose.pose.position.y}
"""


def test_a_robot_states_covariances(tmp_path: Path) -> None:
    pose = '"/odom".pose'
    y = f'normal({pose}.pose.position.y, sqrt({pose}.covariance[21]))'
    other = f'covariance({pose}.pose.position.y, {pose}.covariance[0])'
    x = f'normal({pose}.pose.position.x, sqrt({pose}.covariance[14]), {other})'
    texts = (
        'always[0, 1 ms] X[r1] - Y[r1] < 1',
        'hypot(X[r1], Y[r1]) < 8',
        f'P({x} - {y} < 1) > 0.63 and P({x} - {y} < 1) < 0.64',
        f'P(hypot({x}, {y}) < 8) > 0.5',
        'X[r1] < 4',
    )
    options = [option for text in texts for option in ('--formula', text)]
    exact, bounded, *written, alone = formulas(*recorded(tmp_path, PLANE), *options)
    # The difference of 4 and 5 has a variance of 14 + 21 - 2 * 0.
    assert exact['probability']['lower'] == pytest.approx(0.632337, abs=1e-4)
    assert exact['probability']['assumption'].endswith('but for the covariances')
    assert bounded['probability']['assumption'].endswith('but for the covariances')
    assert 0 < bounded['probability']['upper'] - bounded['probability']['lower'] < 0.005
    assert [each['outcome'] for each in written] == ['true', 'true']
    assert alone['probability']['assumption'] == 'assuming nothing about correlation'


CLOUD = """\
objects: {Rover: [r1]}
features:
  Offset:
    of: {r: Rover}
    uncertainty: {samples: pose.covariance}
    from: {topic: /odom, field: mean(pose.covariance)}
"""


def test_a_robot_states_samples(tmp_path: Path) -> None:
    """The first message has 0 to 35."""
    cloud = '"/odom".pose.covariance'
    written = f'sampled(mean({cloud}), samples({cloud}))'
    asked = [f'P({each} > 17.5) {bound}' for each in ('Offset[r1]', written) for bound in LIMITS]
    options = [option for text in ('Offset[r1] > 17.5', *asked) for option in ('--formula', text)]
    found, *others = formulas(*recorded(tmp_path, CLOUD), *options)
    assert found['probability']['lower'] == pytest.approx(0.329, abs=1e-3)
    assert found['probability']['upper'] == pytest.approx(0.671, abs=1e-3)
    assert found['probability']['assumption'] == 'with 95 % confidence, of independent samples'
    assert [each['outcome'] for each in others] == ['true', 'false'] * 2


@pytest.mark.parametrize('error', ['1.5', "'pose.covariance[14]'"])
def test_a_robot_states_the_greatest_error(tmp_path: Path, error: str) -> None:
    asked = 'P(Height[r1] > -5000 m) >= 1', 'P(Height[r1] > 5000 m) < 0.1', 'Height[r1] > 0 m'
    options = [option for text in asked for option in ('--formula', text)]
    found = formulas(*recorded(tmp_path, BOUNDED_ROBOT % error), *options)
    assert [each['outcome'] for each in found[:2]] == ['true', 'true']
    assumption = found[2]['probability']['assumption']
    assert assumption == 'assuming errors within their bounds'


def test_bounds_in_tables_and_json(tmp_path: Path) -> None:
    path = tmp_path / 'trace.csv'
    path.write_text(TRACE)
    stated = 'let x ~ normal(x, sqrt(var)) in '
    asked = ('--formula', f'{stated}always x > 0')
    bounded, unbounded = formulas(str(path), '--formula', f'{stated}always[0 s, 2 s] x > 0', *asked)
    expected = {'assumption': 'assuming nothing about correlation'}
    expected |= {'lower': pytest.approx(0.975889, abs=1e-6), 'upper': pytest.approx(0.977250)}
    assert bounded['probability'] == bounded['probability_so_far'] == expected
    assert unbounded['probability_so_far'] == expected
    assert unbounded['probability'] == expected | {'lower': 0.0}
    words = ' '.join(run_check(path, *asked, '--probability').out.replace('│', ' ').split())
    assert 'probability' in words
    assert 'so far' in words


@pytest.mark.parametrize('constant', ['', ', 0 s', ', 100 ms'])
def test_an_unknown_value_leaves_the_bounds_of_all_that_it_may_be(
    tmp_path: Path, constant: str
) -> None:
    """The example of the documentation, in a window and its first half, and other formulas."""
    path = tmp_path / 'trace.csv'
    stated = f'let x ~ normal(x, sqrt(var){constant}) in '
    texts = 'always[0, 300 ms] x > 1', 'always[0, 100 ms] x > 1', 'eventually[0, 300 ms] x < 1'
    options = [option for each in texts for option in ('--formula', f'{stated}{each}')]

    def probabilities(height: str) -> list[dict[str, Any]]:
        path.write_text(f'time_s,x,var\n0,3,.25\n.1,2.5,.25\n.2,{height},.25\n.3,2.8,.5\n')
        found = formulas(str(path), *options, '--missing', 'unknown')
        return [each['probability'] for each in found]

    bounds = probabilities('')
    for height in ('-9', '1', '2.7', '50'):
        for bound, found in zip(bounds, probabilities(height), strict=True):
            assert bound['assumption'] == found['assumption']
            assert bound['lower'] <= found['lower'] <= found['upper'] <= bound['upper']
    assert bounds[0]['lower'] == 0
    assert bounds[0]['upper'] < 1
    assert bounds[1]['lower'] > 0.98  # It does not depend on what is unknown.


def test_states_are_read_until_the_probability_is_known(tmp_path: Path) -> None:
    """The verdict on the best estimates may come earlier, and be another one."""
    path = tmp_path / 'trace.csv'
    path.write_text(TRACE)
    text = 'let x ~ normal(x, sqrt(var), 0 s) in always[0 s, 2 s] x > 2.5'
    (found,) = formulas(str(path), '--formula', text)
    assert found['episodes'][0]['decided_at_ns'] == 10**9
    assert found['probability']['upper'] == pytest.approx(0.69146 * 0.30854 * 0.76025, abs=1e-4)
    assert found['states'] == 3


@pytest.mark.parametrize('row', ['3,3,-1,true', '3,nan,1,true'])
@pytest.mark.parametrize('body', ['always x > 2.5', 'eventually x < 2.5', 'always busy'])
def test_a_fault_after_the_verdict_is_none_of_it(tmp_path: Path, body: str, row: str) -> None:
    path = tmp_path / 'trace.csv'
    path.write_text(f'{TRACE}{row}\n4,3,1,true\n')
    options = path, '--json', '--formula', f'let x ~ normal(x, sqrt(var), 0 s) in {body}'
    plain, asked = run_check(*options), run_check(*options, '--probability')
    assert asked.code == plain.code
    (expected,), (found,) = plain.formulas, asked.formulas
    for each in 'outcome', 'episodes', 'error', 'violations', 'gaps', 'events':
        assert found[each] == expected[each]
    lacks = f"'let x ~ normal(x, sqrt(var), 0 s) in {body}' has no probability: "
    assert any(each.startswith(lacks) for each in json.loads(asked.out)['notes']) is (
        'x >' in body or 'x <' in body
    )


def test_episodes_have_no_probability(tmp_path: Path) -> None:
    path = tmp_path / 'trace.csv'
    path.write_text(TRACE)
    found = run_check(path, '--formula', 'always x > 0', '--probability', '--every', 'state')
    assert (found.code, 'leave out --every' in found.err) == (2, True)
