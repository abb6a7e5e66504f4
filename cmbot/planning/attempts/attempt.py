"""An attempt at a stroke: what its motion is planned from."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.attempts.agenda import Agenda, Remedy, Solved
from cmbot.planning.attempts.failure import Failure, attempted, failure_of
from cmbot.planning.budget import Budget
from cmbot.planning.initial_guess import (
    InitialGuess,
    fixed_guess,
    guess_along,
    initial_guess,
    leap_failure,
    least_travel_guess,
    problem_near,
    searched,
)
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.global_search import GlobalSearch
from cmbot.planning.timing.timing import Timing, is_coarse
from cmbot.planning.torque import Optimised, TorqueProblem, optimise
from cmbot.planning.workcell.objectives import TRAVEL
from cmbot.toolpath import LegLaw

if TYPE_CHECKING:
    # It loads SciPy's splines.
    from cmbot.planning.timing.quiet_laws import MoreTime

S = TypeVar("S")


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """What the motion of a stroke is planned from.

    Attributes
    ----------
    request : StrokeRequest
    guess : InitialGuess or Failure
        Or why there is none.
    is_first : bool
        No remedy proposed it.
    kept : float
        Factor on the safety margin that the guess keeps.
    timing : Timing, optional
        Of legs whose shortest time is sought, or whose laws were chosen.
    more_time : MoreTime, optional
        What more seconds would give on a short leg.
    plain : bool
        The legs keep the scene's laws.
    """

    request: StrokeRequest
    guess: InitialGuess | Failure
    is_first: bool = True
    kept: float = 1.0
    timing: Timing | None = None
    more_time: MoreTime | None = None
    plain: bool = False

    @classmethod
    def of(cls, request: StrokeRequest, **own: Any) -> Attempt:
        """Return the attempt from the first guess of a request."""
        return cls(request=request, guess=attempted(request, lambda: initial_guess(request)), **own)

    def of_least_travel(self) -> Attempt:
        """Return the attempt whose joints travel least, where the objective has next to nothing to gain.

        See `least_travel_guess`.
        """
        guess, objective = self.guess, self.request.cell.objective
        is_own = objective.name != self.request.cell.options.objective
        if not isinstance(guess, InitialGuess) or guess.search is None or not guess.pinned:
            return self
        if is_own or objective is TRAVEL:
            return self
        request = replace(self.request, least_travel=True)
        made = attempted(request, lambda: least_travel_guess(request, guess))
        return replace(self, request=request, guess=made) if isinstance(made, InitialGuess) else self

    @property
    def chooses_laws(self) -> bool:
        """Whether a quiet stroke is to have laws that are neither given nor those of the scene's profile."""
        file = self.request.stroke.file
        return file.speed_profile.kind == "quiet" and not (file.time_laws or self.plain)

    def quiet(self) -> Attempt:
        """Return the attempt with the laws that a quiet stroke is to have, chosen along its optimised path.

        What the joints' path bends by counts as much as the law, and the guess bends otherwise; where no path
        is optimised, the guess is all there is. The attempt is this one where the laws are given, nothing is
        guessed, nothing leads on in another law, or the tool sways more by it along that path: suppression
        lessens the swing alone.
        """
        request, guess = self.request, self.guess
        if not self.chooses_laws or not isinstance(guess, InitialGuess):
            return self
        # Imported where needed: SciPy's splines take a while to load.
        from cmbot.planning.timing.quiet_laws import quiet_laws

        request.reporter.step("choosing time laws by the sway that they would cause")
        # Via-points that stay leave next to nothing to optimise of the path.
        unshaped, own = guess.problem.parametrization.trajectory, self
        if guess.search is not None:
            optimised = attempted(request, lambda: optimise(guess.problem))
            if isinstance(optimised, Optimised) and optimised.failure is None:
                unshaped = optimised.trajectory
                own = replace(self, guess=guess_along(request, guess, unshaped))

        def simulated(laws: tuple[LegLaw, ...]) -> FloatArray:
            timed = own.in_timing(Timing.along(request, unshaped, (), laws))
            if not isinstance(timed, Attempt) or not isinstance(timed.guess, InitialGuess):
                return np.full(len(request.task.path.segments), np.inf)
            times = timed.request.task.path.leg_times
            return request.cell.sway_of_legs(timed.guess.problem.parametrization.trajectory, times)

        laws, more_time = quiet_laws(request, unshaped, simulated if is_coarse(request) else None)
        plain = replace(own, more_time=more_time)
        if not laws:
            return plain
        timed = plain.in_timing(Timing.along(request, unshaped, (), laws))
        if not isinstance(timed, Attempt) or not isinstance(timed.guess, InitialGuess):
            return plain
        shaped = timed.guess.problem.parametrization.trajectory
        return plain if request.cell.sway_of(shaped)[0] > sum(request.cell.sway_of(unshaped)) else timed

    def in_timing(self, timing: Timing) -> Attempt | Failure:
        """Return the attempt in a timing, from the via-points of its joint path.

        Nothing is charted for it: that joints get from one via-point to the next is what its laws are made
        for, or what an optimised path does. Fixed knots are those of gradient projection in that time.
        """
        request, guess = timing.timed, self.guess
        if not isinstance(guess, InitialGuess):
            return guess
        if request.cell.options.knots == "fixed":
            made = attempted(request, lambda: fixed_guess(request))
            own = replace(self, guess=made, request=request, timing=timing)
            return own if isinstance(made, InitialGuess) else made
        problem = attempted(request, lambda: problem_near(request, guess, timing.via_points(request)))
        if not isinstance(problem, TorqueProblem):
            return problem
        return replace(self, guess=replace(guess, problem=problem), request=request, timing=timing)

    @cached_property
    def search(self) -> GlobalSearch | None:
        """The global search of its via-points, made where its guess has that of others.

        None with fixed knots.
        """
        known = self.guess.search if isinstance(self.guess, InitialGuess) else None
        if known is None or known.is_of(self.request.times):
            return known
        made = attempted(self.request, lambda: searched(self.request)[0])
        return made if isinstance(made, GlobalSearch) else None

    @property
    def is_pinned(self) -> bool:
        """Whether its guess starts where the arm is before."""
        return isinstance(self.guess, InitialGuess) and self.guess.pinned

    @property
    def key(self) -> Hashable:
        """What tells it from other attempts at the same stroke."""
        cell, guess = self.request.cell, self.guess
        asked = cell.options, cell.robot.tool_ramp
        if not isinstance(guess, InitialGuess):
            return *asked, self.request.times.tobytes()
        form = guess.problem.parametrization
        chart = None if guess.search is None else guess.search.first_chart.q
        arrays: tuple[FloatArray | None, ...] = (form.space.t, form.via_points, chart, guess.way)
        numbers = tuple(None if array is None else array.tobytes() for array in arrays)
        kept = self.request.spare_clearance, self.request.tool_share
        return *asked, guess.pinned, kept, numbers

    @property
    def refused(self) -> Failure | None:
        """Why it is not worth a run; None where it is.

        After a failure nothing is optimised from a guess that leaps: hardly any trajectory leads on from
        there.
        """
        if not isinstance(self.guess, InitialGuess):
            return self.guess
        leaps = None if self.is_first else leap_failure(self.guess.problem)
        return None if leaps is None else failure_of(self.request, leaps)


def agenda_of(
    request: StrokeRequest,
    work: Callable[[Attempt], Solved[S] | Failure],
    remedies: Sequence[Remedy[Attempt, S]],
    budget: Budget,
    better: Callable[[S, S], bool] = lambda result, best: False,
) -> Agenda[Attempt, S]:
    """Return an agenda of attempts at the stroke of a request."""
    return Agenda(
        work=work,
        key=lambda attempt: attempt.key,
        refused=lambda attempt: attempt.refused,
        remedies=remedies,
        budget=budget,
        deadline=request.deadline,
        better=better,
    )
