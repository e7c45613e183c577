"""Pages and images of checked recordings."""

from __future__ import annotations

import errno
import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import ListedSamples, at, recording, sample
from small_bags import STORE, write_messages

from dyknow_common import SECOND_NS, DyKnowError, Margin, Verdict
from dyknow_configuration import RequestedFormula
from dyknow_recordings.check import main
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.observation import Signal, SignalRecorder, terms_of
from dyknow_recordings.evaluation.results import (
    MAX_REMAINDER,
    Attempt,
    Episode,
    FormulaReport,
    Outcome,
    RecordingReport,
    StateGap,
)
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.files import PictureFiles
from dyknow_recordings.reporting.pictures.image import report_image
from dyknow_recordings.reporting.pictures.page import report_page
from dyknow_recordings.reporting.pictures.panels import (
    MAX_PANELS,
    Threshold,
    formula_text,
    marks,
    panels,
    unknown_spans,
)
from dyknow_recordings.reporting.pictures.timeline import (
    MAX_SEGMENTS,
    Span,
    extent,
    pending_windows,
    segments,
)
from dyknow_recordings.reporting.table import Tables
from dyknow_stream_processing import Violation

pytestmark = pytest.mark.skipif(
    not all(map(find_spec, ('plotly', 'matplotlib'))),
    reason='plotly and matplotlib are not both installed',
)

HOSTILE = '<script>alert(1)</script><b title="x">&amp;$x_{'


def source(values: list[float], topic: str = '/a') -> ListedSamples:
    return recording([sample(topic, n / 10, p=float(each)) for n, each in enumerate(values)])


def checked(
    *formulas: str,
    values: list[float],
    start: EpisodeStart = FROM_FIRST_STATE,
    name: str = '',
) -> RecordingReport:
    requested = [RequestedFormula(each, name) for each in formulas]
    return evaluate_recording(source(values), requested, start=start, keep_signals=True)


def page(*reports: RecordingReport, unread: tuple[str, ...] = ()) -> str:
    return report_page(reports, unread, Judgement.AUTO)


def data_of(text: str) -> Any:
    return json.loads(
        re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)[0]
    )


