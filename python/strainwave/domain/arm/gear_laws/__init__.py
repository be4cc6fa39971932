"""Elastic laws of gears: a class for each value of `spring` in a study's `[[joint]]` table.

Rigid, linear T = K delta, cubic T = k_G delta + k_3 delta^3, and three slopes (Fig. 2). The terms
of the cubic law are the first two of any odd smooth law (Tuttle and Seering, IEEE Transactions on
Robotics and Automation 12(3), 1996). The three slopes K1, K2, K3 change at the torques T1 and T2,
which the core rounds over microradians. If only a part of the curve is known, the values contain
its first slopes and knees.

A new law needs a class in this package, an entry in `LAWS`, and its equations in
`rust/core/src/joint`. All other code asks the law of a joint.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache
from itertools import zip_longest
from types import MappingProxyType

import numpy as np

from strainwave.domain.arm.gear_laws.interface import STIFFNESS as STIFFNESS
from strainwave.domain.arm.gear_laws.interface import GearLaw as GearLaw
from strainwave.domain.arm.gear_laws.interface import GearParameter as GearParameter
from strainwave.domain.arm.gear_laws.interface import Values
from strainwave.domain.keys import FloatArray
from strainwave.domain.messages import plus_minus
from strainwave.errors import entry_of


class Linear(GearLaw):
    """One stiffness at all torsions."""

    name = "linear"
    parameters = (GearParameter(STIFFNESS, is_slope=True),)
    lists: Mapping[str, tuple[str, ...]] = {STIFFNESS: (STIFFNESS,)}

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """K delta."""
        return values[STIFFNESS] * torsion

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """K."""
        return np.full_like(torsion, values[STIFFNESS])

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Delta."""
        return torsion[:, None]

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """T / K."""
        return torque / values[STIFFNESS]


CUBIC = "gear_stiffness_cubic"

# Starting values. The equivalent linear stiffness exceeds the stiffness at zero torsion.
_STARTING_STIFFNESS_SHARE = 0.95  # of the equivalent linear stiffness
_STARTING_CUBIC_SHARE = 0.1  # cubic torque over linear torque at the largest torsion


class Cubic(GearLaw):
    """A gear that stiffens smoothly."""

    name = "cubic"
    parameters = (*Linear.parameters, GearParameter(CUBIC, by_load=True))
    simpler = Linear.name
    linearised_note = "the gear stiffens; the linear model has the stiffness at zero torsion"
    equivalent_note = "above the stiffness at zero torsion"

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """k_G delta + k_3 delta^3."""
        return (values[STIFFNESS] + values[CUBIC] * torsion**2) * torsion

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """k_G + 3 k_3 delta^2."""
        return values[STIFFNESS] + 3.0 * values[CUBIC] * torsion**2

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Delta and delta^3."""
        return np.column_stack([torsion, torsion**3])

    def polynomial(self, need: Callable[[str], float]) -> tuple[float, ...] | None:
        """k_G, 0 and k_3."""
        return need(STIFFNESS), 0.0, need(CUBIC)

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """Slightly lower stiffness at zero torsion, higher stiffness at the largest torque."""
        initial = _STARTING_STIFFNESS_SHARE * stiffness
        cubic = _STARTING_CUBIC_SHARE * initial / (largest_torque / initial) ** 2
        return {STIFFNESS: initial, CUBIC: cubic}


class Rigid(GearLaw):
    """Motor and link move as one body. The law has no parameters."""

    name = "rigid"
    elastic = False

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Zero without torsion, otherwise infinite."""
        return np.where(torsion == 0.0, 0.0, np.copysign(np.inf, torsion))

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Infinite."""
        return np.full_like(torsion, np.inf)

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """No columns."""
        return np.zeros((len(torsion), 0))

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Zero."""
        return np.zeros_like(torque)


SLOPES = ("gear_stiffness_k1", "gear_stiffness_k2", "gear_stiffness_k3")
KNEES = ("gear_knee_t1", "gear_knee_t2")

_STRAIGHT_KNEES = (1.0, 2.0)  # [N m] arbitrary knees of a straight line

# Starting values of the first search.
_STARTING_SLOPES = (0.8, 1.0, 1.15)  # over the equivalent linear stiffness
_STARTING_KNEES = (0.2, 0.6)  # over the largest gear torque

