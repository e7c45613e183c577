"""The ROS layer of the federation: its node, its streams, and the transport over zenoh."""
