"""Delays and scales of link sensors in the whole-arm fit: there by evidence only.

A score test says whether the residuals follow what a sensor's delay or scale would make of its
channel. A sensor without either costs nothing, and a clean rig's intervals stay as narrow as they
are: beside a free delay gear damping would be known less well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.link_sensors import (
    LARGEST_SCALE_ERROR,
    LONGEST_DELAY,
    is_sensor_constant,
    nominal,
)
from strainwave.records import Diagnostic, FloatArray, Parameter, TuningOptions
from strainwave.tuning.estimates import Fit
from strainwave.tuning.objective import Evaluated, Misfit
from strainwave.tuning.parametrisation import Key, Search, Unknown
from strainwave.tuning.restricted import is_held
from strainwave.tuning.solver import again_roughly, refined

_EVIDENT = 4.0  # deviations at which a constant joins: of eight candidates none by chance
_MATTERS_ROUGHLY = 0.1  # and share of the cost far from the minimum, where long steps err as well
_STAYS = 3.0  # and that it must keep, by the more cautious covariance

_AT_END = 0.99  # share of its range from which a constant is at its end
_WORTH_DELAY = 1e-4  # [s] from which a rig is worth a look: half a sample of a usual logger
_WORTH_SCALE = 0.01  # what data sheets promise


def with_sensors(search: Search, keys: Sequence[Key]) -> Search:
    """The unknowns of some sensors' constants beside those there are.

    Parameters
    ----------
    search : Search
    keys : sequence of (name, joint)

    Returns
    -------
    Search
    """
    more = []
    for name, joint in keys:
        unit, scale = (
            ("s", LONGEST_DELAY) if name.endswith("_delay") else ("1", LARGEST_SCALE_ERROR)
        )
        more.append(Unknown(name, joint, unit, nominal((name, joint)), scale, True, 1.0))
    rows = np.pad(search.prior.rows, ((0, 0), (0, len(more))))
    return Search((*search.unknowns, *more), search.fixed, replace(search.prior, rows=rows))


def with_evident_sensors(fit: Fit, options: TuningOptions, *, rough: bool) -> Fit:
    """A fit with those sensor constants besides that its residuals speak for.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions
    rough : bool
        Whether the fit is only near the minimum, and may stay so.

    Returns
    -------
    Fit
    """
    while fit.iterations < options.max_iterations and not options.as_published:
        sizes = _evident(fit, options, _MATTERS_ROUGHLY * fit.cost if rough else 0.0)
        if not sizes:
            break
        values = fit.misfit.search.values(fit.z)
        search = with_sensors(fit.misfit.search, list(sizes))
        begin = search.coordinates(values | sizes)
        misfit = fit.misfit.for_unknowns(search)
        if rough:
            fit = again_roughly(misfit, begin, fit.iterations, options)
        else:
            fit = _refined_from(fit, misfit, begin, options)
    return fit


def _refined_from(fit: Fit, misfit: Misfit, z: FloatArray, options: TuningOptions) -> Fit:
    """The minimum near a point, by other unknowns than the fit's."""
    near = replace(fit, misfit=misfit, z=z, cost=np.inf, converged=False)
    return refined(near, options)


def without_idle_sensors(fit: Fit, options: TuningOptions) -> Fit:
    """Again without the sensor constants that are nothing as far as the records say.

    Parameters
    ----------
    fit : Fit
    options : TuningOptions

    Returns
    -------
    Fit
    """
    while idle := _idle(fit):
        values = fit.misfit.search.values(fit.z)
        search = fit.misfit.search.holding(idle)
        fit = _refined_from(
            fit, fit.misfit.for_unknowns(search), search.coordinates(values), options
        )
    return fit