# Starting values of a restart from a curve with fewer than two knees.
_RESTART_KNEES = ((0.1, 0.3), (0.3, 0.7))  # over the largest gear torque, from a straight line
_RESTART_SLOPE_RATIO = 1.1  # of neighbouring slopes
_RESTART_LOWER_KNEE = 0.3  # over the only knee
_RESTART_KNEE_FACTORS = (0.75, 1.5)  # around the only knee

# Degenerate curves.
_MIN_SLOPE_DIFFERENCE = 0.01  # relative; a knee between closer slopes has no effect
_MIN_KNEE_TORQUE = 0.02  # over the largest gear torque; a search seldom resolves a lower knee
_MIN_KNEE_DISTANCE = 0.3  # relative; a search seldom separates closer knees

# Distinction of slopes by their covariance.
_MIN_DISTINCT_DIFFERENCE_STD = 3.0  # standard deviations between two distinct slopes
_MAX_EQUAL_DIFFERENCE = 0.1  # relative; the slopes of real gears differ by more


class ThreeSlope(GearLaw):
    """A gear that stiffens with the torque, as data sheets of strain-wave gears state."""

    name = "three-slope"
    parameters = (
        *(GearParameter(name, is_slope=True, by_load=True) for name in SLOPES),
        GearParameter(KNEES[0], by_load=True),
        GearParameter(KNEES[1], by_load=True, above=KNEES[0]),
    )
    simpler = "linear"
    linearised_by = SLOPES[1]
    linearised_note = "the gear has three slopes; the linear model has the middle one"
    equivalent_note = "between the lowest and the highest of the three slopes"
    lists: Mapping[str, tuple[str, ...]] = {STIFFNESS: SLOPES, "gear_knee_torque": KNEES}

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Sum over the slopes of K times the part of [0, |delta|] on the slope."""
        k, t = _curve(values)
        edges = np.concatenate([[0.0], np.cumsum(np.diff(t, prepend=0.0) / k[:-1]), [np.inf]])
        parts = np.clip(np.abs(torsion)[:, None], edges[:-1], edges[1:]) - edges[:-1]
        return np.asarray(np.copysign(parts @ k, torsion))

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Slope at the torque; at a knee the slope below it."""
        k, t = _curve(values)
        return np.asarray(k[np.searchsorted(t, np.abs(self.torque(values, torsion)))])

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Minus the stiffness times the derivatives of the torsion at constant torque.

        delta(T) = sum over the slopes of (part of [0, T] on the slope) / slope
        """
        k, t = _curve(values)
        torque = self.torque(values, torsion)
        parts = _parts_on_slopes(np.abs(torque), t)
        is_above = (np.abs(torque)[:, None] > t).astype(float)
        by_knee = is_above * (1.0 / k[:-1] - 1.0 / k[1:])
        signed = np.copysign(self.stiffness(values, torsion), torque)[:, None]
        return np.asarray(-signed * np.hstack([-parts / k**2, by_knee]))

    def stiffness_jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """One for the slope at the torque, zero for the other slopes and the knees."""
        k, t = _curve(values)
        index = np.searchsorted(t, np.abs(self.torque(values, torsion)))
        return np.asarray(np.eye(len(k), len(k) + len(t))[index])

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Sum over the slopes of (part of [0, |T|] on the slope) / slope."""
        k, t = _curve(values)
        return np.asarray(np.copysign(_parts_on_slopes(np.abs(torque), t) @ (1.0 / k), torque))

    def straight(self, stiffness: float) -> Values:
        """Three equal slopes."""
        return dict.fromkeys(SLOPES, stiffness) | dict(zip(KNEES, _STRAIGHT_KNEES, strict=True))

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """A stiffening curve with its knees well within the range of torques."""
        slopes = (share * stiffness for share in _STARTING_SLOPES)
        knees = (share * largest_torque for share in _STARTING_KNEES)
        return dict(zip(self.names, (*slopes, *knees), strict=True))

    def restarts(self, values: Mapping[str, float], largest_torque: float) -> Iterator[Values]:
        """Curves with three slopes near a curve with one knee or none.

        The objective has no gradient that moves a knee beyond the largest torque, a knee near zero,
        or a knee between equal slopes. Two close knees act as one: the slope between them has
        little effect, and a search seldom separates them.
        """
        slopes, knees = _distinct_slopes(values, largest_torque)
        if len(knees) == 2:
            return
        below, above = _RESTART_KNEE_FACTORS
        starts: list[tuple[list[float], list[float]]] = []
        if knees:
            (low, high), (knee,) = slopes, knees
            between, beyond = float(np.sqrt(low * high)), 0.5 * (knee + largest_torque)
            starts.append(([low, between, high], [below * knee, min(above * knee, beyond)]))
            starts.append(([low, high, _RESTART_SLOPE_RATIO * high], [knee, beyond]))
            lower = low / _RESTART_SLOPE_RATIO
            starts.append(([lower, low, high], [_RESTART_LOWER_KNEE * knee, knee]))
        else:
            start = [slopes[0] / _RESTART_SLOPE_RATIO, slopes[0], slopes[0] * _RESTART_SLOPE_RATIO]
            for shares in _RESTART_KNEES:
                starts.append((start, [share * largest_torque for share in shares]))
        for new_slopes, new_knees in starts:
            yield dict(zip(self.names, (*new_slopes, *new_knees), strict=True))

    def identified(
        self, values: Mapping[str, float], covariance: FloatArray, largest_torque: float
    ) -> Mapping[str, str | None]:
        """Estimate that represents each slope and knee; None if no record determines it.

        A knee is removed that is beyond the largest torque or between equal slopes, or not
        significant and small or, below a more precise slope, within its standard deviation of zero.
        The slopes and knees above it move down by one, and the last of each is not identified. Two
        close knees are one, without a slope between them. The more precise of two equal slopes
        represents both. If two slopes are neither distinct nor equal, the less precise of them and
        the knee between them are not identified.
        """
        index = {name: k for k, name in enumerate(self.names)}
        last = SLOPES[0]
        slopes, knees = list[str | None]([last]), list[str | None]()
        pairs = list(zip(SLOPES[1:], KNEES, strict=True))
        if values[KNEES[1]] < (1.0 + _MIN_KNEE_DISTANCE) * values[KNEES[0]]:
            pairs = [(SLOPES[2], KNEES[0])]
        for name, knee in pairs:
            if values[knee] >= largest_torque:
                continue
            a, b, at = index[last], index[name], index[knee]
            difference = abs(values[name] - values[last])
            variance = covariance[a, a] + covariance[b, b] - 2 * covariance[a, b]
            margin = _MIN_DISTINCT_DIFFERENCE_STD * np.sqrt(variance)
            is_certain = difference > margin and values[knee] ** 2 > (
                _MIN_DISTINCT_DIFFERENCE_STD**2 * covariance[at, at]
            )
            is_more_precise = bool(covariance[b, b] < covariance[a, a])
            is_small = values[knee] < _MIN_KNEE_TORQUE * largest_torque
            may_be_zero = is_more_precise and values[knee] ** 2 < covariance[at, at]
            at_zero = (is_small or may_be_zero) and not is_certain
            position = slopes.index(last)
            is_equal = difference + margin < _MAX_EQUAL_DIFFERENCE * values[last]
            if difference > max(_MIN_SLOPE_DIFFERENCE * values[last], margin) and not at_zero:
                slopes.append(name)
                knees.append(knee)
                last = name
            elif at_zero or is_equal:
                last = name if at_zero or is_more_precise else last
                slopes[position:] = [last]
                del knees[position:]
            else:
                slopes.append(name if is_more_precise else None)
                knees.append(None)
                if is_more_precise:
                    slopes[position], last = None, name
        estimates: dict[str, str | None] = {}
        for names, remaining in ((SLOPES, slopes), (KNEES, knees)):
            estimates |= dict(zip_longest(names, remaining))
        return estimates

    def drawn(self, known: Collection[str]) -> tuple[str, ...]:
        """The known slopes and the knees between them; a slope needs the knee below it."""
        slopes = [name for name in SLOPES if name in known]
        knees = [name for name in KNEES if name in known][: max(len(slopes) - 1, 0)]
        return (*slopes[: len(knees) + 1], *knees)

    def knees(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """T1 and T2."""
        return tuple(values[name] for name in KNEES if name in values)

    def parallel_springs(
        self, need: Callable[[str], float]
    ) -> tuple[tuple[float, float], ...] | None:
        """One spring per slope: each adds the increase of the stiffness beyond its knee."""
        k1, k2, k3 = (need(name) for name in SLOPES)
        t1, t2 = (need(name) for name in KNEES)
        first = t1 / k1
        second = first + (t2 - t1) / k2
        beyond = ((k2 - k1, first), (k3 - k2, second))
        return ((k1, 0.0), *(spring for spring in beyond if spring[0] != 0.0))

    def sentence(
        self, values: Mapping[str, float], std: Sequence[float], *, is_straight: bool
    ) -> str:
        """The slopes in order, then the knees."""
        k, t = _curve(values)
        units = [p.described.units[is_straight] for p in self.parameters]
        slopes = [" ± ".join(plus_minus(*pair)) for pair in zip(k, std, strict=False)]
        text = f"Slope {', then '.join(slopes)} {units[0]}"
        if len(t):
            knees = [" ± ".join(plus_minus(*p)) for p in zip(t, std[len(k) :], strict=True)]
            text += f", with knees at {' and '.join(knees)} {units[-1]}"
        return text


def _curve(values: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    slopes = [values[name] for name in SLOPES if name in values]
    return np.array(slopes), np.array([values[name] for name in KNEES if name in values])


def _parts_on_slopes(torque: FloatArray, knees: FloatArray) -> FloatArray:
    """Part of [0, T] on each slope: (n, n_slopes)."""
    edges = np.concatenate([[0.0], knees, [np.inf]])
    return np.asarray(np.clip(torque[:, None], edges[:-1], edges[1:]) - edges[:-1])


def _distinct_slopes(
    values: Mapping[str, float], largest: float
) -> tuple[list[float], list[float]]:
    """Distinct slopes within range, and the knees between them."""
    slopes, knees = [values[SLOPES[0]]], list[float]()
    for name, knee in zip(SLOPES[1:], KNEES, strict=True):
        slope, torque = values[name], values[knee]
        if torque < _MIN_KNEE_TORQUE * largest:
            slopes[-1] = slope
        elif torque < largest and abs(slope / slopes[-1] - 1.0) > _MIN_SLOPE_DIFFERENCE:
            slopes.append(slope)
            knees.append(torque)
    if len(knees) == 2 and knees[1] < (1.0 + _MIN_KNEE_DISTANCE) * knees[0]:
        return [slopes[0], slopes[2]], [float(np.sqrt(knees[0] * knees[1]))]
    return slopes, knees


RIGID = Rigid.name
"""Name of the law without elasticity, which the rigid step uses for every joint."""

AUTO = "auto"
"""Value of `spring` for the law that the data support; linear until they have decided."""

LAWS: dict[str, GearLaw] = {law.name: law for law in (Linear(), ThreeSlope(), Cubic(), Rigid())}
"""All laws by name."""


def gear_law(name: str) -> GearLaw:
    """The law with a name. Raises InvalidInput if there is none."""
    return entry_of(LAWS, name, "gear law", "spring")


@cache
def gear_parameters() -> Mapping[str, GearParameter]:
    """Parameters of all laws by name. Laws that share a name share the parameter."""
    parameters = (parameter for law in LAWS.values() for parameter in law.parameters)
    return MappingProxyType({parameter.name: parameter for parameter in parameters})


def is_slope(name: str) -> bool:
    """Whether a parameter is a stiffness of some law."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.is_slope


def is_by_load(name: str) -> bool:
    """Whether only a record that loads the gear far enough identifies a parameter of some law."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.by_load


def lists() -> Mapping[str, Mapping[int, tuple[str, ...]]]:
    """Keys of a parameter file that accept lists: parameter names by key and number of values."""
    keys: dict[str, dict[int, tuple[str, ...]]] = {}
    for law in LAWS.values():
        for key, listed in law.lists.items():
            keys.setdefault(key, {})[len(listed)] = listed
    for key, by_length in keys.items():
        if key != STIFFNESS:  # an empty list belongs to a law without such parameters
            by_length.setdefault(0, ())
    return keys


def curved_laws() -> tuple[GearLaw, ...]:
    """Laws with more than one stiffness, those with the fewest parameters first."""
    curved = (law for law in LAWS.values() if law.is_curved)
    return tuple(sorted(curved, key=lambda law: len(law.parameters)))


def stated_law(spring: str) -> GearLaw:
    """The law that `spring` names. Raises InvalidInput if there is none."""
    return gear_law(Linear.name if spring == AUTO else spring)


def determined_law(spring: str, known: Collection[str]) -> GearLaw:
    """The law of a gear whose parameters in `known` have values.

    With `spring = "auto"` this is the law of which `known` has a parameter of its own. Otherwise it
    is the stated law, or the simpler law if no parameter of the stated law itself is known.
    """
    law = stated_law(spring)

    def has_own(law: GearLaw, simpler: GearLaw) -> bool:
        return not set(law.names).difference(simpler.names).isdisjoint(known)

    if spring == AUTO:
        return next((curved for curved in curved_laws() if has_own(curved, law)), law)
    if law.simpler is None or has_own(law, gear_law(law.simpler)):
        return law
    return determined_law(law.simpler, known)
