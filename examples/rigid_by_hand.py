"""Call the functions of the rigid step one by one: each is a function from records to a record.

    python examples/rigid_by_hand.py [STUDY.toml]

Without a study, the example simulates the built-in arm.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from strainwave.dynamics.arm import Arm
from strainwave.identification import rigid, validation
from strainwave.io import logs
from strainwave.io.study import read_study
from strainwave.signals import motor as signals
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara


def main(study_path: Path) -> None:
    study = read_study(study_path)
    arm = Arm.of(study.arm)
    signals_by_name = {
        experiment.name: signals.prepare_motor_signals(logs.read_log(study, experiment), arm)
        for experiment in study.experiments
        if experiment.use in ("motion", "check")
    }
    motion = [record for record in signals_by_name.values() if record.experiment.use == "motion"]

    model = rigid.fit_rigid(motion, arm)
    print(f"{model.status}, bandwidth {model.bandwidth_hz:.1f} Hz, {model.n_rows} equations")
    for p in model.parameters:
        print(f"{p.name:24s} {p.joint or 'arm'!s:4s} {p.value} +- {p.std} {p.unit}")

    # Repeat in half the band: do not trust values that change by more than a standard deviation.
    narrow = rigid.fit_rigid(motion, arm, rigid.RigidOptions(bandwidth_hz=model.bandwidth_hz / 2.0))
    for wide, half in zip(model.parameters, narrow.parameters, strict=True):
        if wide.value is not None and half.value is not None:
            print(f"{wide.name:24s} in half the band: {100 * (half.value / wide.value - 1):+.2f} %")

    for record in signals_by_name.values():
        prediction = validation.predict_rigid(model, record, arm)
        print(prediction.experiment, dict(prediction.fit_percent))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            virtual.simulate_study(
                scara.STIFF.study(Path(folder)), scara.STIFF.parameters(), Path(folder)
            )
            main(Path(folder) / "study.toml")
