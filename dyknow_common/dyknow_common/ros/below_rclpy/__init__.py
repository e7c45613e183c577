"""Everything that reaches past the public API of rclpy, or below it.

| module | reason | holds for | otherwise |
|---|---|---|---|
| `executor` | a message costs the same in a large node | an rclpy with its parts | its executor |
| `senders` | nodes believe the owner of a topic alone | Fast DDS of Jazzy | they believe all |
| `direct_topics` | nodes of a process share objects | where senders are known | the middleware |
| `discovery` | processes find each other at once | Fast DDS 2 | within 3 s |
| `c_library` | a process that hangs ends | glibc of 64 bits | it ends only if Python can run |

Each module checks at the start of a process that it holds. The variable DYKNOW_BELOW_RCLPY=off
turns all of them off, for a comparison when a new version of ROS misbehaves.
"""
