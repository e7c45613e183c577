"""A behaviour tree for the rover of examples/rover: deliver while it is safe, or else stop.

    python3 examples/behaviour_trees/deliver.py examples/rover/robot.yaml

Exit code 0: the rover has arrived; 1: it was stopped, and the tree says why.
"""

import sys
from contextlib import suppress

import rclpy
from formula_behaviours import FormulaGuard, WaitForVerdict, named_formulas
from py_trees.behaviours import Success
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.decorators import SuccessIsFailure
from py_trees.display import unicode_tree
from py_trees.trees import BehaviourTree
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dyknow_common.executables import interruptible

TICK_S = 0.1


def delivery(formulas):
    """Return the tree.

    The fake rover drives by itself. On a real one, the child of the guard is the behaviour that
    drives, such as an action client of Nav2, and `stop` stops it.
    """
    arrive = WaitForVerdict('arrives', formulas['arrives'])
    must_hold = {name: formulas[name] for name in ('distance', 'parts')}
    return Selector(
        'deliver or stop',
        memory=False,
        children=[
            FormulaGuard('safely', arrive, must_hold),
            SuccessIsFailure('failed', Success('stop')),
        ],
    )


class TreeNode(Node):
    """Ticks a tree until it has succeeded or failed."""

    def __init__(self, tree):
        super().__init__('delivery')
        self._tree = tree
        self._shown = ''
        tree.setup(node=self)
        self.create_timer(TICK_S, self._tick)

    @property
    def is_done(self):
        """True if the tree has succeeded or failed."""
        return self._tree.root.status in {Status.SUCCESS, Status.FAILURE}

    def _tick(self):
        if self.is_done:
            return
        self._tree.tick()
        shown = unicode_tree(self._tree.root, show_status=True)
        if shown != self._shown:
            self._shown = shown
            print(shown, flush=True)


def main():
    """Run the tree."""
    _, robot_yaml = sys.argv
    tree = BehaviourTree(delivery(named_formulas(robot_yaml)))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with suppress(KeyboardInterrupt), interruptible():
            node = TreeNode(tree)
            while not node.is_done:
                rclpy.spin_once(node)
    finally:
        tree.shutdown()
        rclpy.try_shutdown()
    return 0 if tree.root.status is Status.SUCCESS else 1


if __name__ == '__main__':
    sys.exit(main())
