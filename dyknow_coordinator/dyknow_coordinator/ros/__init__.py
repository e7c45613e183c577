"""ROS layer: the coordinator node, and FormulaClient to call it."""

from dyknow_coordinator.ros.client.formula_client import FormulaClient, Monitor
from dyknow_coordinator.ros.client.plan_monitor import PlanMonitor

__all__ = ['FormulaClient', 'Monitor', 'PlanMonitor']
