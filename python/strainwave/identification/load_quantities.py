"""Mass, centre and inertias of a load with intervals, and which of them the data determine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    BoolArray,
    Diagnostic,
    FloatArray,
    IntArray,
    LinkPrior,
    LoadQuantities,
    Payload,
    Place,
    Quantity,
)
from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.domain.results.distributions import chi_square_limit
from strainwave.domain.results.payload import INERTIAS
from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.identification.payload import N_PARAMETERS, LoadFit, central_parameters

AXES = ("x", "y", "z")

MAX_CENTRE_HALF_WIDTH = 0.1
"""[m] Half-width of a 95 % interval above which a coordinate of the centre is null. Tools and
workpieces reach 0.1 to 0.3 m beyond the flange: a wider interval says no more than that."""

_MASS, _N_FIRST = 0, 4  # mass and first moments come before the inertias
# from the standard parameters xx, xy, yy, xz, yz, zz to `INERTIAS`
_ORIGIN_ORDER = (4, 5, 7, 6, 8, 9)
_SEEN_LEVEL = 0.05  # probability with which no load counts as seen
_CONTRADICTED_LEVEL = 1e-3  # probability with which a correctly stated load seems contradicted
# Data sheets state torque constants within 5 to 10 %, and magnets lose 0.1 % per kelvin.
_TORQUE_CONSTANT_TOLERANCE = 0.05
_LOAD = Place(part="load")


def quantities_of(fit: LoadFit) -> LoadQuantities:
    """Quantities of a load. Raises NotIdentifiable if the data determine none of its parameters.

    A mass is not negative: an interval that reaches zero is one-sided. The interval of the centre
    h/m is that of Fieller: all c for which h - c m is zero within its errors.
    """
    if not fit.is_determined.any():
        raise NotIdentifiable(
            "the motion determines neither the mass nor a first moment nor an inertia of the load: "
            "turn the last link about several axes, with gravity and accelerations that load the "
            "joints"
        )
    stds, known, width = fit.stds, fit.is_determined, fit.half_width

    def standard(k: int, unit: str) -> Quantity | None:
        return _quantity(fit.value[k], stds[k], width, unit) if known[k] else None

    mass = standard(_MASS, "kg")
    if mass is not None and mass.ci95[0] < 0.0 <= mass.ci95[1]:
        mass = _not_negative(mass)
    empty: tuple[None, ...] = (None,) * 3
    xyz: tuple[Quantity | None, ...] = empty
    inertias: tuple[Quantity | None, ...] = empty * 2
    if mass is not None and mass.ci95[0] > 0.0:
        values, covariance = fit.about_centre
        spread = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
        xyz = tuple(_centre(fit, k, float(spread[k])) if known[k] else None for k in range(1, 4))
        inertias = tuple(
            _inertia(name, values[k], spread[k], fit) if _has_inertia(known, name) else None
            for k, name in enumerate(INERTIAS, start=4)
        )
    return LoadQuantities(
        mass=mass,
        xyz=xyz,
        inertia_about_centre=inertias,
        first_moments=tuple(standard(k, "kg m") for k in range(1, 4)),
        inertia_about_origin=tuple(standard(k, "kg m^2") for k in _ORIGIN_ORDER),
    )


def _quantity(value: float, std: float, width: float, unit: str) -> Quantity:
    return Quantity(
        float(value), float(std), (float(value - width * std), float(value + width * std)), unit
    )


def _not_negative(quantity: Quantity) -> Quantity:
    """The quantity with a one-sided interval, which begins at zero."""
    low, high = quantity.ci95
    upper = max(high, 0.5 * (high - low))
    return Quantity(max(quantity.value, 0.0), quantity.std, (0.0, upper), quantity.unit)


def _centre(fit: LoadFit, k: int, std: float) -> Quantity | None:
    """A coordinate of the centre, h/m, with Fieller's interval; None if it is too wide."""
    (m, h), q2 = fit.value[[0, k]], fit.half_width**2
    V = fit.covariance[np.ix_([0, k], [0, k])]
    a, b, c = m * m - q2 * V[0, 0], h * m - q2 * V[0, 1], h * h - q2 * V[1, 1]
    root = np.sqrt(max(b * b - a * c, 0.0))
    low, high = float((b - root) / a), float((b + root) / a)
    if 0.5 * (high - low) > MAX_CENTRE_HALF_WIDTH:
        return None
    return Quantity(float(h / m), std, (low, high), "m")


