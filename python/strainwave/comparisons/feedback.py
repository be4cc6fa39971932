"""What a servo on the other joint does to two estimators: Fig. 13."""

from __future__ import annotations

from strainwave.comparisons.estimates import (
    Way,
    curve,
    errors_of,
    estimated_curve,
    response_of,
)
from strainwave.comparisons.rig import Rig
from strainwave.records import Comparison, Control
from strainwave.report.curves import bode

_CLOSE_DB = 1.0
_WORSE = 2.0  # times PEM's error

_WAYS: tuple[tuple[Way, str], ...] = (
    ("pem", "prediction-error minimisation"),
    ("moesp", "subspace"),
)
_LOOPS: tuple[tuple[Control, str], ...] = (("open", "free"), ("servo", "servoed"))


def methods(rig: Rig) -> Comparison:
    """Fig. 13: PEM against subspace with the other joint free and servoed.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    Comparison
    """
    values: dict[str, float] = {}
    plots = []
    for way, method in _WAYS:
        truth = rig.prbs(1, other="servo").truth
        curves = curve("truth", response_of(truth), true=True)
        for other, loop in _LOOPS:
            run = rig.prbs(1, other=other)
            found = rig.estimate(run, way=way)
            curves += estimated_curve(f"joint 2 {loop}", found)
            e = errors_of(found, run.truth)
            values[f"{way}_{loop}_db"] = e.response_db
            values[f"{way}_{loop}_anti_resonance_percent"] = e.anti_resonance_percent
            values[f"{way}_{loop}_resonance_percent"] = e.resonance_percent
        plots.append(bode(curves, f"Joint 1 by {method}"))
    pem, moesp = values["pem_servoed_db"], values["moesp_servoed_db"]
    holds = pem < _CLOSE_DB and moesp > _WORSE * pem
    return Comparison(
        figure=13,
        title="PEM against subspace, joint 2 free or servoed",
        claim="In closed loop PEM still finds the joint's own response and the classical subspace "
        "method does not.",
        holds=holds,
        values=values,
        message=f"servoed: PEM {pem:.2f} dB off, anti-resonance "
        f"{values['pem_servoed_anti_resonance_percent']:+.1f} %; subspace {moesp:.2f} dB, "
        f"{values['moesp_servoed_anti_resonance_percent']:+.1f} %; free: "
        f"{values['pem_free_db']:.2f} and {values['moesp_free_db']:.2f} dB",
        plots=tuple(plots),
    )
