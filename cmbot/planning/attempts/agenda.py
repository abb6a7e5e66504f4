"""The agenda: one search over attempts, the cheapest first, for all that is tried again or tried better."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Generic, TypeVar

from cmbot.planning.attempts.failure import Failure
from cmbot.planning.budget import Budget, Deadline

# Trials for each run of the budget at most: what is refused before it is run takes none, but some time.
_MAX_TRIALS_PER_RUN = 4

A = TypeVar("A")
S = TypeVar("S")


@dataclass(frozen=True, kw_only=True)
class Solved(Generic[S]):
    """What an attempt made."""

    result: S


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial(Generic[A, S]):
    """An attempt that was run, and how it ended.

    Attributes
    ----------
    attempt : A
    outcome : Solved or Failure
    remedy : Remedy, optional
        What proposed it; None of the first attempt.
    parent : Trial, optional
        The trial that it was proposed for.
    """

    attempt: A
    outcome: Solved[S] | Failure
    remedy: Remedy[A, Any] | None = None
    parent: Trial[A, Any] | None = None

    @property
    def result(self) -> S:
        """What a success made."""
        if not isinstance(self.outcome, Solved):
            raise TypeError("a trial that failed has no result")
        return self.outcome.result

    @property
    def failure(self) -> Failure:
        """Why it failed."""
        if isinstance(self.outcome, Solved):
            raise TypeError("a trial that succeeded has no failure")
        return self.outcome

    @property
    def chain(self) -> tuple[Trial[A, Any], ...]:
        """The trials that led here, the first one first, this one last."""
        return (self,) if self.parent is None else (*self.parent.chain, self)

    @property
    def told(self) -> tuple[str, ...]:
        """What failed before it, and what was done instead, a sentence each."""
        sentences, topic = list[str](), ""
        for trial in self.chain:
            if trial.parent is None or trial.remedy is None:
                continue
            if topic and trial.remedy.topic == topic:
                sentences.pop()
            topic = trial.remedy.topic
            sentences.append(trial.remedy.tell(trial.parent, trial))
        return tuple(filter(None, sentences))

    def uses(self, remedy: Remedy[A, Any]) -> int:
        """How often a remedy proposed one of the trials of this search that led here."""
        before = 0 if self.parent is None or self.remedy is None else self.parent.uses(remedy)
        return before + (self.remedy is remedy)


@dataclass(frozen=True, kw_only=True, eq=False)
class Remedy(Generic[A, S]):
    """What to try after a trial: instead of one that failed, or better than one that succeeded.

    Attributes
    ----------
    cost : int
        Of each of its attempts, beside that of the trial before.
    propose : callable
        From a trial to attempts, in the order in which they are to be tried; none where it is no remedy.
    tell : callable
        From the trial before and its own to a sentence.
    topic : str
        Of sentences on one topic, one behind the other, only the last is told.
    most : int
        Uses of it at most on the way to a trial.
    replaces : bool
        It takes back a choice of the planner's own: where it fails, too, that is what is told.
    """

    cost: int
    propose: Callable[[Trial[A, S]], Iterator[A]]
    tell: Callable[[Trial[A, S], Trial[A, S]], str] = lambda before, after: ""
    topic: str = ""
    most: int = 1
    replaces: bool = False

    def where(self, applies: Callable[[Trial[A, S]], bool]) -> Remedy[A, S]:
        """Return the same remedy for some trials alone."""
        propose = self.propose
        return replace(self, propose=lambda trial: propose(trial) if applies(trial) else iter(()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Agenda(Generic[A, S]):
    """A search over attempts.

    The first attempt is run. Each trial puts on the agenda what its remedies propose; the least sum of costs
    comes next, and of equal ones what was proposed first. What has the key of an earlier attempt is not run
    again. After the first success only what may be better than the best so far is left on the agenda, and
    what fails then has no remedies. The search ends where nothing is left, the budget is spent, or the
    deadline is over.

    Attributes
    ----------
    work : callable
        From an attempt to what it makes, or why it fails.
    key : callable
        From an attempt to what tells it from others.
    remedies : sequence of Remedy
    budget : Budget
        Each run of `work` takes one.
    deadline : Deadline
        The first attempt is run in any case.
    better : callable
        Whether a result is better than another one; by default none is.
    refused : callable
        From an attempt to the failure that is known before it is run; such a trial takes no run.
    """

    work: Callable[[A], Solved[S] | Failure]
    key: Callable[[A], Hashable]
    remedies: Sequence[Remedy[A, S]]
    budget: Budget
    deadline: Deadline
    better: Callable[[S, S], bool] = lambda result, best: False
    refused: Callable[[A], Failure | None] = lambda attempt: None

    def search(self, first: A, parent: Trial[A, Any] | None = None) -> Trial[A, S]:
        """Return the best trial that succeeded; where none did, the one whose failure is to be told.

        Parameters
        ----------
        first : A
        parent : Trial, optional
            A trial of another search that led to it.
        """
        return self.search_from(self._run(first, None, parent))

    def search_from(self, first: Trial[A, S]) -> Trial[A, S]:
        """Return what `search` does, from a trial on that was run."""
        best, seen, order, trials = first, {self.key(first.attempt)}, count(), 1
        waiting: list[_Waiting[A, S]] = []

        def propose(trial: Trial[A, S], cost: int) -> None:
            for remedy in self.remedies:
                if trial.uses(remedy) < remedy.most:
                    attempts = remedy.propose(trial)
                    heapq.heappush(
                        waiting, _Waiting(cost + remedy.cost, next(order), trial, remedy, attempts)
                    )

        propose(first, 0)
        while (
            waiting
            and self.budget.left > 0
            and trials < _MAX_TRIALS_PER_RUN * self.budget.runs
            and not self.deadline.expired()
        ):
            item = heapq.heappop(waiting)
            attempt = next(item.attempts, None)
            if attempt is None:
                continue
            heapq.heappush(waiting, item)
            key = self.key(attempt)
            if key in seen:
                continue
            seen.add(key)
            trials += 1
            trial = self._run(attempt, item.remedy, item.trial)
            if self._is_better(trial, best):
                best = trial
                if isinstance(trial.outcome, Solved):
                    waiting.clear()
            if not isinstance(best.outcome, Solved) or trial is best:
                propose(trial, item.cost)
        return best

    def _run(self, attempt: A, remedy: Remedy[A, S] | None, parent: Trial[A, Any] | None) -> Trial[A, S]:
        """Run an attempt, unless it is refused."""
        refused = self.refused(attempt)
        if refused is not None:
            return Trial(attempt=attempt, outcome=refused, remedy=remedy, parent=parent)
        self.budget.take()
        return Trial(attempt=attempt, outcome=self.work(attempt), remedy=remedy, parent=parent)

    def _is_better(self, trial: Trial[A, S], best: Trial[A, S]) -> bool:
        """Whether a trial takes the place of the best one: of a failure, a success, or what is to be told."""
        after, before = trial.outcome, best.outcome
        if isinstance(after, Solved):
            return not isinstance(before, Solved) or self.better(after.result, before.result)
        replaces = trial.remedy is not None and trial.remedy.replaces
        return not isinstance(before, Solved) and replaces and trial.parent is best


@dataclass(frozen=True, order=True)
class _Waiting(Generic[A, S]):
    """Attempts of a remedy that are still to be tried."""

    cost: int
    order: int
    trial: Trial[A, S]
    remedy: Remedy[A, S]
    attempts: Iterator[A]
