"""Where to stand: candidates along the guardrail, screened and ranked, the best planned."""

from cmbot.stances.bounds import (
    NO_FIGURES as NO_FIGURES,
    Bounds as Bounds,
    StanceFigures as StanceFigures,
    StanceObjective as StanceObjective,
)
from cmbot.stances.candidates import (
    AnyCandidate as AnyCandidate,
    Candidate as Candidate,
    MountCandidate as MountCandidate,
    bare_climber as bare_climber,
    candidate_at as candidate_at,
    candidates_of as candidates_of,
    on_two_feet as on_two_feet,
    own_candidate as own_candidate,
    places_of as places_of,
    without_links as without_links,
)
from cmbot.stances.placed_scene import (
    in_world as in_world,
    joined as joined,
    put_away as put_away,
    scene_at as scene_at,
)
from cmbot.stances.ranking import (
    StanceRanking as StanceRanking,
    best_scene as best_scene,
    require_on_guardrail as require_on_guardrail,
    require_planned as require_planned,
    require_standing as require_standing,
    stand as stand,
)
from cmbot.stances.screening import Screener as Screener
from cmbot.stances.search import (
    CHARTED as CHARTED,
    STATUSES as STATUSES,
    Rejection as Rejection,
    StanceResult as StanceResult,
    StandOptions as StandOptions,
)
from cmbot.stances.table import (
    bounds_table as bounds_table,
    in_words as in_words,
    planned_table as planned_table,
    shared_out as shared_out,
    stances_csv as stances_csv,
)
