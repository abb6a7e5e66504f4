"""What sequences of postures that the joints can follow ask at least, by charts at all or few via-points."""

import numpy as np
import pytest
from small_scenes import request_of, short_scene

from cmbot.planning import GlobalSearch, quick_bound
from cmbot.planning.request import StrokeRequest


@pytest.fixture(scope="module")
def asked() -> StrokeRequest:
    return request_of(short_scene(tool_path={"legs": [{"by": [-0.6, 0, 0], "seconds": 4}]}), knots="sliding")


@pytest.fixture(scope="module")
def search(asked: StrokeRequest) -> GlobalSearch:
    return GlobalSearch(asked)


def test_no_sequence_of_denser_charts_asks_less(asked: StrokeRequest) -> None:
    finer = GlobalSearch(asked.with_options(chart_spacing=0.07, step_share=1.0)).solve(pinned=False).peak
    few = [quick_bound(asked, via_points) for via_points in (2, 5)]
    assert max(few) == pytest.approx(finer, rel=1e-3)


def test_it_is_between_the_lower_bound_and_the_solution(search: GlobalSearch) -> None:
    solution = search.solve(pinned=False)
    assert search.lower_bound.value <= search.followed_bound() <= solution.peak * (1 + 1e-12)


def test_neighbours_lower_a_layer(search: GlobalSearch) -> None:
    layer = search._layers[0]
    lower = layer.between(0.3)
    assert (lower.chart.value <= layer.chart.value).all()
    assert (lower.chart.value < layer.chart.value).any()
    assert (lower.chart.value >= 0.5 * (layer.chart.value + layer.chart.value.min()) - 1e-9).all()
    np.testing.assert_array_equal(layer.between(1e-9).chart.value, layer.chart.value)
