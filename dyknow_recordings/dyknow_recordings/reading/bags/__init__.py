"""Bags of rosbag2: their files, and the messages in these in the order of their log times."""
