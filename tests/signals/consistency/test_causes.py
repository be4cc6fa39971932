"""Candidate causes on arms of more than two joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import ArmDescription, Experiment, Joint
from strainwave.signals.consistency.causes import propose_causes
from strainwave.signals.consistency.clocks import Clocks
from strainwave.signals.consistency.evidence import Evidence, SlowRecord
from strainwave.virtual import scara


def test_channels_of_any_two_joints_may_be_exchanged() -> None:
    arm = ArmDescription("serial", (Joint("linear", 0.01),) * 3)
    study = replace(scara.study(Path("nowhere")), arm=arm, channels={})
    channels = {f"{kind}{i}": np.zeros(1) for kind in ("u", "theta_m") for i in (1, 2, 3)}
    record = SlowRecord(
        experiment=Experiment("motion", "", "motion", ("open",) * 3),
        sample_time=0.1,
        bandwidth_hz=1.0,
        channels=channels,
        noise=dict.fromkeys(channels, 0.0),
        direction=np.zeros((1, 3)),
        inside=np.ones(1, dtype=bool),
        start=0.0,
        clocks=Clocks(),
        delays={},
    )
    suspicions = [cause.suspicion for cause in propose_causes(Evidence(study, (record,), {}), [])]
    exchanged = [each.message for each in suspicions if each.code == "swapped-channels"]
    both = "u{0}, u{1} and theta_m{0}, theta_m{1}: the channels of joints {0} and {1} are exchanged"
    for pair in ((1, 2), (1, 3), (2, 3)):
        assert both.format(*pair) in exchanged
