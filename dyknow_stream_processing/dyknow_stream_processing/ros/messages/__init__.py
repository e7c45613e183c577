"""Conversion between ROS messages and samples."""
