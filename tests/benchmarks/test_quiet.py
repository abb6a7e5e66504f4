"""The benchmark of quiet plans, on one of its scenes."""

import quiet


def test_a_quiet_plan_sways_and_swings_less_than_that_of_the_paper_and_asks_no_more() -> None:
    found = quiet.compared(seed=1, number=2)
    assert found.periods > 4
    assert found.sway < 0.8 * found.other_sway
    assert found.swing < 0.4
    assert found.swing < 0.3 * found.other_swing
    assert found.peak < 1.001
