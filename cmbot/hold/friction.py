"""How much friction and torsion a pressed contact bears: exact, from its outline.

A pressure p = max(0, a + b . x) presses the part of the contact where it is positive, and a plate that moves
as v + w k x turns about c = (-v_y, v_x) / w. Friction does the work mu H on it, H = |w| D(c) with

    D(c) = integral of p |x - c|

and a load of friction T and moment M slips where T . v + M w > mu H(v, w) for some motion (Goyal, Ruina and
Papadopoulos, 1991). H is convex. In polar coordinates about c, D and its derivatives are integrals along the
outline of the pressed part, all of which are elementary:

    D = sum over sides of d (integral of rho (p(c) / 3 + b . (x - c) / 4) along the side)

where rho = |x - c| and d is the signed distance of the side's line from c. There are no cells.
Points and vectors in the plane are complex numbers here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

ComplexArray = NDArray[np.complex128]

# Passes at most, and where they end: shares of moments, of a work and of the force that is enough. Whether a
# force is enough is said where the work is sure by this share of what is too much or too little.
_PASSES, _BALANCED, _LEAST_WORK, _ENOUGH, _SURE = 400, 1e-10, 1e-12, 1e-8, 0.003
# By how much the force goes down in a step, at most and where it is far from too little; friction that is
# enough by less than this share may be too little in between.
_DOWN, _SHALLOW = (0.5, 0.85), 0.1
# Least share of turning in a motion: centres are no further than its inverse, in units of the contact's size.
_LEAST_TURNING = 1e-2
# Motions from which the search starts: angles of slides by turns to the normal, and about it.
_TILTS, _WAYS = 12, 24
# Newton's steps at most where all of a contact is pressed, and the share of the force that the last may gain.
_STEPS, _WEAKEST = 12, 1e-13
# Where the centre of pressure is within this share of the way to the edge, more force mostly holds more:
# whether the least does is asked first.
_STEADY_SHARE = 0.5
_LEAST_SHARE, _STUCK, _HIDDEN = 0.1, 1e-10, 1e-6
# From this change of the distance to the hull's edge on what is pressed shrinks in proportion to it.
_LARGE_STEP = 0.1
_TINY = 1e-12
_ROUNDING = 2e-15


class Friction:
    """The friction of a contact.

    Parameters
    ----------
    rings : sequence of (K,), complex, in units of the contact's size
        The corners of its parts, each part counter-clockwise.
    """

    def __init__(self, rings: Sequence[ComplexArray]) -> None:
        start, number = np.concatenate(rings), np.arange(sum(len(ring) for ring in rings))
        parts = np.split(number, np.cumsum([len(ring) for ring in rings])[:-1])
        self._next = np.concatenate([np.roll(part, -1) for part in parts])
        self._start, self._side = start, start[self._next] - start
        self._along = self._side / np.abs(self._side)
        self._far = (start * (1j * self._along.conj())).real
        self.whole = self.moments(np.array([[1.0, 0.0, 0.0]]))[0]
        self.from_goal = np.linalg.inv(self.whole)
        tilt = np.repeat((np.arange(_TILTS) + 0.5) * np.pi / _TILTS, _WAYS)
        way = np.tile(np.arange(_WAYS) * 2 * np.pi / _WAYS, _TILTS)
        self.motions = np.column_stack([np.sin(tilt) * np.cos(way), np.sin(tilt) * np.sin(way), np.cos(tilt)])
        even = np.tile([1.0, 0.0, 0.0], (len(tilt), 1))
        by_goal = self.work(even, self.motions)[3] @ self.from_goal
        # Of a contact that is pressed all over: what a motion asks, and its derivatives, by the load (5, K).
        self.by_load = (np.column_stack([self.motions, -by_goal[:, 1:]]) / by_goal[:, :1]).T

    def least(self, load: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return what a contact that is pressed all over needs at least (N,), and against which motion (N,).

        Of loads (N, 5): friction and torsion by the friction coefficient, and E. With pressures that are
        linear in the force P and E a motion does the work P g0 + E . g.
        """
        needed = load @ self.by_load
        which = needed.argmax(axis=1)
        return needed[np.arange(len(load)), which], which

    def moments(self, pressure: FloatArray) -> FloatArray:
        """Return the integrals of (1, x)' (1, x) over where pressures (N, 3) are positive, (N, 3, 3)."""
        a, b = pressure[:, 0], pressure[:, 1] + 1j * pressure[:, 2]
        start, end, _ = self._pressed(a, b)
        # Triangles about a point where the pressure is zero: the line along which it is adds nothing.
        apex = -a * b / np.maximum(np.abs(b), _TINY) ** 2
        apex = np.where(np.abs(apex) > 4.0, 0.0, apex)
        one, two = start - apex[:, None], end - apex[:, None]
        area, both = (one.conj() * two).imag, one + two
        total, first = area.sum(axis=1) / 2, (area * both).sum(axis=1) / 6
        square = (area * (one * one + two * two + both * both)).sum(axis=1) / 24
        size = (area * (np.abs(one) ** 2 + np.abs(two) ** 2 + np.abs(both) ** 2)).sum(axis=1) / 24
        square += 2 * apex * first + apex * apex * total
        size += 2 * (apex.conj() * first).real + np.abs(apex) ** 2 * total
        first += apex * total
        rows = [total, first.real, first.imag, first.real, (size + square.real) / 2, square.imag / 2]
        rows += [first.imag, square.imag / 2, (size - square.real) / 2]
        return np.array(rows).T.reshape(-1, 3, 3)

    def work(
        self, pressure: FloatArray, motion: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return H (N,) of motions v, w (N, 3), its gradient (N, 3) and second derivatives (N, 3, 3).

        The last is |w| times the integrals of (1, x) |x - c| over where the pressure is positive, (N, 3).
        """
        turn, slide = motion[:, 2], motion[:, 0] + 1j * motion[:, 1]
        least = _LEAST_TURNING * np.abs(slide)
        turn = np.where(np.abs(turn) < least, np.copysign(least, turn), turn)
        centre, size = 1j * slide / turn, np.abs(turn)
        distance, by_centre, mean, deviation = self._distances(pressure, centre)
        total = (pressure * distance).sum(axis=1)
        by_slide = -1j * by_centre
        by_turn = total - (by_centre.conj() * centre).real
        slope = np.sign(turn)[:, None] * np.array([by_slide.real, by_slide.imag, by_turn]).T
        # Derivatives of c by v and w, times w, are (0, 1), (-1, 0) and -c.
        along, across = mean - deviation.real, mean + deviation.real
        mixed = mean * centre + deviation * centre.conj()
        both = (centre.conj() * mixed).real
        second = [along, -deviation.imag, -mixed.imag, -deviation.imag, across, mixed.real]
        second += [-mixed.imag, mixed.real, both]
        curved = (np.array(second) / size).T.reshape(-1, 3, 3)
        # Of motions that hardly turn, to second order.
        change = (motion[:, 2] - turn)[:, None] * curved[:, 2]
        work = size * total + (motion[:, 2] - turn) * (slope[:, 2] + change[:, 2] / 2)
        return work, slope + change, curved, size[:, None] * distance

    def _pressed(self, a: FloatArray, b: ComplexArray) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Where on each side the pressed part starts and ends, and whether it is entered or left (N, K)."""
        first = a[:, None] + np.multiply.outer(b.real, self._start.real)
        first += np.multiply.outer(b.imag, self._start.imag)
        # The same number as of the side that starts there: a corner is in or out.
        starts = first >= 0
        if starts.all():
            return self._start, self._start + self._side, np.zeros_like(first)
        last, ends = first[:, self._next], starts[:, self._next]
        crosses = starts != ends
        share = first / np.where(crosses, first - last, 1.0)
        low = np.where(starts, 0.0, np.where(crosses, share, 0.0))
        high = np.where(ends, 1.0, np.where(crosses, share, 0.0))
        sign = ends.astype(float) - starts
        return self._start + low * self._side, self._start + high * self._side, sign

    def _distances(
        self, pressure: FloatArray, centre: ComplexArray
    ) -> tuple[FloatArray, ComplexArray, FloatArray, ComplexArray]:
        """Integrals (N, 3) of (1, x) |x - c| over the pressed part, and D's derivatives by c.

        Second derivatives are the mean of both diagonal terms, and their deviation from it as a complex
        number that turns with twice the angle.
        """
        a, b = pressure[:, 0], pressure[:, 1] + 1j * pressure[:, 2]
        start, end, sign = self._pressed(a, b)
        steep = np.maximum(np.abs(b), _TINY)
        at_centre = a + (b.conj() * centre).real
        # Along the sides, and along the line on which the pressure is zero, from where the outline is left to
        # where it is entered.
        along, middle, conj = self._along, centre[:, None], self._along.conj()
        far = self._far - (middle * (1j * conj)).real
        tau = [((end - middle) * conj).real, ((start - middle) * conj).real]
        parts = np.subtract(*(_antiderivatives(far, each) for each in tau))
        if sign.any():
            line, away = (-1j * b / steep)[:, None], (at_centre / steep)[:, None]
            crossing = np.where(sign > 0, start, end)
            at_ends = _antiderivatives(away, ((crossing - middle) * line.conj()).real)
            parts = np.concatenate([parts, (sign * at_ends).sum(axis=2, keepdims=True)], axis=2)
            along = np.hstack([np.broadcast_to(along, far.shape), line])
            far = np.hstack([far, away])
        root, first, third, mixed, square, sine, inverse = parts
        # With the components of b out of the side and along it; -i t is out of it.
        turned = b.conj()[:, None] * along
        bt, bn = turned.real, turned.imag
        d, dd = far, far * far
        distance = np.empty((len(a), 3))
        distance[:, 0] = (d * root).sum(axis=1) / 3
        moment = (along * (d * third - 1j * dd * root)).sum(axis=1) / 4 + centre * distance[:, 0]
        distance[:, 1], distance[:, 2] = moment.real, moment.imag
        q = at_centre[:, None] / 2 + bn * d / 3
        slope = -(along * d * (q * mixed + bt / 3 * square - 1j * d * (q * first + bt / 3 * mixed))).sum(
            axis=1
        )
        r, bt = at_centre[:, None] + bn * d / 2, bt / 2
        nn = d * (r * (first - sine) + bt * (mixed + dd * inverse))
        nt = dd * (r * inverse - bt * (first - sine))
        tt = d * (r * sine - bt * dd * inverse)
        mean = (nn + tt).sum(axis=1) / 2
        deviation = (along * along * ((tt - nn) / 2 - 1j * nt)).sum(axis=1)
        return distance, slope, mean, deviation


def _antiderivatives(d: FloatArray, tau: FloatArray) -> FloatArray:
    """At tau (7, N, K): of rho, 1 / rho, tau rho, tau / rho, tau^2 / rho, d^2 / rho^3 and -tau / rho^3."""
    rho = np.maximum(np.sqrt(d * d + tau * tau), _TINY)
    log = np.arcsinh(tau / np.maximum(np.abs(d), _TINY))
    product, square = tau * rho, d * d * log
    parts = [(product + square) / 2, log, rho**3 / 3, rho, (product - square) / 2, tau / rho, 1 / rho]
    return np.array(parts)


def _newton_step(free: FloatArray, slope: FloatArray, curved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What to take off motions (N, 3) along two directions (N, 3, 2), and twice what that gains (N,)."""
    across = free.swapaxes(1, 2)
    slope, curved = across @ slope[:, :, None], across @ curved @ free
    curved += _TINY * np.trace(curved, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    away = np.linalg.solve(curved, slope)
    gain = (slope * away).sum(axis=(1, 2))
    # Far out curvatures are small differences: below zero they would lead upwards, and count as an end.
    return (free @ away)[:, :, 0] * np.sign(gain)[:, None], np.abs(gain)


class Slipping:
    """The search for the force from which on friction is enough.

    Where the centre of pressure is near a corner, more force may hold less, as it moves inwards. So the force
    goes down from where the whole contact is pressed, beyond which friction grows with it. Each pass takes
    one of Newton's steps for every load: for the pressure; with that, for the motion against which friction
    is weakest; and with that, for the force.

    Parameters
    ----------
    friction : Friction
    slips : (N, 3)
        Friction and torsion, by the friction coefficient.
    moment : (N, 2)
        Moments E of the pressure.
    least, whole, tip : (N,)
        The least force that is asked for, and those with which the whole contact is pressed and with which it
        tips.
    ends : (N, 2, 2)
        The corners between which it tips.
    sure : (N,)
        Forces from which on each is known to be enough, no less than the least; infinite where none is.
    only_whether : bool
        Of a least force that is not enough it is only found that it is not, which is quicker.

    Attributes
    ----------
    force : (N,)
        That is enough; zero where the least is. With `only_whether` it may be infinite.
    gradient : (N, 6)
        By friction, moments and torsion.
    """

    def __init__(
        self,
        friction: Friction,
        slips: FloatArray,
        moment: FloatArray,
        least: FloatArray,
        whole: FloatArray,
        tip: FloatArray,
        ends: FloatArray,
        sure: FloatArray,
        *,
        only_whether: bool = False,
    ) -> None:
        self._tip, self._ends = tip, ends
        self._friction, self._moment, self._least, N = friction, moment, least, len(slips)
        self.force, self.gradient = np.zeros(N), np.zeros((N, 5))
        self._low, self._high, self._slope = np.zeros(N), np.full(N, np.inf), np.zeros(N)
        self._shallow = np.zeros(N, dtype=bool)
        needed, which = friction.least(np.hstack([slips, moment]))
        motion = friction.motions[which]
        does = (motion * slips).sum(axis=1) > _LEAST_SHARE * np.linalg.norm(slips, axis=1)
        # Against which the load hardly works it says nothing, and steps from there lead nowhere.
        motion = np.where(does[:, None], motion, slips)
        self._weakest = motion / np.maximum((motion * slips).sum(axis=1), 1e-300)[:, None]
        # Two directions in which a load does no work.
        first = np.cross(slips, np.eye(3)[np.abs(slips).argmin(axis=1)])
        size = np.maximum(np.linalg.norm(slips, axis=1), 1e-300)[:, None]
        first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
        self._free = np.stack([first, np.cross(slips, first) / size], axis=2) / size[:, :, None]
        top = np.max([whole, least, 0.1 * np.abs(slips).max(axis=1)], axis=0)
        everywhere = np.flatnonzero(needed > top)
        self._press_all(everywhere, needed[everywhere])
        rows = np.flatnonzero((self.force == 0) & slips.any(axis=1))
        self._hidden, self._settled, self._only_whether = 0.0, np.zeros(N, dtype=bool), only_whether
        self._begin(least)
        self._passed(rows[tip[rows] < _STEADY_SHARE * least[rows]], self._settle, balanced=False)
        left = rows[~self._settled[rows]]
        self._begin(np.minimum(top, sure))
        left = self._passed(left, self._decide, balanced=True)
        # Of centres far away the work is a small difference, and rounding hides what steps gain.
        self._hidden = _HIDDEN
        hidden = self._passed(left[np.isinf(self._high[left])], self._decide, balanced=True)
        left = np.union1d(left[np.isfinite(self._high[left])], hidden)
        # Where rounding hides the least: a force that is known to be enough.
        self.force[left] = self._high[left]

    def _begin(self, force: FloatArray) -> None:
        """Try these forces (N,) next, from what counts where all of the contact is pressed."""
        N = len(force)
        self._motion = self._weakest.copy()
        goal = np.column_stack([np.ones(N), self._moment / np.maximum(force, 1e-300)[:, None]])
        self._trial, self._pressure = force.copy(), goal @ self._friction.from_goal
        self._moments = np.broadcast_to(self._friction.whole, (N, 3, 3)).copy()
        self._pressure_step, self._energy = np.zeros((N, 3)), np.full(N, np.inf)
        self._motion_step, self._work = np.zeros((N, 3)), np.full(N, np.inf)

    def _passed(self, rows: IntArray, judge: Callable[[IntArray], BoolArray], *, balanced: bool) -> IntArray:
        """Take passes until `judge` says of all rows (k,) that they are done; return those that are not.

        It is asked of those whose pressure, and the motion against which friction is weakest, are found.
        """
        there = np.full(len(self.force), balanced)
        for _ in range(_PASSES):
            if not len(rows):
                break
            off = rows[~there[rows]]
            there[off] = self._balance(off)
            moved = rows[there[rows]]
            if len(moved) and len(weakest := moved[self._minimise(moved)]):
                done = judge(weakest)
                there[weakest] = False
                rows = np.setdiff1d(rows, weakest[done], assume_unique=True)
        return rows

    def _settle(self, rows: IntArray) -> BoolArray:
        """Settle where the least force is enough, and more is, too; all rows are done then.

        With the moments kept, what more force adds to the pressure is linear where something is pressed.
        Where that is nowhere negative friction grows with the force, and what is pressed does. That it stays
        so up to where all is pressed is sampled, not proven.
        """
        a, b = self._pressure[rows, 0], self._pressure[rows, 1] + 1j * self._pressure[rows, 2]
        start, end, _ = self._friction._pressed(a, b)
        more, turned = self._by_force[:, :1], self._by_force[:, 1:]
        added = [more + turned[:, :1] * at.real + turned[:, 1:] * at.imag for at in (start, end)]
        least = np.where(start == end, np.inf, np.minimum(*added)).min(axis=1)
        enough = self._trial[rows] * self._work[rows] >= 1
        self._settled[rows] = enough & (least >= 0)
        if self._only_whether:
            self._settled[rows[~enough]] = True
            self.force[rows[~enough]] = np.inf
        return np.ones(len(rows), dtype=bool)

    def _press_all(self, rows: IntArray, force: FloatArray) -> None:
        """Find the force of contacts that are pressed all over; `force` (k,) is that of the motions.

        The largest (1 - E . g) / g0 of motions that do the work 1, with the work P g0 + E . g.
        """
        motion, moment, free = self._weakest[rows], self._moment[rows], self._free[rows]
        for _ in range(_STEPS):
            if not len(rows):
                break
            goal = np.column_stack([force, moment])
            _, slope, curved, distance = self._friction.work(goal @ self._friction.from_goal, motion)
            g = distance @ self._friction.from_goal
            least = (1 - (moment * g[:, 1:]).sum(axis=1)) / g[:, 0]
            step, gain = _newton_step(free, slope, curved)
            done = (gain <= _WEAKEST * least * g[:, 0]) & (np.abs(least - force) <= _ENOUGH * least)
            self.force[rows[done]] = least[done]
            by_load = np.column_stack([motion[:, :2], -g[:, 1:], motion[:, 2]]) / g[:, :1]
            self.gradient[rows[done]] = by_load[done]
            rows, moment, free = rows[~done], moment[~done], free[~done]
            motion, force = (motion - step)[~done], least[~done]

    def _balance(self, rows: IntArray) -> BoolArray:
        """Take a step towards the pressure that has the load's moments; whether it is there."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        goal = np.column_stack([np.ones(len(rows)), self._moment[rows] / self._trial[rows, None]])
        pressure = self._pressure[rows] - self._pressure_step[rows]
        moments = self._friction.moments(pressure)
        force = (moments @ pressure[:, :, None])[:, :, 0]
        energy = (pressure * (0.5 * force - goal)).sum(axis=1)
        lack = force - goal
        # Where only a narrow cap is pressed, a and b cancel: moments are known to eps times these.
        rounding = _ROUNDING * np.abs(pressure).max(axis=1)
        there = np.abs(lack).max(axis=1) < np.maximum(_BALANCED, rounding)
        # Near the edge a and b are large and opposite: rounding is not what counts.
        lower = there | (energy <= self._energy[rows] + 1e-4 * np.abs(energy))
        step = np.linalg.solve(moments + 1e-16 * self._friction.whole, lack[:, :, None])[:, :, 0]
        self._pressure_step[rows] = np.where(lower[:, None], step, 0.3 * self._pressure_step[rows])
        taken = rows[lower]
        self._pressure[taken], self._energy[taken] = pressure[lower], energy[lower]
        self._moments[taken] = moments[lower]
        return np.asarray(there)

    def _minimise(self, rows: IntArray) -> BoolArray:
        """Take a step towards the motion against which friction is weakest; whether it is there."""
        motion = self._motion[rows] - self._motion_step[rows]
        work, slope, curved, distance = self._friction.work(self._pressure[rows], motion)
        step, gain = _newton_step(self._free[rows], slope, curved)
        lower = (work <= self._work[rows]) | (gain < _LEAST_WORK * work)
        stuck = ~lower & (gain < self._hidden * work)
        stuck &= np.abs(self._motion_step[rows]).max(axis=1) < _STUCK * np.abs(motion).max(axis=1)
        self._motion_step[rows] = np.where(lower[:, None], step, 0.3 * self._motion_step[rows])
        taken = rows[lower]
        self._motion[taken], self._work[taken] = motion[lower], work[lower]
        sure = np.maximum(_LEAST_WORK * work, _SURE * np.abs(work - 1 / self._trial[rows]))
        there = lower & (gain < sure) | stuck
        if there.any():
            solved = np.array([distance[there], np.broadcast_to([1.0, 0, 0], (int(there.sum()), 3))])
            by = np.linalg.solve(self._moments[rows[there]], np.moveaxis(solved, 0, 2))
            self._by_moments, self._by_force = by[:, :, 0], by[:, :, 1]
        return np.asarray(there)

    def _decide(self, rows: IntArray) -> BoolArray:
        """Say whether the force is enough, and choose the next; whether it is what is looked for."""
        P, least, by_force = self._trial[rows], self._least[rows], self._by_moments[:, 0]
        more = P * self._work[rows] - 1
        holds, before, steep = more >= 0, self._high[rows], self._slope[rows]
        # From here down it holds less, then more: between both it holds least.
        dips = holds & ~self._shallow[rows] & (self._low[rows] == 0) & (by_force < 0) & (steep > 0)
        dips &= more < _SHALLOW
        self._shallow[rows[dips]] = True
        holds &= ~dips
        self._high[rows[holds]], self._low[rows[more < 0]] = P[holds], P[more < 0]
        self._slope[rows[~dips]] = by_force[~dips]
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = np.where(by_force > 0, P - more / by_force, np.nan)
            bottom = P + (before - P) * by_force / (by_force - steep)
        close = ~dips & (np.abs(more) <= _ENOUGH)
        ends = holds & (least >= P)
        taken, rooted = holds | close, close & ~np.isnan(newton)
        self.force[rows[taken]] = np.where(ends, 0.0, np.where(rooted, newton, P))[taken]
        motion = self._motion[rows]
        by_load = np.column_stack([motion[:, :2], -self._by_moments[:, 1:], motion[:, 2]])
        by_load /= np.where(by_force > 0, by_force, np.inf)[:, None]
        self.gradient[rows[taken]] = by_load[taken]
        low, high = self._low[rows], self._high[rows]
        down = np.clip((1 + np.maximum(more, 0.0)) ** -0.7, *_DOWN) * P
        down = np.maximum(np.fmax(newton, down), least)
        middle = np.where(np.isfinite(high), 0.5 * (low + high), 1.5 * P)
        between = np.where((newton > low) & (newton < high), newton, middle)
        next_ = np.where(dips, bottom, np.where(low == 0, down, between))
        self._pressure[rows] = self._moved(rows, next_)
        self._trial[rows] = next_
        self._pressure_step[rows], self._motion_step[rows] = 0.0, 0.0
        self._energy[rows], self._work[rows] = np.inf, np.inf
        return np.asarray(ends | close | (high - low <= _ENOUGH * low))

    def _moved(self, rows: IntArray, force: FloatArray) -> FloatArray:
        """The pressures (k, 3) from which the search goes on with another force."""
        before, pressure, tip = self._trial[rows], self._pressure[rows], self._tip[rows]
        # To first order, at fixed moments.
        moved = (before[:, None] * pressure + (force - before)[:, None] * self._by_force) / force[:, None]
        # In larger steps what is pressed shrinks towards the edge: along it only where an end is free.
        size = ((1 - tip / force) / (1 - tip / before))[:, None]
        a, b, (first, last) = pressure[:, 0], pressure[:, 1:], self._ends[rows].swapaxes(0, 1)
        along = (last - first) / np.linalg.norm(last - first, axis=1)[:, None]
        beside = (b * along).sum(axis=1)[:, None] * along
        whole = (a + (b * first).sum(axis=1) > 0) & (a + (b * last).sum(axis=1) > 0)
        steeper = np.where(whole[:, None], (b - beside) / size + beside, b / size)
        edge = self._moment[rows] / np.maximum(tip, 1e-300)[:, None]
        shrunk = np.column_stack([a + ((b - steeper) * edge).sum(axis=1), steeper])
        return np.where(np.abs(size - 1) > _LARGE_STEP, shrunk, moved)
