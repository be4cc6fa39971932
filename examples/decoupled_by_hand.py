"""Call the functions of the decoupled step one by one and print their results.

    python examples/decoupled_by_hand.py [STUDY.toml]

Without a study, the example simulates the built-in arm.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from strainwave.dynamics.arm import Arm
from strainwave.identification import decoupling, frequency, rigid
from strainwave.identification import joint_model as physical
from strainwave.io import logs
from strainwave.io.study import read_study
from strainwave.signals import link_motion as links
from strainwave.signals import motor as signals
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara


def main(study_path: Path) -> None:
    study = read_study(study_path)
    arm = Arm.of(study.arm)
    all_logs = {e.name: logs.read_log(study, e) for e in study.experiments}
    motion = [log for log in all_logs.values() if log.experiment.use == "motion"]
    # a single joint does not need a rigid model
    model = (
        rigid.fit_rigid([signals.prepare_motor_signals(log, arm) for log in motion], arm)
        if motion
        else None
    )

    for log in all_logs.values():
        if log.experiment.use != "frequency":
            continue
        link_signals = links.prepare_link_signals(
            log, arm
        )  # link motion from accelerometers, (8)-(10)
        for joint in decoupling.decouple(link_signals, model, arm):  # (13), (14)
            if joint.joint != log.experiment.joint:
                continue
            print(f"\n{log.name}, joint {joint.joint}: inputs {joint.inputs.shape}")
            for check in joint.checks:
                print(f"  {'ok  ' if check.passed else 'FAIL'} {check.message}")
            joint_model = physical.identify_joint([(link_signals, joint)], model, arm)
            for p in joint_model.parameters:
                print(f"  {p.name:24s} {p.value} +- {p.std} {p.unit}")
            assert joint_model.anti_resonance is not None
            print(f"  anti-resonance {joint_model.anti_resonance.frequency_hz:.3f} Hz")
            linear = physical.state_space_of(joint)  # prediction-error minimisation, (11), (12)
            modes = physical.modes_of(linear)
            print(f"  state space of order {linear.order}: {linear.status}, {modes.resonance}")
            response = frequency.estimate_response([joint])
            print(f"  nonparametric response at {len(response.frequencies_hz)} frequencies")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            virtual.simulate_study(
                scara.STIFF.study(Path(folder)), scara.STIFF.parameters(), Path(folder)
            )
            main(Path(folder) / "study.toml")
