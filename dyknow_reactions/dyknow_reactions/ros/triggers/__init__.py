"""The ROS layer of triggers: messages, services, actions and commands."""

from dyknow_reactions.ros.triggers.triggers import Triggers, check_triggers

__all__ = ['Triggers', 'check_triggers']
