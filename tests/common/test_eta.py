"""How long work will still take: exact where its parts cost the same, no figure without a basis."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmbot.common.eta import Eta, Remaining

seconds = st.floats(1e-3, 1e4)
moments = st.floats(-1e6, 1e6)
counts = st.integers(2, 200)


@given(began=moments, each=seconds, total=counts, data=st.data())
def test_parts_of_equal_cost_are_foretold_exactly(
    began: float, each: float, total: int, data: st.DataObject
) -> None:
    first = data.draw(st.integers(0, total - 2))
    done = data.draw(st.integers(first + 1, total - 1))
    since = data.draw(st.floats(0.0, 0.99))
    work = Remaining(began, share=first / total)
    for k in range(first + 1, done + 1):
        work.note(k / total, began + (k - first) * each)
    left = work.left(began + (done - first + since) * each)
    assert left.seconds == pytest.approx((total - done - since) * each, rel=1e-6, abs=1e-6)


@given(
    notes=st.lists(st.tuples(st.floats(-0.5, 1.5), st.floats(0.0, 100.0)), max_size=20), at_most=st.booleans()
)
def test_whatever_is_noted_nothing_falls_below_zero(notes: list[tuple[float, float]], at_most: bool) -> None:
    work, now, share = Remaining(0.0, at_most=at_most), 0.0, 0.0
    for told, later in notes:
        now += later
        work.note(told, now)
        assert share <= work.share <= 1.0
        share = work.share
        left = work.left(now)
        assert left is None or (left.seconds > 0.0 and left.at_most == at_most)
        assert left is None or share > 0.0


def test_before_the_first_part_there_is_no_figure_and_parts_that_nobody_counts_do_not_run_out() -> None:
    work = Remaining(10.0)
    assert work.left(20.0) is None
    work.note(0.0, 20.0)
    assert work.left(30.0) is None
    left = Eta(seconds=2.0, most=5, part="pass", parts="passes")
    assert left.after(100.0) == left


@given(share=st.floats(0.01, 0.99), spent=seconds, later=seconds)
def test_what_takes_longer_than_foretold_has_no_figure(share: float, spent: float, later: float) -> None:
    work = Remaining(0.0)
    work.note(share, spent)
    foretold = work.left(spent)
    left = work.left(spent + later)
    if later >= foretold.seconds:
        assert left is None
    else:
        assert left.seconds == pytest.approx(foretold.seconds - later, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("left", "words"),
    [
        (Eta(seconds=12.4), "about 12 s left"),
        (Eta(seconds=0.1), "about 1 s left"),
        (Eta(seconds=75.0, at_most=True), "at most 75 s left"),
        (Eta(seconds=0.42, most=37, part="pass", parts="passes"), "at most 37 more passes, 0.4 s each"),
        (Eta(seconds=20.4, most=1, part="round", parts="rounds"), "at most 1 more round, 20 s each"),
    ],
)
def test_it_is_said_in_words(left: Eta, words: str) -> None:
    assert left.sentence() == words