def _has_inertia(known: BoolArray, name: str) -> bool:
    """Whether an inertia about the centre follows from determined standard parameters."""
    k = _ORIGIN_ORDER[INERTIAS.index(name)]
    of_steiner = set(AXES) - set(name) if name[0] == name[1] else set(name)
    return bool(known[0] and known[k] and all(known[1 + AXES.index(a)] for a in of_steiner))


def _inertia(name: str, value: float, std: float, fit: LoadFit) -> Quantity | None:
    """An inertia about the centre; None if its interval excludes no compact body of this mass."""
    quantity = _quantity(value, std, fit.half_width, "kg m^2")
    if fit.half_width * std > fit.value[0] * MAX_CENTRE_HALF_WIDTH**2:
        return None
    low, high = quantity.ci95
    is_moment = name[0] == name[1]
    return _not_negative(quantity) if is_moment and low < 0.0 <= high else quantity


def body_of(fit: LoadFit, quantities: LoadQuantities) -> tuple[LinkPrior, tuple[str, ...]]:
    """Standard parameters of a body for controllers, and names of what is not determined in it.

    Mass and coordinates of the centre are the estimates where these are determined. All else is
    that of the nearest consistent body, a compact one where the data say nothing.
    """
    try:
        nearest = fit.consistent
    except NumericalFailure:  # inertias of no body beyond their errors
        known = fit.is_determined & (np.arange(N_PARAMETERS) < _N_FIRST)
        nearest = replace(fit, is_determined=known).consistent
    central, _ = central_parameters(np.array(nearest), np.zeros(N_PARAMETERS))
    mass, centre = central[0], central[1:4]
    if quantities.mass is not None:
        mass = quantities.mass.value
    for k, coordinate in enumerate(quantities.xyz):
        centre[k] = centre[k] if coordinate is None else coordinate.value
    inertia = np.zeros((3, 3))
    inertia[np.triu_indices(3)] = central[4:]
    inertia += np.triu(inertia, 1).T
    names = (*AXES, *(f"I{name}" for name in INERTIAS))
    members = (*quantities.xyz, *quantities.inertia_about_centre)
    assumed = tuple(name for name, each in zip(names, members, strict=True) if each is None)
    return standard_parameters(float(mass), centre, inertia), assumed


