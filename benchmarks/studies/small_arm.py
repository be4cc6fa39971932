"""Write tests/data/small-arm, simulated in MuJoCo: `python -m benchmarks.studies.small_arm`.

The arm is lighter than the built-in one, with other gear sizes and ratios, and is simulated as in
`engine.py`. Like a data acquisition card, the logs have time, voltages, angles and accelerations in
whole counts, about ten bytes per row; the study's channel map has the size of a count.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.studies.engine import in_mujoco
from strainwave.domain import (
    Channel,
    Control,
    Experiment,
    FloatArray,
    Joint,
    Prbs,
    Servo,
    Study,
    Use,
)
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.study import read_study, write_study
from strainwave.virtual.experiments import derived, simulate_study

SEED = 7
COUNTS = 4096  # of an encoder per turn
ACCELEROMETER_RANGE = 16.0 * 9.81  # [m/s^2]
RESOLUTION = {
    "t": 1e-6,  # [s]
    "u": 2.0**-11,  # [V]
    "theta_m": 2.0 * np.pi / COUNTS,
    "a": 2.0**-15 * ACCELEROMETER_RANGE,
    "ref": 2.0**-6,  # [rad/s]
}
"""Size of a count, by channel."""


def values() -> Values:
    """Links of 3.5 and 1.2 kg with 0.8 kg at the tip, gears of sizes 17 and 11."""
    parameters: Values = {("alpha", None): 0.2186, ("beta", None): 0.0500, ("gamma", None): 0.0700}
    joints: tuple[dict[str, float], ...] = (
        {
            "motor_inertia": 4e-5,
            "motor_viscous_friction": 8e-5,
            "motor_coulomb_friction": 0.020,
            "friction_offset": 0.0,
            "link_viscous_friction": 0.15,
            "gear_damping": 5.0,
            "gear_stiffness_k1": 10000.0,
            "gear_stiffness_k2": 14000.0,
            "gear_stiffness_k3": 16000.0,
            "gear_knee_t1": 3.9,
            "gear_knee_t2": 12.0,
        },
        {
            "motor_inertia": 1e-5,
            "motor_viscous_friction": 3e-5,
            "motor_coulomb_friction": 0.008,
            "friction_offset": 0.0,
            "link_viscous_friction": 0.03,
            "gear_damping": 0.8,
            "gear_stiffness_k1": 2200.0,
            "gear_stiffness_k2": 3000.0,
            "gear_stiffness_k3": 3200.0,
            "gear_knee_t1": 0.80,
            "gear_knee_t2": 2.0,
        },
    )
    for number, joint in enumerate(joints, start=1):
        parameters |= {(name, number): value for name, value in joint.items()}
    return parameters


def study(folder: Path) -> Study:
    """The arm's sensors, servo and experiments."""
    joints = tuple(
        Joint(
            spring="three-slope",
            gear_ratio=ratio,
            torque_per_volt=torque_per_volt,
            current_loop_hz=800.0,
            encoder_counts=COUNTS,
            accelerometer_distance=distance,
            accelerometer_hz=400.0,
        )
        for ratio, torque_per_volt, distance in ((1 / 80, 0.03, 0.24), (1 / 50, 0.012, 0.18))
    )
    return Study(
        path=folder / "study.toml",
        sha256="",
        arm=planar_two_link(
            joints,
            link_length=0.25,
            servo=Servo(
                "pi-velocity", period=1e-3, kp=(0.0625, 0.045), ki=(0.78, 0.56), limit=10.0
            ),
        ),
        experiments=_experiments(),
    )


def _experiments() -> tuple[Experiment, ...]:
    free: tuple[Control, Control] = ("open", "open")
    both: tuple[Control, Control] = ("servo", "servo")

    def record(
        name: str,
        use: Use,
        control: tuple[Control, Control],
        *,
        joint: int | None = None,
        volt: float = 0.0,
    ) -> Experiment:
        prbs = Prbs(10, 1e-3, 2, volt) if volt else None
        return Experiment(name, f"{name}.parquet", use, control, joint=joint, prbs=prbs)

    experiments = [record("motion", "motion", both), record("motion-check", "check", both)]
    for j in (1, 2):
        experiments += [
            record(f"prbs-j{j}", "frequency", free, joint=j, volt=10.0),
            record(f"sweep-j{j}-4V", "sweep", free, joint=j, volt=4.0),
            record(f"step-j{j}", "tuning", both, joint=j),
            record(f"step-check-j{j}", "check", both, joint=j),
        ]
    return tuple(experiments)


def write(folder: Path) -> None:
    """Simulate every experiment and write logs, study.toml and truth.json."""
    with TemporaryDirectory() as scratch:
        plain = study(Path(scratch))
        noise = replace(SensorNoise(), accelerometer_range=ACCELEROMETER_RANGE)
        simulate_study(
            plain,
            values(),
            Path(scratch),
            seed=SEED,
            noise=noise,
            as_recorded=False,
            simulator=in_mujoco,
        )
        written = read_study(Path(scratch) / "study.toml")
        folder.mkdir(parents=True, exist_ok=True)
        for experiment in written.experiments:
            table = pq.read_table(Path(scratch) / experiment.file)
            _write_counts(folder / experiment.file, table)
    channels = {
        name: Channel(column=f"{name}_counts", scale=float(RESOLUTION[name.rstrip("12")]))
        for name in ("t", *(f"{kind}{j}" for kind in ("u", "theta_m", "a", "ref") for j in (1, 2)))
    }
    copy = replace(written, path=folder / "study.toml", channels=channels)
    write_study(copy, copy.path)
    truth = [
        {"name": name, "joint": joint, "value": value}
        for (name, joint), value in derived(values(), copy.arm).items()
    ]
    (folder / "truth.json").write_text(json.dumps({"parameters": truth}, indent=1) + "\n")


def _write_counts(path: Path, table: pa.Table) -> None:
    """Write every column in whole counts; the encoding stores differences of neighbours."""
    columns = {}
    for name in table.column_names:
        column: FloatArray = table[name].to_numpy()
        counts = np.round(column / RESOLUTION[name.rstrip("12")]).astype(np.int32)
        columns[f"{name}_counts"] = counts
    pq.write_table(
        pa.table(columns),
        path,
        compression="zstd",
        use_dictionary=False,
        column_encoding=dict.fromkeys(columns, "DELTA_BINARY_PACKED"),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("tests/data/small-arm"))
    write(parser.parse_args().out)


if __name__ == "__main__":
    main()
