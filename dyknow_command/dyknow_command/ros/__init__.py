"""What extends the commands of ROS 2."""
