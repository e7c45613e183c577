"""Behaviours of py_trees over formulas: copy this module into your package, and change it freely.

- `FormulaGuard` runs its child while formulas hold.
- `FormulaHolds` is a condition: a formula that is asked at every state.
- `WaitForVerdict` waits until a formula is decided.

The node comes with `setup`, as in py_trees_ros: `tree.setup(node=node)`. Something else spins it.
No method waits: what the coordinator answers is noticed at the next tick.
"""

from pathlib import Path

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

from dyknow_common import ExitCode, Verdict
from dyknow_configuration import read_robot
from dyknow_coordinator.ros import FormulaClient


def named_formulas(robot_yaml):
    """Return the texts of the formulas of a robot.yaml, by their names."""
    return {each.name: each.closed_text for each in read_robot(Path(robot_yaml)).formulas}


class FormulaRun:
    """One evaluation of a formula, from now on.

    Args:
        client: the FormulaClient.
        name: that operators see; it is also the name of the topic with its verdicts.
        formula: in the formula language.
        options: of `FormulaClient.monitor`.
        retries: evaluate the formula anew after an interruption, such as a violation.
    """

    def __init__(self, client, name, formula, options, *, retries=False):
        self.name = name
        self.progress = None
        self.interruption = None
        self._monitor = client.monitor(
            formula,
            name=name,
            on_feedback=self._on_feedback,
            on_interruption=self._on_interruption if retries else None,
            **options,
        )

    @property
    def answer(self):
        """The Answer; None until there is one."""
        return self._monitor.outcome.result() if self._monitor.outcome.done() else None

    @property
    def has_states(self):
        """True if states have come."""
        return self.progress is not None and self.progress.states_progressed > 0

    @property
    def waits_for(self):
        """The reason why no states come; empty if they come, or if none is known."""
        return self.progress.waits_for if self.progress is not None else ''

    def cancel(self):
        """End the evaluation, if it has not ended."""
        self._monitor.cancel()

    def _on_feedback(self, progress):
        self.progress, self.interruption = progress, None

    def _on_interruption(self, answer):
        self.progress, self.interruption = None, answer


class FormulaBehaviour:
    """Base of behaviours over formulas: a client from `setup` to `shutdown`."""

    client = None

    def setup(self, **kwargs):
        """Create the client; the node is the keyword argument `node`."""
        if 'node' not in kwargs:
            raise KeyError(f'{self.qualified_name} needs a node: call setup(node=...)')
        self.shutdown()
        self.client = FormulaClient(kwargs['node'])

    def shutdown(self):
        """Cancel all evaluations, and destroy the client."""
        if self.client is not None:
            self.client.close()
            self.client = None


class WaitForVerdict(FormulaBehaviour, Behaviour):
    """Evaluates a formula from the first tick on.

    RUNNING: it is undecided. SUCCESS: it is true. FAILURE: it is false, or there is no verdict; the
    feedback message has the explanation or the error. The evaluation is cancelled if the behaviour
    is interrupted.

    Args:
        name: of the behaviour and of the formula.
        formula: in the formula language.
        options: of `FormulaClient.monitor`, such as `timeout` in seconds.
    """

    def __init__(self, name, formula, **options):
        super().__init__(name)
        self.formula = formula
        self.options = options
        self._run = None

    def initialise(self):
        """Request the evaluation."""
        self._run = FormulaRun(self.client, self.name, self.formula, self.options)

    def update(self):
        """Return how the formula stands."""
        answer = self._run.answer
        if answer is None:
            self.feedback_message = self._run.waits_for or 'undecided'
            return Status.RUNNING
        self.feedback_message = str(answer.error or answer.explanation)
        return Status.SUCCESS if answer.verdict is Verdict.TRUE else Status.FAILURE

    def terminate(self, new_status):
        """Cancel the evaluation if it has not ended."""
        del new_status
        if self._run is not None:
            self._run.cancel()


