"""Placement of streams on the engines of a ROS graph."""
