"""The ROS layer of triggers: messages, services, actions and commands."""

from dyknow_reactions.ros.triggers.targets import (
    TargetFault,
    find_target_faults,
    observe_target_faults,
)
from dyknow_reactions.ros.triggers.triggers import Triggers, check_triggers

__all__ = [
    'TargetFault',
    'Triggers',
    'check_triggers',
    'find_target_faults',
    'observe_target_faults',
]