def with_gain_errors(fit: LoadFit, relative_std: float) -> LoadFit:
    """The fit with the error of identified torque constants, which scales the load."""
    scale = relative_std**2 * np.outer(fit.value, fit.value)
    return replace(fit, covariance=fit.covariance + scale)


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Comparison of an estimated load with the stated one."""

    scale: Quantity | None  # true torque over stated torque; None: the load is not seen
    is_explained: bool  # one factor on all torques explains the difference


def compare_with_stated(fit: LoadFit, stated: Payload) -> ScaleCheck:
    """The factor on all torques with which the estimated load is the stated one.

    Mass and first moments a = s p + e with the stated p, Cov e = C: the torques are stated too
    large by s, so the true torque is 1/s of the stated one. If no s explains all of them, that of
    the mass alone is returned, which the place of the load does not change.
    """
    at = np.flatnonzero(fit.is_determined[:_N_FIRST])
    p, limit = np.array(stated.parameters), chi_square_limit(_CONTRADICTED_LEVEL, len(at) - 1 or 1)
    s, std, distance = _factor(fit, p, at)
    is_explained = distance <= limit
    if not is_explained and fit.is_determined[_MASS]:
        s, std, _ = _factor(fit, p, at[:1])
    reach = fit.half_width * std
    if not s > reach:
        return ScaleCheck(None, is_explained)
    interval = (1.0 / (s + reach), 1.0 / (s - reach))
    return ScaleCheck(Quantity(1.0 / s, std / s**2, interval, ""), is_explained)


def _factor(fit: LoadFit, p: FloatArray, at: IntArray) -> tuple[float, float, float]:
    """Factor s of a = s p + e, its standard deviation, and the squared distance that is left."""
    p, a = p[at], fit.value[at]
    if not p.any():
        return 0.0, 0.0, 0.0
    weight = np.linalg.inv(fit.covariance[np.ix_(at, at)])
    s, std = float(p @ weight @ a / (p @ weight @ p)), float((p @ weight @ p) ** -0.5)
    rest = a - s * p
    return s, std, float(rest @ weight @ rest)


def warnings_of(
    fit: LoadFit, quantities: LoadQuantities, *, scale_is_known: bool
) -> tuple[Diagnostic, ...]:
    """Warnings on an estimate: load not seen or moved, members without value, torque scale.

    `scale_is_known`: a known load has given the torque constants, or is compared with this one.
    """
    warnings = []
    mass, at = quantities.mass, np.flatnonzero(fit.is_determined[:_N_FIRST])
    seen = 0.0
    if len(at):
        value, covariance = fit.value[at], fit.covariance[np.ix_(at, at)]
        seen = float(value @ np.linalg.solve(covariance, value))
        seen /= chi_square_limit(_SEEN_LEVEL, len(at))
    is_seen = seen > 1.0
    if mass is not None and mass.ci95[1] < 0.0:
        low, high = (-limit for limit in reversed(mass.ci95))
        warnings.append(Diagnostic("load-negative", _LOAD, mass=-mass.value, low=low, high=high))
    elif mass is not None and mass.ci95[0] <= 0.0:
        variant = "mass" if is_seen else ""
        warnings.append(Diagnostic("load-not-seen", _LOAD, variant, upper=mass.ci95[1]))
    elif mass is None and not is_seen and len(at):
        warnings.append(Diagnostic("load-not-seen", _LOAD, "moments"))
    if fit.shift > 1.0:
        warnings.append(Diagnostic("load-moved", _LOAD, ratio=fit.shift))
    pairs = zip(INERTIAS, quantities.inertia_about_centre, strict=True)
    negative = (name for name, each in pairs if name[0] == name[1] and each and each.ci95[1] < 0.0)
    if names := tuple(negative):
        warnings.append(Diagnostic("load-impossible", _LOAD, names=names))
    warnings += _without_value(fit, quantities)
    if mass is not None and mass.ci95[0] > 0.0 and not scale_is_known:
        of_scale = _TORQUE_CONSTANT_TOLERANCE * mass.value
        share = of_scale**2 / (of_scale**2 + mass.std**2)
        if share > 0.5:
            warnings.append(
                Diagnostic(
                    "torque-scale",
                    _LOAD,
                    tolerance=_TORQUE_CONSTANT_TOLERANCE,
                    error=of_scale,
                    std=mass.std,
                    share=share,
                )
            )
    return tuple(warnings)


def _without_value(fit: LoadFit, quantities: LoadQuantities) -> Iterator[Diagnostic]:
    """Warnings of members that are null, with the reason."""
    if quantities.mass is None:
        yield Diagnostic("load-undetermined", _LOAD, "mass")
        return
    if quantities.mass.ci95[0] <= 0.0:  # `load-not-seen` and `load-negative` have the reason
        return
    unmoved = [a for k, a in enumerate(AXES, start=1) if not fit.is_determined[k]]
    wide = [a for a, q in zip(AXES, quantities.xyz, strict=True) if q is None and a not in unmoved]
    if unmoved:
        yield Diagnostic("load-undetermined", _LOAD, "unmoved", names=tuple(unmoved))
    if wide:
        limit = MAX_CENTRE_HALF_WIDTH
        yield Diagnostic("load-undetermined", _LOAD, "wide", names=tuple(wide), limit=limit)
    pairs = zip(INERTIAS, quantities.inertia_about_centre, strict=True)
    missing = tuple(name for name, quantity in pairs if quantity is None)
    if missing:
        limit = quantities.mass.value * MAX_CENTRE_HALF_WIDTH**2
        yield Diagnostic("load-undetermined", _LOAD, "inertia", names=missing, limit=limit)
