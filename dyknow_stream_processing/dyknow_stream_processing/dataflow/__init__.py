"""Execution of streams: operators over samples, without ROS."""