class FormulaHolds(FormulaBehaviour, Behaviour):
    """A condition: a formula that is asked at every state, from `setup` to `shutdown`.

    RUNNING: no state has come yet. SUCCESS: it has not been violated, or holds again. FAILURE: it
    is violated, or it is unknown whether it holds: a stream broke its constraints, no states come,
    the coordinator is missing. It is evaluated anew as soon as it can be.

    Args:
        name: of the behaviour and of the formula.
        formula: in the formula language, mostly without `always`: `Power[uav1] < 200`.
        options: of `FormulaClient.monitor`.
    """

    def __init__(self, name, formula, **options):
        super().__init__(name)
        self.formula = formula
        self.options = {**options, 'every_state': True}
        self._run = None

    def setup(self, **kwargs):
        """Create the client, and request the evaluation."""
        super().setup(**kwargs)
        self._start()

    def update(self):
        """Return how the formula stands."""
        answer, interruption = self._run.answer, self._run.interruption
        if answer is not None or interruption is not None:
            error = (answer or interruption).error
            self.feedback_message = str(error or answer.explanation)
            if answer is not None and (error is None or error.code is ExitCode.TIMEOUT):
                # Its time, a day by default, is over.
                self._start()
            return Status.FAILURE
        if not self._run.has_states:
            self.feedback_message = self._run.waits_for or 'no state has come yet'
            return Status.RUNNING
        if self._run.waits_for:
            self.feedback_message = f'unknown: {self._run.waits_for}'
            return Status.FAILURE
        episodes = self._run.progress.episodes
        if episodes.is_violated:
            self.feedback_message = episodes.latest_episodes[-1].text
            return Status.FAILURE
        self.feedback_message = episodes.text
        return Status.SUCCESS

    def _start(self):
        self._run = FormulaRun(self.client, self.name, self.formula, self.options, retries=True)


class FormulaGuard(FormulaBehaviour, Decorator):
    """Runs its child while formulas hold, which are evaluated from the first tick on.

    The child is not ticked before the states of all formulas come. As soon as a formula is false,
    or it is unknown whether it holds (there is an error, or no more states come), the child is
    interrupted (INVALID), and the status is FAILURE. The feedback message has the explanation.
    Otherwise, it has the status of the child. A formula that is true is not evaluated again.

    Args:
        name: of the behaviour.
        child: that it runs.
        formulas: the formulas by their names.
        options: of `FormulaClient.monitor`.
    """

    def __init__(self, name, child, formulas, **options):
        super().__init__(name, child)
        self.formulas = dict(formulas)
        self.options = options
        self._runs = []

    def initialise(self):
        """Request the evaluations."""
        self._runs = [
            FormulaRun(self.client, name, formula, self.options)
            for name, formula in self.formulas.items()
        ]

    def tick(self):
        """Tick the child if all formulas hold."""
        if self.status is not Status.RUNNING:
            self.initialise()
            self.status = Status.RUNNING
        if fault := next(filter(None, map(_fault, self._runs)), ''):
            self.feedback_message = fault
            self.stop(Status.FAILURE)
            yield self
        elif waiting := [each for each in self._runs if not _may_hold(each)]:
            reason = waiting[0].waits_for or 'no state has come yet'
            self.feedback_message = f'{waiting[0].name}: {reason}'
            yield self
        else:
            yield from super().tick()

    def update(self):
        """Return the status of the child."""
        self.feedback_message = self.decorated.feedback_message
        return self.decorated.status

    def terminate(self, new_status):
        """Cancel the evaluations that have not ended."""
        del new_status
        for each in self._runs:
            each.cancel()


def _fault(run):
    """Return why a formula does not hold, or is not known to hold; empty otherwise."""
    if run.answer is not None and run.answer.verdict is not Verdict.TRUE:
        return f'{run.name}: {run.answer.error or run.answer.explanation}'
    if run.answer is None and run.has_states and run.waits_for:
        return f'{run.name}: {run.waits_for}'
    return ''


def _may_hold(run):
    return run.has_states or run.answer is not None
