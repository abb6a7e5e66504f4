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
    assert foot.contact.size == pytest.approx((0.10, 0.05))
    # The post is 75 mm wide and ends 50 mm above the foot.
    (foot,) = scene({"kind": "magnet", "plate_m": [0.2, 0.2]}).feet
    assert foot.contact.size == pytest.approx((0.15, 0.075))
    np.testing.assert_allclose(foot.centre, [0, 0.0375, -0.025], atol=1e-12)


def test_a_foot_on_the_rail() -> None:
    (foot,) = scene({"kind": "magnet", "plate_m": [0.2, 0.2]}, foot={"offset_m": 0.5}).feet
    np.testing.assert_array_equal(foot.axes, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert foot.contact.size == pytest.approx((0.2, 0.063))


def girder(face: str, hold: Any) -> Scene:
    rail = {"section": {"flat": [0.2, 0.012]}, "height_m": 0.0, "box_m": [0.2, 0.012], "workpiece": True}
    place = {"member": "flange", "along_m": 3.0, "face": face, "turn_deg": 180}
    stance = {"foot_1": place, "foot_2": {**place, "along_m": 3.4}}
    return scene(hold, rails=[{"name": "flange", **rail}], stance=stance)


@pytest.mark.parametrize(("face", "out"), [("bottom", -1), ("top", 1)])
def test_a_foot_on_a_flat_bar(face: str, out: int) -> None:
    """A girder's flange, on which the tool works, too."""
    one = girder(face, {"kind": "magnet", "plate_m": [0.15, 0.25]})
    for foot in one.feet:
        np.testing.assert_array_equal(foot.axes[2], [0, 0, out])
        assert foot.contact.size == pytest.approx((0.15, 0.2))
        assert foot.steel == 0.012
        assert foot.ceiling == pytest.approx(2 * 0.012 * 0.2 * 1.5915e6, rel=1e-3)
        # O0 lies in the foot, on the axis of the first one's place.
        assert foot.centre[1] == pytest.approx(0.0)
    assert [obstacle.name for obstacle in one.all_obstacles if obstacle.workpiece] == ["flange"]
    with pytest.raises(SceneError, match=r"got magnet, expected clamp or welded, .* 12 mm wide"):
        girder("outer", {"kind": "magnet"})


def test_a_list_and_what_is_written_back() -> None:
    one = scene([{"kind": "welded"}])
    assert one.as_data()["guardrail"]["hold"]["kind"] == "welded"
    clamp = {"kind": "clamp", "force_n": [1e4, 1e4, 1e4], "moment_nm": [500, 500, 500]}
    (foot,) = scene(clamp, rails=[BAR], foot={"offset_m": 0.5}).feet
    assert (foot.contact, foot.moment) == (None, (500, 500, 500))


def test_pads_and_deratings_are_read_as_lists() -> None:
    pads = [{"rectangle_m": [0.05, 0.05], "at_m": [x, 0.0]} for x in (-0.05, 0.05)]
    hold = {"kind": "magnet", "adhesion_n": 1000.0, "pads": pads, "derating": [[3.0, 0.5], [10.0, 1.0]]}
    (read,) = scene(hold).guardrail.hold or ()
    assert read.plate.area == pytest.approx(2 * 0.05**2)
    assert read.adhesion_on(0.003) == pytest.approx(500.0)


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


def test_on_the_open_side_of_an_angle_there_is_an_edge() -> None:
    open_side = {"post": {"roll_deg": 0}}
    (foot,) = scene({"kind": "clamp", "force_n": [1e4] * 3, "moment_nm": [500] * 3}, **open_side).feet
    assert foot.contact.size == pytest.approx((0.125, 0.008))
    # Its steel is that of the leg along y, at the side of x below the axis.
    np.testing.assert_allclose(foot.centre, [-0.0375 + 0.004, 0.0375, -0.0125])
    with pytest.raises(
        SceneError, match=r"got magnet, expected clamp or welded, .* edge of a leg, 8 mm wide"
    ):
        scene({"kind": "magnet"}, **open_side)
    with pytest.raises(SceneError, match=r"got magnet, expected clamp or welded, .* round bar or a corner"):
        scene({"kind": "magnet"}, post={"roll_deg": 30})


def test_a_magnet_pulls_no_more_than_saturated_iron() -> None:
    assert scene({"kind": "magnet", "adhesion_n": 14_000}).feet[0].adhesion == 14_000
    with pytest.raises(SceneError, match=r"adhesion_n: got 23000 N, expected at most 14921 N, 1.6 MPa on"):
        scene({"kind": "magnet", "adhesion_n": 23_000})
    # Two poles along the member lead their flux through 8 mm of steel, 75 mm wide.
    (foot,) = scene({"kind": "magnet"}).feet
    assert foot.ceiling == pytest.approx(2 * 0.008 * 0.075 * 1.5915e6, rel=1e-3)


def test_thin_steel_takes_a_share_of_a_magnets_pull() -> None:
    curve = {"kind": "magnet", "adhesion_n": 5000, "derating": [[2, 0.2], [6, 0.5], [10, 1.0]]}
    assert scene(curve).feet[0].adhesion == pytest.approx(0.75 * 5000)
    assert scene(curve, foot={"offset_m": 0.5}).feet[0].adhesion == pytest.approx(0.5 * 5000)
    with pytest.raises(SceneError, match=r"guardrail.hold.derating: got .*, expected ascending mill"):
        scene(curve | {"derating": [[6, 0.2], [2, 0.5]]})
    with pytest.raises(SceneError, match=r"guardrail.hold.adhesion_n: got nothing, expected the adhesion"):
        scene({"kind": "magnet", "derating": [[6, 0.2]]})


def test_paint_takes_a_share_of_a_magnets_pull() -> None:
    paint = {"kind": "magnet", "adhesion_n": 5000, "air_gap_derating": [[0, 1.0], [0.4, 0.5]]}
    assert scene(paint | {"air_gap_mm": 0.2}).feet[0].adhesion == pytest.approx(0.75 * 5000)
    thin = {"derating": [[2, 0.2], [10, 1.0]], "air_gap_mm": 0.4}
    assert scene(paint | thin).feet[0].adhesion == pytest.approx(0.8 * 0.5 * 5000)
    with pytest.raises(SceneError, match=r"guardrail.hold.air_gap_mm: got nothing, expected a value"):
        scene(paint)


def test_without_a_member_nothing_is_held() -> None:
    with pytest.raises(SceneError, match=r"guardrail.hold.kind: got magnet, expected welded, as there is no"):
        scene({"kind": "magnet"}, bays=0)
    assert scene(bays=0).feet == ()
