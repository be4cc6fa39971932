"""Three slopes and the torques at which they change: Fig. 2.

Slope K1 up to the torque T1, K2 up to T2, K3 beyond; the core rounds the knees over microradians.
Where a curve is known in part, the slopes and knees that have values come first.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.formatting import plus_minus
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter, Values

SLOPES = ("gear_stiffness_k1", "gear_stiffness_k2", "gear_stiffness_k3")
KNEES = ("gear_knee_t1", "gear_knee_t2")

_STRAIGHT_KNEES = (1.0, 2.0)  # [N m] of a curve that bends nowhere
_SPREAD = (0.8, 1.0, 1.15)  # of the one stiffness found: the slopes to start from
_REACHED = (0.2, 0.6)  # of the largest gear torque: the knees to start from
_SAME = 0.01  # relative difference below which two slopes are one
_ALIKE = 0.1  # relative difference within which slopes are one: those of a gear are further apart
_NOTHING = 0.02  # share of the largest torque below which a knee is at zero
_CLOSE = 0.3  # relative distance below which two knees are one
_FEW = ((0.1, 0.3), (0.3, 0.7))  # of the largest torque: knees where no bend was found
_RISE = 1.1  # of slopes to start from that are one
_BEFORE = 0.3  # of a knee to start from: the one before it, which was lost
_EVIDENT = 3.0  # deviations by which two slopes differ at least


class ThreeSlope(GearLaw):
    """Strain-wave gears stiffen with the torque, as their data sheets have it."""

    name = "three-slope"
    parameters = (
        *(GearParameter(name, is_slope=True, by_load=True) for name in SLOPES),
        GearParameter(KNEES[0], by_load=True),
        GearParameter(KNEES[1], by_load=True, above=KNEES[0]),
    )
    simpler = "linear"
    linearised_by = SLOPES[1]
    linearised_note = "its gear has three slopes; the linear model has the middle one"
    equivalent_note = "between the softest and the stiffest of the three"
    lists: Mapping[str, tuple[str, ...]] = {STIFFNESS: SLOPES, "gear_knee_torque": KNEES}

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Sum over the slopes of K times the length of [0, |delta|] that lies on each."""
        k, t = _curve(values)
        bends = np.concatenate([[0.0], np.cumsum(np.diff(t, prepend=0.0) / k[:-1]), [np.inf]])
        on = np.clip(np.abs(torsion)[:, None], bends[:-1], bends[1:]) - bends[:-1]
        return np.asarray(np.copysign(on @ k, torsion))

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Of the slope that the torque lies on; at a knee the one before it."""
        k, t = _curve(values)
        return np.asarray(k[np.searchsorted(t, np.abs(self.torque(values, torsion)))])

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Minus the stiffness times the derivatives of the torsion at a torque.

        delta(T) = sum over the slopes of (length of [0, T] that lies on each) / slope.
        """
        k, t = _curve(values)
        torque = self.torque(values, torsion)
        on = _on_slopes(np.abs(torque), t)
        past = (np.abs(torque)[:, None] > t).astype(float)
        by_knee = past * (1.0 / k[:-1] - 1.0 / k[1:])
        signed = np.copysign(self.stiffness(values, torsion), torque)[:, None]
        return np.asarray(-signed * np.hstack([-on / k**2, by_knee]))

    def stiffness_jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """One for the slope that the torque lies on, nothing for the others and the knees."""
        k, t = _curve(values)
        at = np.searchsorted(t, np.abs(self.torque(values, torsion)))
        return np.asarray(np.eye(len(k), len(k) + len(t))[at])

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Sum over the slopes of (length of [0, |T|] that lies on each) / slope."""
        k, t = _curve(values)
        return np.asarray(np.copysign(_on_slopes(np.abs(torque), t) @ (1.0 / k), torque))

    def straight(self, stiffness: float) -> Values:
        """Slopes that are one, with knees where nothing bends."""
        return dict.fromkeys(SLOPES, stiffness) | dict(zip(KNEES, _STRAIGHT_KNEES, strict=True))

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """A curve that stiffens, its knees well within the torques reached."""
        slopes = {name: share * stiffness for name, share in zip(SLOPES, _SPREAD, strict=True)}
        knees = {n: share * largest_torque for n, share in zip(KNEES, _REACHED, strict=True)}
        return slopes | knees

    def restarts(self, values: Mapping[str, float], largest_torque: float) -> Iterator[Values]:
        """Curves of three slopes near one that bends only once, or not at all.

        A knee beyond the largest torque, one near zero, and one between equal slopes bend nothing:
        no derivative would ever bring them back. Two knees close together are as good as one: the
        slope between them is hardly felt, and a search that came there from far seldom gets them
        apart again.
        """
        slopes, knees = _bends(values, largest_torque)
        if len(knees) == 2:
            return
        found: list[tuple[list[float], list[float]]] = []
        if knees:
            (low, high), (knee,) = slopes, knees
            between, beyond = float(np.sqrt(low * high)), 0.5 * (knee + largest_torque)
            found.append(([low, between, high], [0.75 * knee, min(1.5 * knee, beyond)]))
            found.append(([low, high, _RISE * high], [knee, beyond]))
            found.append(([low / _RISE, low, high], [_BEFORE * knee, knee]))
        else:
            spread = [slopes[0] / _RISE, slopes[0], slopes[0] * _RISE]
            found += [(spread, [share * largest_torque for share in shares]) for shares in _FEW]
        for curve, bends in found:
            yield dict(zip(self.names, (*curve, *bends), strict=True))

    def identified(
        self, values: Mapping[str, float], covariance: FloatArray, largest_torque: float
    ) -> Mapping[str, str | None]:
        """For each slope and knee the one that holds it, or None where no record reaches it.

        A knee between two slopes that are one, at zero, or beyond the largest torque, is none: what
        lies behind it moves up, and the last of its kind is not identified. Of two slopes that are
        one the better known stands for both. Of two of which that is not known either, the one
        that is known less well is not identified, nor the knee between.
        """
        at = {name: k for k, name in enumerate(self.names)}
        last = SLOPES[0]
        slopes, knees = list[str | None]([last]), list[str | None]()
        for name, knee in zip(SLOPES[1:], KNEES, strict=True):
            if values[knee] >= largest_torque:
                continue
            at_zero = values[knee] < _NOTHING * largest_torque
            a, b = at[last], at[name]
            apart = abs(values[name] - values[last])
            spread = _EVIDENT * np.sqrt(covariance[a, a] + covariance[b, b] - 2 * covariance[a, b])
            better = bool(covariance[b, b] < covariance[a, a])
            place = slopes.index(last)
            one = apart + spread < _ALIKE * values[last]
            if apart > max(_SAME * values[last], spread) and not at_zero:
                slopes.append(name)
                knees.append(knee)
                last = name
            elif at_zero or one:
                last = name if at_zero or better else last
                slopes[place:] = [last]
                del knees[place:]
            else:
                slopes.append(name if better else None)
                knees.append(None)
                if better:
                    slopes[place], last = None, name
        found: dict[str, str | None] = {}
        for names, left in ((SLOPES, slopes), (KNEES, knees)):
            found |= {n: left[k] if k < len(left) else None for k, n in enumerate(names)}
        return found

    def drawn(self, known: Collection[str]) -> tuple[str, ...]:
        """The slopes that are known and the knees between: a slope has no place beyond others."""
        slopes = [name for name in SLOPES if name in known]
        knees = [name for name in KNEES if name in known][: max(len(slopes) - 1, 0)]
        return (*slopes[: len(knees) + 1], *knees)

    def knees(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """T1 and T2."""
        return tuple(values[name] for name in KNEES if name in values)

    def parallel_springs(
        self, need: Callable[[str], float]
    ) -> tuple[tuple[float, float], ...] | None:
        """One a slope: the second and third have what the stiffness rises by beyond their knee."""
        k1, k2, k3 = (need(name) for name in SLOPES)
        t1, t2 = (need(name) for name in KNEES)
        first = t1 / k1
        second = first + (t2 - t1) / k2
        beyond = ((k2 - k1, first), (k3 - k2, second))
        return ((k1, 0.0), *(spring for spring in beyond if spring[0] != 0.0))

    def sentence(
        self, values: Mapping[str, float], std: Sequence[float], *, is_straight: bool
    ) -> str:
        """The slopes in turn, and the knees between."""
        k, t = _curve(values)
        units = [p.described.units[is_straight] for p in self.parameters]
        slopes = [" ± ".join(plus_minus(*pair)) for pair in zip(k, std, strict=False)]
        text = f"Slope {', then '.join(slopes)} {units[0]}"
        if len(t):
            knees = [" ± ".join(plus_minus(*p)) for p in zip(t, std[len(k) :], strict=True)]
            text += f", with knees at {' and '.join(knees)} {units[-1]}"
        return text


def _curve(values: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """The slopes that have values, and the knees between them."""
    slopes = [values[name] for name in SLOPES if name in values]
    return np.array(slopes), np.array([values[name] for name in KNEES if name in values])


def _on_slopes(torque: FloatArray, knees: FloatArray) -> FloatArray:
    """Length of [0, T] that lies on each slope: (n, n_slopes)."""
    edges = np.concatenate([[0.0], knees, [np.inf]])
    return np.asarray(np.clip(torque[:, None], edges[:-1], edges[1:]) - edges[:-1])


def _bends(values: Mapping[str, float], largest: float) -> tuple[list[float], list[float]]:
    """The slopes that differ and lie within reach, and the knees between them."""
    slopes, knees = [values[SLOPES[0]]], list[float]()
    for name, knee in zip(SLOPES[1:], KNEES, strict=True):
        slope, torque = values[name], values[knee]
        if torque < _NOTHING * largest:
            slopes[-1] = slope
        elif torque < largest and abs(slope / slopes[-1] - 1.0) > _SAME:
            slopes.append(slope)
            knees.append(torque)
    if len(knees) == 2 and knees[1] < (1.0 + _CLOSE) * knees[0]:
        return [slopes[0], slopes[2]], [float(np.sqrt(knees[0] * knees[1]))]
    return slopes, knees
