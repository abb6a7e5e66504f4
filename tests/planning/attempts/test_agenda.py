"""The agenda at its door: attempts are numbers, and what they make is given."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
from hypothesis import given, strategies as st

from cmbot.common.errors import PathNotFound
from cmbot.planning.attempts.agenda import Agenda, Remedy, Solved, Trial
from cmbot.planning.attempts.failure import Failure, NoWay
from cmbot.planning.budget import Budget, Deadline

Numbers = Trial[int, int]


def failed(reason: str = "no") -> NoWay:
    return NoWay(error=PathNotFound(reason, time=0.0, progress=0.0, smallest_singular_value=1.0))


class Work:
    """Attempts that succeed, with what they make; all others fail."""

    def __init__(self, makes: Mapping[int, int]) -> None:
        self.makes, self.run = makes, list[int]()

    def __call__(self, attempt: int) -> Solved[int] | Failure:
        self.run.append(attempt)
        return Solved(result=self.makes[attempt]) if attempt in self.makes else failed(str(attempt))


def remedy(cost: int, *attempts: int, **own: Any) -> Remedy[int, int]:
    """A remedy of every failure."""

    def propose(trial: Numbers) -> Iterator[int]:
        return iter(() if isinstance(trial.outcome, Solved) else attempts)

    return Remedy(cost=cost, propose=propose, **own)


def improvement(step: int, cost: int = 1, **own: Any) -> Remedy[int, int]:
    """What may be better than a success."""

    def propose(trial: Numbers) -> Iterator[int]:
        return iter((trial.attempt + step,) if isinstance(trial.outcome, Solved) else ())

    return Remedy(cost=cost, propose=propose, **own)


def agenda(work: Callable[[int], Solved[int] | Failure], *remedies: Remedy[int, int], **own: Any) -> Agenda:
    given = {"key": lambda attempt: attempt, "budget": Budget(runs=12), "deadline": Deadline()} | own
    return Agenda(work=work, remedies=remedies, **given)


def test_a_first_attempt_that_succeeds_is_all() -> None:
    work = Work({0: 7})
    best = agenda(work, remedy(1, 1, 2)).search(0)
    assert (best.attempt, best.result, best.chain, best.told) == (0, 7, (best,), ())
    assert work.run == [0]


def test_the_cheapest_comes_next_and_what_it_leads_to_counts_with_it() -> None:
    """Each remedy alone before two of them, and of equal cost what was proposed first."""
    work = Work({})
    agenda(work, remedy(10, 10), remedy(11, 20, 21), remedy(1, 30)).search(0)
    # 30 costs 1, 10 costs 10, 20 and 21 cost 11, as does 10 after 30; that was run before.
    assert work.run == [0, 30, 10, 20, 21]


def test_what_has_the_key_of_an_earlier_attempt_is_not_run_again() -> None:
    work = Work({})
    agenda(work, remedy(1, 12, 22, 13), key=lambda attempt: attempt % 10, budget=Budget(runs=9)).search(2)
    assert work.run == [2, 13]


@given(
    proposals=st.lists(st.tuples(st.integers(1, 5), st.lists(st.integers(1, 50), max_size=9)), max_size=6),
    makes=st.dictionaries(st.integers(0, 50), st.integers(0, 9)),
    runs=st.integers(1, 12),
)
def test_no_more_than_the_budget_is_run_and_nothing_is_worse_than_without_the_agenda(
    proposals: list[tuple[int, list[int]]], makes: dict[int, int], runs: int
) -> None:
    def search(first: int) -> tuple[Numbers, list[int]]:
        work = Work(makes)
        remedies = [remedy(cost, *attempts, most=2) for cost, attempts in proposals]
        searched = agenda(
            work,
            *remedies,
            improvement(3, most=4),
            budget=budget,
            better=lambda result, best: result > best,
        )
        return searched.search(first), work.run

    budget = Budget(runs=runs)
    best, run = search(0)
    assert len(run) == budget.used <= runs
    assert len(set(run)) == len(run)
    results = [makes[attempt] for attempt in run if attempt in makes]
    if results:
        # The best of what was run, and so no worse than the first attempt alone.
        assert best.result == max(results)
    else:
        assert best.failure.error.reason == "0"
    budget = Budget(runs=runs)
    assert search(0)[1] == run


def test_after_a_success_only_what_may_be_better_is_tried() -> None:
    work = Work({1: 5, 4: 6})
    best = agenda(
        work, remedy(1, 1, 2, 3), improvement(3, most=2), better=lambda result, best: result > best
    ).search(0)
    # From 4 on 7 is tried, which fails and has no remedies.
    assert work.run == [0, 1, 4, 7]
    assert (best.attempt, best.result) == (4, 6)
    work = Work({1: 5, 4: 5})
    best = agenda(work, remedy(1, 1), improvement(3), better=lambda result, best: result > best).search(0)
    assert best.attempt == 1


def test_a_remedy_is_used_so_often_on_the_way_to_a_trial() -> None:
    def add(trial: Numbers) -> Iterator[int]:
        yield trial.attempt + 1

    for most in (1, 3):
        work = Work({})
        agenda(work, Remedy(cost=1, propose=add, most=most)).search(0)
        assert work.run == list(range(1 + most))


def test_proposals_are_made_when_their_turn_comes() -> None:
    """Guesses cost time: none is made after the success."""
    made = list[int]()

    def propose(trial: Numbers) -> Iterator[int]:
        for attempt in (1, 2, 3):
            made.append(attempt)
            yield attempt

    agenda(Work({2: 0}), Remedy(cost=1, propose=propose)).search(0)
    assert made == [1, 2]


def test_the_record_tells_what_led_to_a_trial() -> None:
    def tell(before: Numbers, after: Numbers) -> str:
        return f"{before.attempt} failed, {after.attempt} instead"

    work = Work({3: 9})
    best = agenda(work, remedy(1, 1, tell=tell), remedy(2, 2), remedy(4, 3, tell=tell)).search(0)
    assert [trial.attempt for trial in best.chain] in ([0, 3], [0, 1, 3], [0, 2, 3])
    assert best.told[-1].endswith("3 instead")
    # Of one topic only the last is told.
    stretch = Remedy(cost=1, propose=lambda trial: iter([trial.attempt + 1]), tell=tell, topic="time", most=9)
    assert agenda(Work({3: 9}), stretch).search(0).told == ("2 failed, 3 instead",)


def test_the_failure_that_is_told_is_the_first_or_that_of_a_choice_taken_back() -> None:
    assert agenda(Work({}), remedy(1, 1)).search(0).failure.error.reason == "0"
    assert agenda(Work({}), remedy(1, 1, replaces=True), remedy(2, 2)).search(0).failure.error.reason == "1"


def test_what_is_refused_takes_no_run_but_has_remedies() -> None:
    budget, work = Budget(runs=3), Work({5: 1})
    best = agenda(
        work,
        remedy(1, 1),
        remedy(2, 5),
        budget=budget,
        refused=lambda attempt: failed("leaps") if attempt == 1 else None,
    ).search(0)
    assert (best.result, work.run, budget.used) == (1, [0, 5], 2)


def test_a_search_goes_on_from_a_trial_of_another_one() -> None:
    first = agenda(Work({0: 1})).search(0)
    second = agenda(Work({8: 2}), remedy(1, 8)).search(7, parent=first)
    assert [trial.attempt for trial in second.chain] == [0, 7, 8]
    # A remedy of both searches is used anew.
    again = remedy(1, 8)
    first = agenda(Work({8: 1}), again).search(0)
    assert agenda(Work({8: 2}), again).search(7, parent=first).result == 2
    work = Work({8: 2})
    refused: Numbers = Trial(attempt=7, outcome=failed())
    assert agenda(work, remedy(1, 8)).search_from(refused).result == 2
    assert work.run == [8]


class Clock:
    """A clock that goes on with every attempt."""

    def __init__(self, step: float) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize(("step", "run", "mark"), [(0.0, [0, 1, 2, 3], None), (1.0, [0, 1, 2], "time")])
def test_the_deadline_stops_and_decides_nothing_else(step: float, run: list[int], mark: str | None) -> None:
    """What was run before is the same on a slower machine, and a plan that was stopped says so."""
    clock, plain = Clock(step), Work({1: 1, 2: 2, 3: 3})
    deadline = Deadline(2.5, clock)

    def work(attempt: int) -> Solved[int] | Failure:
        clock.now += clock.step
        return plain(attempt)

    best = agenda(
        work,
        remedy(1, 1),
        improvement(1, most=2),
        deadline=deadline,
        better=lambda result, best: result > best,
    ).search(0)
    assert plain.run == run
    assert deadline.mark == mark
    # The best so far.
    assert best.result == max(run)


def test_the_first_attempt_is_run_in_any_case() -> None:
    deadline = Deadline(0.0, Clock(0.0))
    assert agenda(Work({0: 1}), remedy(1, 1), deadline=deadline).search(0).result == 1


def test_a_part_of_the_time_stops_the_whole() -> None:
    clock = Clock(0.0)
    whole = Deadline(60.0, clock)
    clock.now = 30.0
    part = whole.part(3)
    assert (whole.used, part.limit, part.used) == (30.0, 10.0, 0.0)
    clock.now = 41.0
    assert not part.expired(0.2) and whole.mark is None
    assert part.expired()
    assert (part.mark, whole.mark) == ("time", "time")
    assert not whole.expired()


def test_a_budget_is_taken_run_by_run() -> None:
    budget = Budget(runs=2)
    assert [budget.take() for _ in range(3)] == [True, True, False]
    assert (budget.used, budget.left) == (2, 0)
