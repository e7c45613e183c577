"""What touches ROS: the node that answers whether formulas hold, and FormulaClient to ask it."""

from dyknow_coordinator.ros.formula_client import FormulaClient, Monitor
from dyknow_coordinator.ros.plan_monitor import PlanMonitor

__all__ = ['FormulaClient', 'Monitor', 'PlanMonitor']
