"""A sample of `benchmarks/run_forgeries.py`: proven wrong by the oracles, and not verified."""

from pathlib import Path

import pytest
from forged.forgeries import FORGERIES, Forgery, forged

# Of each category but walks, which tests/archive/test_walks.py forges, one of the shortest plan.
NAMES = (
    "5 mm off at one via-point",
    "a leg 3 mm askew",
    "a turn of 3 degrees, which the folder says",
    "one row elsewhere",
    "a lower peak everywhere",
)


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where plans that several forgeries begin with are kept."""
    return tmp_path_factory.mktemp("forgeries")


@pytest.mark.parametrize("forgery", [each for each in FORGERIES if each.name in NAMES], ids=str)
def test_a_forged_folder_is_not_verified(forgery: Forgery, output: Path) -> None:
    wrong, outcome, _ = forged(forgery, output)
    assert wrong
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1


def test_there_are_sixty_of_eight_categories() -> None:
    assert len(FORGERIES) >= 60
    categories = {forgery.category for forgery in FORGERIES}
    assert categories == {
        *("motion", "scene", "options", "files"),
        *("claims", "walks", "tours", "exports"),
    }