def _idle(fit: Fit) -> dict[Key, float]:
    """The least evident of those constants, at its nominal value; empty if there is none.

    One at the end of its range is wrong, whatever its deviation by a fit that it spoils.
    """
    search = fit.misfit.search
    if not any(is_sensor_constant(key) for key in search.keys):
        return {}
    deviation = np.sqrt(np.diag(fit.confidence.cautious))
    inside = (fit.z > _AT_END * search.lower) & (fit.z < _AT_END * search.upper)
    rows = zip(search.keys, search.parameters(fit.z), deviation, inside, strict=True)
    apart = {
        key: abs(value - nominal(key)) / std
        for key, value, std, within in rows
        if is_sensor_constant(key) and within
    }
    least = min(apart, key=lambda key: apart[key], default=None)
    return {least: nominal(least)} if least is not None and apart[least] < _STAYS else {}


def _evident(fit: Fit, options: TuningOptions, least: float) -> dict[Key, float]:
    """Sensor constants that a linear step would give a value that is evident, with that value.

    One after the other, each beside those before it, as long as it gains at least so much.
    """
    known = set(fit.misfit.search.keys)
    candidates = [
        key
        for key in dict.fromkeys(k for r in fit.misfit.records for k in r.sensor_constants())
        if key not in known and not is_held(key, options)
    ]
    if not candidates:
        return {}
    factor = _scores(fit, candidates)
    columns, target = factor[:, :-1], factor[:, -1]
    taken: list[int] = []
    left = float(target @ target)
    while len(taken) < len(candidates):
        costs = {k: _left(columns[:, [*taken, k]], target) for k in range(len(candidates))}
        best = min((k for k in costs if k not in taken), key=lambda k: costs[k])
        if left - costs[best] < max(_EVIDENT**2, least):
            break
        taken.append(best)
        left = costs[best]
    if not taken:
        return {}
    sizes = np.linalg.lstsq(columns[:, taken], -target)[0]
    return {
        candidates[k]: nominal(candidates[k]) + float(size)
        for k, size in zip(taken, sizes, strict=True)
    }


def _scores(fit: Fit, keys: Sequence[Key]) -> FloatArray:
    misfit = fit.misfit
    values, simulated = misfit.search.values(fit.z), misfit.simulated(fit.z)

    def tangent(k: int, _: Evaluated) -> FloatArray:
        return misfit.records[k].sensor_tangent(simulated[k], values, keys)

    return misfit.bordered(fit.z, len(keys), tangent)


def _left(columns: FloatArray, target: FloatArray) -> float:
    """The least squares cost with some columns."""
    step = np.linalg.lstsq(columns, -target)[0]
    return float(np.sum((target + columns @ step) ** 2))


def sensor_cautions(parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """What a reader must know of a rig whose link sensors are late or out of scale.

    Parameters
    ----------
    parameters : sequence of Parameter

    Yields
    ------
    Diagnostic
    """
    for found in parameters:
        key = found.name, found.joint
        if not is_sensor_constant(key) or found.value is None:
            continue
        least = _WORTH_DELAY if found.name.endswith("_delay") else _WORTH_SCALE
        if abs(found.value - nominal(key)) < least:
            continue
        sensor = found.name.rsplit("_", 1)[0].replace("_", " ")
        half = 1.96 * (found.std or 0.0)
        if found.name.endswith("_delay"):
            side = "behind" if found.value > 0.0 else "ahead of"
            text = f"the {sensor} is {1e3 * abs(found.value):.3g} ± {1e3 * half:.2g} ms {side} the"
            text += (
                " motor encoder; estimated and corrected. Likely causes: its bandwidth is missing"
            )
            text += " from the study, latency of its converter or bus, time stamps"
            yield Diagnostic("sensor-delay", f"joint {found.joint}", text)
        else:
            text = f"the {sensor} reads {found.value:.4g} ± {half:.2g} times the motion; estimated"
            text += (
                " and corrected. Likely causes: its calibration, its distance from the axis in the"
            )
            text += " study, its direction"
            yield Diagnostic("sensor-scale", f"joint {found.joint}", text)
