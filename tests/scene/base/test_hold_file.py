"""The block guardrail.hold, and the flat faces on which plates sit."""

from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.common.errors import SceneError
from cmbot.scene import Scene

BAR = {"name": "only", "section": {"bar": 0.05}, "height_m": 0.0, "box_m": [0.05, 0.05]}


def scene(hold: Any = None, **guardrail: Any) -> Scene:
    if hold is not None:
        guardrail["hold"] = hold
    return short_scene(guardrail=guardrail)


def test_a_foot_is_welded_unless_said() -> None:
    (foot,) = scene().feet
    assert (foot.kind, foot.bounded) == ("welded", False)


def test_the_contact_is_the_plate_cut_with_the_face() -> None:
    (foot,) = scene({"kind": "magnet", "plate_m": [0.10, 0.05], "adhesion_n": 5000}).feet
    np.testing.assert_allclose(foot.centre, [0, 0.0375, 0])
    np.testing.assert_array_equal(foot.axes, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert foot.half == pytest.approx((0.05, 0.025))
    # The post is 75 mm wide and ends 50 mm above the foot.
    (foot,) = scene({"kind": "magnet", "plate_m": [0.2, 0.2]}).feet
    assert foot.half == pytest.approx((0.075, 0.0375))
    np.testing.assert_allclose(foot.centre, [0, 0.0375, -0.025])


def test_a_foot_on_the_rail() -> None:
    (foot,) = scene({"kind": "magnet", "plate_m": [0.2, 0.2]}, foot={"offset_m": 0.5}).feet
    np.testing.assert_array_equal(foot.axes, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert foot.half == pytest.approx((0.1, 0.0315))


def test_a_list_and_what_is_written_back() -> None:
    one = scene([{"kind": "welded"}])
    assert one.as_data()["guardrail"]["hold"]["kind"] == "welded"
    clamp = {"kind": "clamp", "force_n": [1e4, 1e4, 1e4], "moment_nm": [500, 500, 500]}
    (foot,) = scene(clamp, rails=[BAR], foot={"offset_m": 0.5}).feet
    assert (foot.half, foot.moment) == (None, (500, 500, 500))


@pytest.mark.parametrize(
    ("hold", "message"),
    [
        ({"kind": "glue"}, r"guardrail.hold.kind: got 'glue', expected a known value"),
        ({"kind": "magnet", "frction": 1}, r"guardrail.hold.frction: .* did you mean friction"),
        (
            {"kind": "magnet", "force_n": [1, 1, 1]},
            r"guardrail.hold.force_n: .* no such key beside kind: mag",
        ),
        ({"kind": "clamp", "force_n": [1, 1, 1]}, r"guardrail.hold.moment_nm: got nothing, expected three"),
        ({"kind": "magnet", "plate_m": [0.1]}, r"guardrail.hold.plate_m: .*expected a list of 2 items"),
        ({}, r"guardrail.hold.kind: .* a value, this key is required"),
        ("magnet", r"guardrail.hold: got 'magnet', expected how a foot holds"),
        ([{"kind": "magnet"}] * 2, r"guardrail.hold: got a list of two, expected one foot"),
    ],
)
def test_what_is_refused(hold: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene(hold)


def test_a_round_bar_takes_no_magnet() -> None:
    with pytest.raises(
        SceneError, match=r"guardrail.hold.kind: got magnet, expected clamp or welded, as the"
    ):
        scene({"kind": "magnet"}, rails=[BAR], foot={"offset_m": 0.5})


def test_without_a_member_nothing_is_held() -> None:
    with pytest.raises(SceneError, match=r"guardrail.hold.kind: got magnet, expected welded, as there is no"):
        scene({"kind": "magnet"}, bays=0)
    assert scene(bays=0).feet == ()
