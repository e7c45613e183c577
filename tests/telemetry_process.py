"""Publish batteries until standard input ends; each line of it is the power of some, in JSON."""

from __future__ import annotations

import json
import os
import sys
from contextlib import closing
from threading import Thread

from system import Batteries, Client


def main(vehicles: tuple[str, ...]) -> None:
    """Publish the batteries of vehicles."""
    with closing(Client({'ROS_DOMAIN_ID': os.environ['ROS_DOMAIN_ID']})) as client:
        batteries = Batteries(client, vehicles)

        def listen() -> None:
            for line in sys.stdin:
                batteries.power.update(json.loads(line))

        listening = Thread(target=listen, daemon=True)
        listening.start()
        client.spin_until(lambda: not listening.is_alive(), 'the end', float('inf'))


if __name__ == '__main__':
    main(tuple(sys.argv[1:]))
