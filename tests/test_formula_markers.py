"""Markers of formulas, as a three-dimensional view receives them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from nav_msgs.msg import Odometry
from visualization_msgs.msg import Marker, MarkerArray

from commands import command, started
from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    SymbolGrounding,
)
from reporter import Reporter
from system import LIMIT

MARKERS = '/formula_markers/markers'
PLACES = {'uav1': 0.0, 'uav2': 20.0}


class View:
    """Two vehicles, a coordinator, the node that publishes markers, and the received markers.

    Args:
        folder: for the output of the node.
    """

    def __init__(self, folder: Path) -> None:
        self.log = folder / 'formula_markers.log'
        self.reporter = Reporter()
        self.node = self.reporter.client.node
        self.received: list[Any] = []
        self.frames = dict.fromkeys(PLACES, 'map')
        self._publishers = {
            vehicle: self.node.create_publisher(Odometry, f'/{vehicle}/odometry', 10)
            for vehicle in PLACES
        }
        self.node.create_timer(0.05, self._publish)
        with self.log.open('wb') as log:
            self._drawing = started(
                command('formula_markers'), self.reporter.environment, stdout=log
            )

    def close(self) -> None:
        self._drawing.terminate()
        code = self._drawing.wait(LIMIT)
        self.reporter.close()
        assert code == 0

    def stop(self, vehicle: str) -> None:
        """Publish no more odometry of a vehicle."""
        del self._publishers[vehicle]

    def subscribe(self) -> None:
        """Subscribe to the markers."""
        self.node.create_subscription(MarkerArray, MARKERS, self.received.append, 10)

    def separation(self) -> EvaluationStatus:
        """Return the status of a formula about the two vehicles."""
        return EvaluationStatus(
            'separation',
            'always (XYDist[uav2, uav1] > 10)',
            EvaluationPhase.RUNNING,
            started=self.reporter.now() + 3600 * 10**9,
            latest_valid_time=self.reporter.now() + 3600 * 10**9,
            groundings=(SymbolGrounding('XYDist[uav2, uav1]', Grounding.SEMANTIC, 's'),),
        )

    def until_drawn(self, colours: list[tuple[float, float, float]]) -> list[Any]:
        """Wait for lines of some colours, and return all markers."""

        def drawn() -> bool:
            return bool(self.received) and colours == [
                (round(each.color.r, 1), round(each.color.g, 1), round(each.color.b, 1))
                for each in self.received[-1].markers
                if each.type == Marker.LINE_LIST
            ]

        self.reporter.until(drawn, f'lines in {colours}: {self.received[-1:]}')
        return list(self.received[-1].markers)

    def _publish(self) -> None:
        for vehicle, publisher in self._publishers.items():
            message = Odometry()
            message.header.frame_id = self.frames[vehicle]
            message.pose.pose.position.x = PLACES[vehicle]
            publisher.publish(message)


GREEN, YELLOW, RED = (0.1, 0.8, 0.2), (1.0, 0.8, 0.0), (1.0, 0.1, 0.1)


@pytest.fixture
def view(tmp_path: Path) -> Iterator[View]:
    seen = View(tmp_path)
    yield seen
    seen.close()


def test_a_line_between_vehicles_follows_the_verdict(view: View) -> None:
    running = view.separation()
    view.reporter.tell(running)
    view.subscribe()
    markers = view.until_drawn([GREEN])
    assert [each.type for each in markers] == [Marker.LINE_LIST, Marker.TEXT_VIEW_FACING]
    assert {each.header.frame_id for each in markers} == {'map'}
    assert {each.ns for each in markers} == {'separation'}
    assert all(each.lifetime.sec > 0 and each.action == Marker.ADD for each in markers)
    assert sorted(point.x for point in markers[0].points) == [0.0, 20.0]
    assert 'separation: undecided' in markers[1].text
    view.reporter.tell(replace(running, presumably_false=True))
    view.until_drawn([YELLOW])
    view.reporter.tell(
        replace(
            running,
            phase=EvaluationPhase.ENDED,
            verdict=Verdict.FALSE,
            explanation='XYDist[uav2, uav1] = 9.0 is not > 10',
        )
    )
    markers = view.until_drawn([RED])
    assert 'false: XYDist[uav2, uav1] = 9.0 is not > 10' in markers[1].text
    cancelled = CoordinationError('cancelled', ExitCode.CANCELLED)
    view.reporter.tell(replace(running, phase=EvaluationPhase.ENDED, error=cancelled))
    view.until_drawn([])


def test_evaluations_of_a_coordinator_without_heartbeats_are_not_drawn(view: View) -> None:
    view.reporter.tell(view.separation())
    view.subscribe()
    view.until_drawn([GREEN])
    view.reporter.announce()
    view.reporter.client.spin_until(
        lambda: not any(view.node.count_subscribers(f'/{each}/odometry') for each in PLACES),
        'the node subscribes to no vehicle',
    )


def test_a_vehicle_without_odometry_is_not_drawn_any_more(view: View) -> None:
    view.reporter.tell(view.separation())
    view.subscribe()
    view.until_drawn([GREEN])
    view.stop('uav2')
    view.until_drawn([])


def test_a_fence_lies_around_the_vehicles(view: View) -> None:
    fence = replace(
        view.separation(),
        name='fence',
        formula='forall u in UAV: (always (East[u] < 60))',
        groundings=tuple(
            SymbolGrounding(f'East[{vehicle}]', Grounding.SEMANTIC, 's') for vehicle in PLACES
        ),
    )
    view.reporter.tell(fence)
    view.subscribe()

    def box() -> Any:
        cubes = (
            [m for m in view.received[-1].markers if m.type == Marker.CUBE] if view.received else []
        )
        return cubes[0] if cubes else None

    # Before the odometry of both is received, the open side in the west is elsewhere.
    view.reporter.until(lambda: box() is not None and box().scale.x == 70.0, 'the fence')
    assert box().pose.position.x == 25.0
    assert 0 < box().color.a < 1


def test_odometry_has_subscribers_only_while_markers_have(view: View) -> None:
    view.reporter.tell(view.separation())

    def listeners() -> int:
        return int(view.node.count_subscribers('/uav1/odometry'))

    view.reporter.until(lambda: view.node.count_publishers(MARKERS) == 1, 'the node is up')
    assert listeners() == 0
    view.subscribe()
    view.until_drawn([GREEN])
    assert listeners() == 1
    view.reporter.tell()
    view.reporter.until(lambda: listeners() == 0, 'no subscription to the vehicle')


def test_a_vehicle_in_another_frame_is_not_drawn(view: View) -> None:
    view.frames['uav2'] = 'odom'
    view.reporter.tell(view.separation())
    view.subscribe()
    warning = 'is not shown: its odometry is in the frame'
    view.reporter.until(lambda: warning in view.log.read_text(encoding='utf-8'), 'the warning')
    view.until_drawn([])
