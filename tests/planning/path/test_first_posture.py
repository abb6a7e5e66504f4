"""Where the work starts that begins apart from the tool in the scene's posture."""

from typing import Any

import numpy as np
import pytest
from small_scenes import panda_scene, request_of

from cmbot.common.errors import PathNotFound
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.scene import Scene


def scene_of(keep: Any) -> Scene:
    """A Panda whose path begins where its tool cannot point as asked, but 30 degrees aside of that."""
    begin = {"xyz": [0.6, 0.0, 0.5], "rpy_deg": [0.0, 75.0, 0.0]}
    leg = {"by": [0.0, 0.02, 0.0], "seconds": 2}
    return panda_scene({"keep": keep, "from": begin, "legs": [leg], "via_points": 5})


def test_the_tool_leans_where_it_cannot_be_in_the_middle_of_its_cone() -> None:
    with pytest.raises(PathNotFound, match="the path begins out of reach"):
        starting_at_path(request_of(scene_of("axis")))
    request = request_of(scene_of({"axis_within_deg": 30}))
    first = starting_at_path(request).first
    at, goal = request.cell.postures.tool_at(first[None]), request.task.path.poses([0.0])
    np.testing.assert_allclose(at.tool_point, goal.point, rtol=0, atol=1e-9)
    cosine = float(at.tool_rotation[0, :, 2] @ goal.rotation[0, :, 2])
    assert np.cos(np.radians(30)) <= cosine < np.cos(np.radians(1))
    assert request.cell.admissible(first[None]).all()
