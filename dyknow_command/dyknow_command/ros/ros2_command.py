"""The command `ros2 dyknow`, with the verbs of `dyknow`; ros2cli finds it by its entry point."""

from __future__ import annotations

import argparse
from typing import Any

from ros2cli.command import CommandExtension

from dyknow_command import main


class DyKnowCommand(CommandExtension):
    """Monitor robots with temporal logic (see dyknow --help)."""

    def add_arguments(
        self, parser: argparse.ArgumentParser, _cli_name: str, *, argv: Any = None
    ) -> None:
        """Accept all arguments after `ros2 dyknow` without parsing them."""
        del argv
        parser.add_argument('arguments', nargs=argparse.REMAINDER, metavar='VERB ...')

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        """Run a verb; return its exit code."""
        del parser
        return main(args.arguments)
