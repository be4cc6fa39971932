"""servo.json has the numbers of the design."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from strainwave.domain import Payload
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.json_document import to_json
from strainwave.tune.plants import Condition


def document_of(design: ServoDesign) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(to_json(design))
    return document


def test_the_document_has_the_servo(filtered: ServoDesign) -> None:
    document = document_of(filtered)
    assert document["schema"] == "strainwave/servo/1"
    assert document["period"] == filtered.clock.period
    assert document["delay"] == filtered.clock.delay
    assert [each["limit"] for each in document["joints"]] == filtered.limits.tolist()
    assert (document["draws"], document["seed"], document["plants"]) == (5, 3, 6)
    assert document["required_margins"] == {"gain_db": 6.0, "phase_deg": 30.0, "modulus": 0.5}
    for entry, gains in zip(document["joints"], filtered.gains, strict=True):
        for name in ("kp", "ki", "position_gain"):
            assert entry[name] == getattr(gains, name)
        law = gains.law()
        for name in "ABCDE":
            assert entry["law"][name] == getattr(law, name).tolist()
        assert entry["law"]["states"] == list(law.names)
        assert entry["law"]["holds"] == law.holds.tolist()
    first = document["joints"][0]
    assert first["units"]["kp"] == "V s/rad"
    assert [one["kind"] for one in first["filters"]] == ["notch", "low-pass"]
    assert first["filters"][0]["b"] == list(filtered.gains[0].filters[0].b)


def test_margins_have_their_plant(design: ServoDesign) -> None:
    """Two conditions, of which the second has the worst phase."""
    loaded = Condition(np.zeros(2), Payload(2.0, (0.1, 0.0, 0.0)))
    margins = design.joints[0].results.margins
    phase = np.array([50.0, 40.0, 60.0, 31.0, 50.0, 45.0])
    changed = replace(margins, phase_deg=phase, gain_db=np.full(6, np.inf))
    first = design.joints[0]
    design = replace(
        design,
        conditions=(*design.conditions, loaded),
        condition=np.array([0, 1] * 3),
        draw=np.array([0, 0, 1, 1, 2, 2]),
        joints=(replace(first, results=replace(first.results, margins=changed)), design.joints[1]),
    )
    document = document_of(design)
    assert document["conditions"][1] == {
        "posture": [0.0, 0.0],
        "payload": {"mass": 2.0, "xyz": [0.1, 0.0, 0.0]},
    }
    found = document["joints"][0]["margins"]
    expected = {"worst": 31.0, "worst_condition": 1, "worst_draw": 1, "median": 47.5}
    assert expected.items() <= found["phase"].items()
    assert found["phase"]["worst_hz"] == margins.phase_hz[3]
    assert found["gain"]["worst"] is None  # a loop without crossing


def test_shapers_are_on_the_clock(design: ServoDesign) -> None:
    for entry, ranked in zip(document_of(design)["shapers"], design.shapers, strict=True):
        weights = np.zeros(entry["samples"][-1] + 1)
        weights[entry["samples"]] = entry["amplitudes"]
        assert weights.tolist() == ranked.impulses.amplitudes.tolist()
        samples = np.array(entry["times"]) / design.clock.period
        np.testing.assert_allclose(samples, entry["samples"], rtol=1e-12)
        assert entry["vibration"] == ranked.vibration


def test_the_current_servo_is_listed(design: ServoDesign) -> None:
    servo = design.arm.study.arm.servo
    assert servo is not None
    for entry, kp in zip(document_of(design)["joints"], servo.kp, strict=True):
        assert entry["current"]["kp"] == kp
        assert entry["current"]["is_stable"]
    unstable = [replace(each, current_results=None) for each in design.joints]
    document = document_of(replace(design, joints=tuple(unstable)))
    assert all(entry["current"]["margins"] is None for entry in document["joints"])
    bare = [replace(each, current=None, current_results=None) for each in design.joints]
    document = document_of(replace(design, joints=tuple(bare)))
    assert all(entry["current"] is None for entry in document["joints"])


def test_the_document_has_observers_and_damping(design: ServoDesign) -> None:
    document = document_of(design)
    for entry, observer in zip(document["observers"], design.observers, strict=True):
        system = observer.system
        assert entry["inputs"] == list(system.inputs)
        for name in "ABCD":
            assert entry[name] == getattr(system, name).tolist()
        assert entry["readings"][0]["name"] == "motor encoder"
        assert entry["rms_errors"]["by_observer"] < entry["rms_errors"]["by_motor"]
    for entry, damping in zip(document["damping"], design.dampings, strict=True):
        assert entry["is_used"] == (not damping.reason)
        assert (entry["law"] is None) == bool(damping.reason)
        if damping.reason:
            assert entry["reason"] == damping.reason
        else:
            assert entry["law"]["A"] == damping.law.A.tolist()
