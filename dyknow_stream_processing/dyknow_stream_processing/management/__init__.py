"""Registry of streams and their placement on engines, without ROS."""
