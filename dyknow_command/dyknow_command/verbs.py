"""The verbs of the command `dyknow`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb of `dyknow`. Its module is imported only if it is chosen: most need ROS.

    Args:
        module: has the function `add_<verb>_options`.
        description: the description for the help.
        needs_ros: True if it needs rclpy.
    """

    module: str
    description: str
    needs_ros: bool = True

    @property
    def is_installed(self) -> bool:
        """False if only what needs no ROS is installed, and this is something else."""
        try:
            return find_spec(self.module.rpartition('.')[0]) is not None
        except ModuleNotFoundError:  # The package that contains it is missing, too.
            return False


VERBS: Final[Mapping[str, Verb]] = {
    'up': Verb('dyknow_bringup.ros.up', 'start the nodes'),
    'evaluate': Verb('dyknow_bringup.ros.evaluate', 'evaluate a formula with the running system'),
    'monitor': Verb('dyknow_bringup.ros.monitor', 'monitor the formulas of a robot.yaml'),
    'guard': Verb('dyknow_reactions.ros.guard.guard', 'pass messages on while formulas hold'),
    'evaluations': Verb('dyknow_coordinator.ros.evaluations', 'show what is being evaluated'),
    'streams': Verb('dyknow_stream_processing.ros.streams', 'show the streams and their timing'),
    'semantics': Verb('dyknow_semantics.ros.semantics', 'show ontologies and what streams mean'),
    'federation': Verb(
        'dyknow_federation.ros.federation_command', 'show the peers of a host and what they share'
    ),
    'dashboard': Verb('dyknow_dashboard.ros.dashboard', 'serve a live page of a running system'),
    'check': Verb(
        'dyknow_recordings.check', 'check formulas over recordings, without ROS', needs_ros=False
    ),
    'calibrate': Verb(
        'dyknow_recordings.calibrate',
        'compare forecasts with recordings, and widen them',
        needs_ros=False,
    ),
    'cut': Verb('dyknow_recordings.cut', 'cut a recording around failures', needs_ros=False),
    'init': Verb(
        'dyknow_command.init', 'propose a robot.yaml for a robot or a recording', needs_ros=False
    ),
    'suggest': Verb(
        'dyknow_command.suggest', 'measure the timing that a topic keeps', needs_ros=False
    ),
    'recipes': Verb(
        'dyknow_command.recipes', 'search formulas for robots, and add them', needs_ros=False
    ),
    'lint': Verb('dyknow_command.lint', 'check files without running them', needs_ros=False),
    'replay': Verb('dyknow_bringup.ros.replay', 'publish a recording on its topics'),
    'parse': Verb(
        'dyknow_command.parse', 'check a text, and print its canonical form', needs_ros=False
    ),
    'demo': Verb('dyknow_bringup.ros.uav_demo', 'monitor a simulated fleet'),
    'policy': Verb(
        'dyknow_bringup.ros.policy', 'print the SROS2 policy of a system', needs_ros=False
    ),
    'version': Verb('dyknow_command.version', 'print the version', needs_ros=False),
}