class Outline(HTMLParser):
    """The elements of a page, and its text without scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ''
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Any) -> None:  # noqa: ARG002
        self.tags.append(tag)
        if tag not in {'meta', 'br'}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ['script']:
            self.text += data


def outcomes(formula: FormulaReport, whole: Span) -> list[tuple[Span, str]]:
    return [(each.span, each.outcome) for each in segments(formula, whole)]


def test_the_outcome_over_time() -> None:
    texts = (
        'always "/a".p < 5',
        'always "/a".p < 50',
        'always',
        'eventually "/a".p >= 0',
        'always "/b".p < 5',
    )
    report = checked(*texts, values=[*range(10)])
    whole = extent(report)
    assert (whole.start, whole.end) == (at(0), at(0.9))
    assert [outcomes(each, whole) for each in report.formulas] == [
        [(Span(at(0), at(0.5)), 'undecided'), (Span(at(0.5), at(0.9)), 'false')],
        [(whole, 'undecided')],
        [(whole, 'error')],
        [(whole, 'true')],
        [(whole, 'error')],
    ]


@pytest.mark.parametrize(('later', 'shown'), [(0.0, 0.0), (0.9, -0.9), (10.0, -10.0), (1e6, 0.0)])
def test_times_count_from_the_start_of_the_recording(
    later: float, shown: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """So they are what --begin takes, unless the log times are of another clock."""
    report = checked('always "/a".p < 5', values=[*range(10)])
    report = replace(report, start_time=at(later), end_time=at(later + 0.9))
    whole = extent(report)
    assert whole.start == at(0)
    assert whole.text(at(0.5)) == f'{shown + 0.5:.3f} s'
    assert whole.ticks[0] >= whole.start
    assert (whole.ticks[0] - whole.origin) % (whole.ticks[1] - whole.ticks[0]) == 0
    Tables(Judgement.AUTO).add(report)
    assert f' {shown + 0.5:.3f} s' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('episode', 'expected'),
    [
        (Episode(at(1), Verdict.TRUE, at(1)), [(1, 3, 'true')]),
        (Episode(at(1), Verdict.TRUE, at(3)), [(1, 3, 'undecided'), (3, 3, 'true')]),
        (Episode(None, Verdict.FALSE), [(0, 3, 'false')]),
        (Episode(at(1), error=RecordingError('x')), [(1, 3, 'error')]),
    ],
)
def test_the_outcome_of_an_episode_over_time(
    episode: Episode, expected: list[tuple[float, float, str]]
) -> None:
    assert outcomes(FormulaReport('f', 'f', (episode,)), Span(at(0), at(3))) == [
        (Span(at(start), at(end)), outcome) for start, end, outcome in expected
    ]


def test_many_episodes_become_few_segments_with_the_worst_outcome() -> None:
    episodes = tuple(
        Episode(at(n), Verdict.FALSE if n == 777 else Verdict.TRUE, at(n)) for n in range(5000)
    )
    found = segments(FormulaReport('f', 'f', episodes), Span(at(0), at(5000)))
    assert len(found) == 3
    assert found[1].outcome is Outcome.FALSE
    assert found[1].span.start <= at(777) <= found[1].span.end
    assert all(a.span.end == b.span.start for a, b in pairwise(found))
    alternating = tuple(Episode(at(n), Verdict(1 + n % 2), at(n)) for n in range(5000))
    many = segments(FormulaReport('f', 'f', alternating), Span(at(0), at(5000)))
    assert len(many) <= MAX_SEGMENTS + 1


def test_thresholds_of_atoms_in_any_form() -> None:
    report = checked(
        'always (3 > "/a".p and "/a".p <= 5 and "/a".p < 3 and "/a".p != -2.5)', values=[1, 2]
    )
    (panel,), omitted = panels(report.formulas[0])
    assert omitted == 0
    assert panel.thresholds == (
        Threshold(3.0, '< 3'),
        Threshold(5.0, '<= 5'),
        Threshold(-2.5, '!= -2.5'),
    )


def test_signals_that_are_compared_share_a_panel() -> None:
    samples = [sample(topic, n / 10, p=float(n)) for n in range(5) for topic in ('/a', '/b')]
    text = 'always ("/a".p <= "/b".p and "/a".p < 9)'
    report = evaluate_recording(recording(samples), [RequestedFormula(text)], keep_signals=True)
    found, _ = panels(report.formulas[0])
    assert [[each.name for each in panel.signals] for panel in found] == [
        ['"/a".p', '"/b".p'],
        ['"/a".p'],
    ]


def test_the_stream_that_ended_a_formula_comes_first() -> None:
    """With many streams, it was not shown at all."""
    topics = [f'/t{number}' for number in range(MAX_PANELS + 2)]
    samples = [sample(topic, n / 10, p=float(n)) for n in range(3) for topic in topics]
    text = ' and '.join(f'"{topic}".p < 9' for topic in topics)
    found = evaluate_recording(
        recording(samples), [RequestedFormula(f'always ({text})')], keep_signals=True
    )
    violation = Violation('/t25', 'max_gap', at(0.2), at(0.3), 2, 1, 'broken')
    error = RecordingError('/t25 is silent')
    formula = replace(found.formulas[0], error=error, violations=(violation,))
    shown, omitted = panels(formula)
    assert [each.signals[0].name for each in shown[:2]] == ['"/t25".p', '"/t0".p']
    assert omitted == 2
    assert panels(replace(formula, error=None))[0][0].signals[0].name == '"/t0".p'


def test_the_windows_of_pending_obligations() -> None:
    report = checked('eventually[1 s, 3 s] "/a".p > 5 and always "/a".p < 9', values=[1, 2, 3])
    (episode,) = report.formulas[0].episodes
    assert pending_windows(episode, at(0.2)) == [Span(at(1), at(3))]
    found = marks(report.formulas[0], extent(report))
    assert found.pending == (Span(at(1), at(3)),)


def test_a_distant_window_does_not_squeeze_the_recording() -> None:
    report = checked('eventually[0 s, 9 s] "/a".p > 5', values=[1] * 31)
    (figure,) = data_of(page(report))['formulas']
    assert figure['marks']['pending'] == [[3.0, 9.0]]
    assert figure['range'] == pytest.approx([-0.04, 4.04])


def test_the_windows_that_a_verdict_is_about() -> None:
    report = checked(
        'always ("/a".p > 5 -> eventually[0 s, 300 ms] "/a".p < 1)', values=[1, 6, 2, 2, 2, 2]
    )
    found = marks(report.formulas[0], extent(report))
    assert found.windows == (Span(at(0.1), at(0.4)),)
    assert [(each.time, each.verdict) for each in found.deciding] == [(at(0.4), 'false')]
    assert found.deciding[0].values == {'"/a".p': 2.0}


def test_the_interval_of_a_probability_and_of_its_number_is_a_band() -> None:
    number = 'normal("/a".p, 2 * "/a".p, 1 s)'
    report = checked(f'always P({number} > -1) >= 0.6', values=[1, 2, 3])
    first, second = panels(report.formulas[0])[0]
    assert [each.name for each in first.signals + second.signals] == [f'P({number} > -1)', '"/a".p']
    assert first.thresholds == (Threshold(0.6, '>= 0.6'),)
    assert second.thresholds == (Threshold(-1.0, '> -1'),)
    signals = data_of(page(report))['signals']
    assert [each['low'] == each['v'] for each in signals] == [True, False]
    assert signals[0]['low'] == signals[0]['high'], 'it is exact'
    assert signals[1]['high'] == pytest.approx([4.92, 9.84, 14.76], rel=1e-3)
    assert report_image([report], Judgement.AUTO)


def test_the_probability_that_is_asked_for_is_a_band_over_time(tmp_path: Path) -> None:
    trace, file = tmp_path / 'trace.csv', tmp_path / 'page.html'
    trace.write_text('time_s,x\n0,1\n1,2\n2,1\n')
    formula = 'let x ~ normal(x, 1, 1 s) in always x > 0'
    main([str(trace), '--formula', formula, '--probability', '--html', str(file)])
    signals = {each['name']: each for each in data_of(file.read_text())['signals']}
    low, high = (signals['probability'][each] for each in ('low', 'high'))
    assert low == [0, 0, 0]
    assert 1 > high[0] > high[1] > high[2] > 0.5
    assert signals['x']['low'] == pytest.approx([-0.96, 0.04, -0.96], abs=1e-3)


def test_both_bounds_of_a_forecast_are_a_band() -> None:
    columns = {'H_low_5s': [1.0, 2.0], 'H_high_5s': [3.0, 5.0]}
    both, one = 'always (H_high_5s < 9 and H_low_5s > 0)', 'always H_high_5s < 8'
    recorder = SignalRecorder(terms_of([both, one], {}), {})
    recorder.states([0, 1], columns)
    report = checked('always', values=[1]).formulas[0]
    shown = [
        panels(replace(report, formula=each, signals=recorder.result()))[0] for each in (both, one)
    ]
    (band,) = shown[0]
    assert {each.text for each in band.thresholds} == {'< 9', '> 0'}
    (signal,) = band.signals
    assert signal.name == 'H_low_5s to H_high_5s'
    assert [each.tolist() for each in signal.band or ()] == list(columns.values())
    assert [each.name for each in shown[1][0].signals] == ['H_high_5s']


def test_the_margins_from_each_state_on_are_a_band() -> None:
    requested = [RequestedFormula('always[0 s, 200 ms] "/a".p > 1', margin=True)]
    report = evaluate_recording(
        source([3, 4, 2]),
        requested,
        start=EpisodeStart(every=Every.STATE),
        keep_signals=True,
        margins=True,
    )
    margin = panels(report.formulas[0])[0][-1]
    assert margin.thresholds == (Threshold(0.0, '0'),)
    (low, high) = margin.signals[0].band or ((), ())
    np.testing.assert_array_equal(low, [1, np.nan, np.nan])
    np.testing.assert_array_equal(high, [1, 1, 1])
    assert data_of(page(report))['signals'][-1]['v'] == [1, 1, 1]
    assert report_image([report], Judgement.AUTO)


def test_no_line_joins_the_margins_of_two_evaluations() -> None:
    margins = [Margin(float(n), float(n)) for n in range(4)]
    episodes = tuple(Episode(n, margin=each) for n, each in enumerate(margins))
    formula = replace(checked('always "/a".p > 1', values=[3]).formulas[0], episodes=episodes)
    first, second = (replace(formula, episodes=each) for each in (episodes[:2], episodes[2:]))
    formula = replace(formula, attempts=(Attempt(0, 1, first), Attempt(2, None, second)))
    high = panels(formula)[0][-1].signals[1]
    assert high.times.tolist() == [0, 1, 2, 2, 3]
    np.testing.assert_array_equal(high.values, [0, 1, np.nan, 2, 3])
    alone = (replace(each, episodes=each.episodes[:1]) for each in (first, second))
    attempts = tuple(Attempt(n, n, each) for n, each in enumerate(alone))
    assert len(panels(replace(formula, attempts=attempts))[0]) == len(panels(formula)[0]) - 1


def test_times_without_a_value_are_no_gaps() -> None:
    nan = float('nan')
    values = np.array([1.0, nan, nan, 2.0, nan, 3.0, nan])
    times = np.array([0, 10, 20, 30, 31, 50, 60])
    signal = Signal('a', times, values)
    # There is a gap after the state at 30; the last value is missing up to the end.
    assert unknown_spans(signal, [Span(30, 50)]) == (Span(10, 30), Span(60, 60))
    assert unknown_spans(signal, []) == (Span(10, 30), Span(31, 50), Span(60, 60))


def fleet(count: int) -> Iterator[RecordingReport]:
    """A recording of many robots; the last one breaks the formula."""
    names = tuple(f'u{n}' for n in range(count))
    samples = [
        sample('/fleet', n / 10, **{f'P[{name}]': float(n * (name == names[-1])) for name in names})
        for n in range(10)
    ]
    files = MonitoringFiles(domains={'Robot': names})
    formula = RequestedFormula('forall u in Robot: always P[u] < 5')
    yield evaluate_recording(recording(samples), [formula], files, keep_signals=True)


def test_the_deciding_object_comes_first_of_many() -> None:
    (report,) = fleet(MAX_PANELS + 6)
    found, omitted = panels(report.formulas[0])
    assert (len(found), omitted) == (MAX_PANELS, 6)
    assert [each.objects for each in found[:3]] == [f'u = u{MAX_PANELS + 5}', 'u = u0', 'u = u1']
    assert [each.is_decisive for each in found[:2]] == [True, False]
    text = Outline(page(report)).text
    assert 'decides' in text
    assert '6 more are not shown' in text


def test_of_a_long_remainder_people_see_the_ends() -> None:
    """That of many objects would fill a screen of a terminal."""
    remains = 'always p0' + ''.join(f' and always p{number}' for number in range(1, 200))
    shown = Episode(0, residual_formula=remains).remainder
    assert shown.startswith('nothing broke it; what remains: always p0 and always p1')
    assert '…' in shown
    assert shown.endswith(' and always p199')
    assert len(shown) < MAX_REMAINDER + 50


def test_a_page_is_complete_and_needs_no_network() -> None:
    report = checked('always "/a".p < 5', 'eventually "/a".p > 50', 'always', values=[*range(9)])
    text = page(report, unread=('b.mcap: broken',))
    outline = Outline(text)
    assert outline.open == []
    assert outline.tags.count('details') == 3
    for expected in (
        '2 recordings, 0 of 3 formulas pass (1 error, 1 false, 1 undecided), 1 not checked',
        'b.mcap: broken',
        '"/a".p = 5.0 at 0.500 s is not < 5',
        'an obligation was not met; what remains: eventually ("/a".p > 50)',
        'does not pass',
    ):
        assert expected in outline.text
    # The script of plotly is within the page, and no element loads anything.
    assert 'plotly.js v' in text
    assert not re.findall(
        r'<(?:script|link|img|iframe)[^>]+(?:src|href)=', text.replace(plotly(), '')
    )
    data = data_of(text)
    assert len(data['formulas']) == 3
    assert data['signals'][0]['v'] == [*range(9)]
    assert data['signals'][0]['t'][-1] == 0.8


def test_a_page_names_its_recording_and_has_what_fails_first() -> None:
    text = page(checked('always "/a".p < 50', 'always "/a".p < 5', values=[*range(9)]))
    assert '<title>(1) ' in text
    assert text.index('always (&quot;/a&quot;.p &lt; 5)') < text.index('&lt; 50)')


def test_a_formula_is_shown_with_its_units() -> None:
    assert formula_text('let X: "m" in (always (X > 0.3 "m"))') == 'always (X > 0.3 m)'
    assert formula_text('always') == 'always'


def test_an_axis_has_the_unit_of_its_feature() -> None:
    (report,) = fleet(2)
    (formula,) = report.formulas
    found, _ = panels(replace(formula, units={'P': 'W'}))
    assert [(each.unit, each.thresholds[0].text) for each in found] == [('W', '< 5 W')] * 2
    found, _ = panels(formula)
    assert [(each.unit, each.thresholds[0].text) for each in found] == [('', '< 5')] * 2


def plotly() -> str:
    from dyknow_recordings.reporting.pictures.page import plotly_script  # noqa: PLC0415

    return plotly_script()


def test_all_texts_are_escaped() -> None:
    report = checked('always "/a".p < 5', values=[*range(9)], name=HOSTILE)
    (formula,) = report.formulas
    violation = Violation(HOSTILE, HOSTILE, at(0.1), at(0.2), 1, 1, HOSTILE)
    hostile = RecordingReport(
        HOSTILE,
        report.start_time,
        report.end_time,
        (
            FormulaReport(
                HOSTILE,
                formula.formula,
                (
                    Episode(at(0), Verdict.FALSE, at(0.5), HOSTILE),
                    Episode(at(1), error=RecordingError(HOSTILE)),
                ),
                RecordingError(HOSTILE),
                9,
                (),
                (violation,),
                (StateGap(at(0.2), None),),
                (HOSTILE,),
                HOSTILE,
                formula.signals,
            ),
            FormulaReport(HOSTILE, HOSTILE, error=RecordingError(HOSTILE)),
        ),
        (HOSTILE,),
    )
    text = page(hostile, unread=(HOSTILE,))
    outline = Outline(text)
    assert outline.text.count(HOSTILE) >= 12
    assert outline.tags.count('script') == 3
    assert '<script>alert' not in text


def test_hostile_names_of_signals_and_texts_in_the_data() -> None:
    topic = '/</script><script>alert(1)</script>'
    samples = [sample(topic, n / 10, state='</script><img src=x>') for n in range(3)]
    requested = [RequestedFormula(f'always "{topic}".state = "up"')]
    report = evaluate_recording(recording(samples), requested, keep_signals=True)
    text = page(report)
    assert Outline(text).open == []
    assert Outline(text).tags.count('img') == 0
    (signal,) = data_of(text)['signals']
    assert signal['name'].count('&lt;') == 3
    assert signal['words'] == ['&lt;/script&gt;&lt;img src=x&gt;']


def test_a_recording_without_states() -> None:
    report = checked('always "/b".p < 5', values=[1.0, float('nan')])
    assert 'the recording has no topic /b' in Outline(page(report)).text


def test_values_that_json_cannot_hold() -> None:
    report = checked('"/a".p < 5', values=[1.0, float('nan'), float('inf')])
    assert data_of(page(report))['signals'][0]['v'] == [1, None, None]


def test_stamps_far_from_the_log_times() -> None:
    samples = [sample('/a', n / 10, delay=-1e8, p=1.0) for n in range(5)]
    report = evaluate_recording(
        recording(samples), [RequestedFormula('always "/a".p < 5')], keep_signals=True
    )
    whole = extent(report)
    assert whole.end - whole.start < 10 * SECOND_NS


@pytest.mark.parametrize(
    ('seconds', 'ticks', 'unit'),
    [(1e-8, 1, 's'), (4.5, 5, 's'), (31, 4, 's'), (400, 4, 'min'), (86_400, 5, 'h')],
)
def test_ticks(seconds: float, ticks: int, unit: str) -> None:
    whole = Span(0, round(seconds * SECOND_NS))
    assert whole.unit == unit
    assert ticks <= len(whole.ticks) <= 6
    assert all(0 <= each <= whole.end for each in whole.ticks)


def test_an_image() -> None:
    (many,) = fleet(9)
    report = checked('always "/a".p < 5', 'always', values=[*range(9)], name='costs $5 or $6_x')
    every = checked(
        'eventually[0 s, 200 ms] "/a".p > 5',
        values=[*range(9)],
        start=EpisodeStart(every=Every.STATE),
    )
    image = report_image([many, report, every], Judgement.AUTO)
    assert image.startswith(b'\x89PNG\r\n\x1a\n')
    assert report_image([], Judgement.AUTO)


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    number: Any = STORE.types['std_msgs/msg/Float64']
    write_messages(tmp_path / 'flight', [(at(n), '/h', number(float(n))) for n in range(10)])
    return tmp_path / 'flight'


def test_the_options_of_the_command(trace: Path, tmp_path: Path) -> None:
    html, png = tmp_path / 'a.html', tmp_path / 'a.png'
    arguments = [str(trace), '--formula', 'always "/h".data < 5', '--html', str(html)]
    assert main([*arguments, '--png', str(png)]) == 1
    assert '"/h".data = 5.0' in Outline(html.read_text()).text
    assert png.stat().st_size > 0
    # A recording that cannot be read is on the page too.
    (tmp_path / 'broken.mcap').write_text('no recording')
    assert main([str(tmp_path / 'broken.mcap'), *arguments]) == 2
    assert 'broken.mcap' in Outline(html.read_text()).text


@pytest.mark.parametrize('option', ['--html', '--png', '--junit'])
def test_a_full_disk_leaves_the_old_file(
    option: str,
    trace: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    path = tmp_path / 'report'
    path.write_text('old')
    monkeypatch.setattr(os, 'fsync', fail)
    assert main([str(trace), '--formula', 'always "/h".data < 5', option, str(path)]) == 2
    assert f'{path}: cannot be written: No space left on device' in capsys.readouterr().err
    assert path.read_text() == 'old'
    assert list(tmp_path.glob('report*')) == [path]


@pytest.mark.parametrize(('option', 'library'), [('--html', 'plotly'), ('--png', 'matplotlib')])
def test_a_missing_library_is_named_before_the_work(
    option: str,
    library: str,
    trace: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert main([str(trace), '--formula', 'always "/h".data < 5', option, str(tmp_path / 'x')]) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    assert f'{option} needs {library}' in captured.err
    assert f'pip install {library}' in captured.err


def test_topics_are_not_drawn(trace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(trace), '--topics', '--png', 'x.png']) == 2
    assert 'leave out --html, --png and --geojson' in capsys.readouterr().err


def test_files_that_cannot_be_written(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, 'is a folder'), (tmp_path / 'x' / 'y', 'there is no folder')):
        with pytest.raises(DyKnowError, match=reason):
            PictureFiles(path, None, Judgement.AUTO)
    with pytest.raises(DyKnowError, match='cannot be written'):
        PictureFiles(Path('/proc/none.html'), None, Judgement.AUTO).close(())


def test_what_an_interruption_leaves_unchecked_is_on_the_page(tmp_path: Path) -> None:
    pictures = PictureFiles(tmp_path / 'a.html', None, Judgement.AUTO)
    pictures.close(('b.mcap',))
    assert 'b.mcap: not checked: interrupted' in Outline((tmp_path / 'a.html').read_text()).text
