"""What parameters are called in equations, and what they are in one line.

Symbols are those of docs/notation.md, as plain text: `m_M` is m with the index M.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from strainwave.domain.parameter_table import parameter_table


@dataclass(frozen=True, slots=True)
class ParameterWords:
    """A parameter's symbol and one-line description."""

    symbol: str  # empty: none
    description: str


_OF_SENSORS = (
    {
        "accelerometer_delay": ("D", "delay of the accelerometer behind the motor encoder"),
        "gyro_delay": ("D", "delay of the gyro behind the motor encoder"),
        "link_encoder_delay": ("D", "delay of the link encoder behind the motor encoder"),
        "accelerometer_scale": ("s", "reading of the accelerometer over the motion"),
        "gyro_scale": ("s", "reading of the gyro over the motion"),
        "accelerometer_drift": ("r", "drift of the accelerometer's bias in one record"),
        "gyro_drift": ("r", "drift of the gyro's bias in one record"),
        "accelerometer_distance": ("l_a", "distance of the accelerometer from its link's own axis"),
        "accelerometer_bandwidth": ("", "bandwidth of the accelerometer"),
        "gyro_bandwidth": ("", "bandwidth of the gyro"),
        "accelerometer_tilt": (
            "",
            "angle of the accelerometer to the tangent, in the plane of motion",
        ),
        "imu_x": ("x", "place of the IMU along its link, from the link's own axis"),
        "imu_y": ("y", "place of the IMU across its link, from the link's own axis"),
        "imu_distance": ("", "distance of the IMU from its link's own axis"),
        "imu_roll": ("", "roll of the IMU in its link's frame, as in URDF"),
        "imu_pitch": ("", "pitch of the IMU in its link's frame, as in URDF"),
        "imu_yaw": ("", "yaw of the IMU in its link's frame, as in URDF"),
        "imu_accelerometer_delay": (
            "",
            "delay of the IMU's accelerometers behind the motor encoder",
        ),
        "imu_gyro_delay": ("", "delay of the IMU's gyros behind the motor encoder"),
        "imu_accelerometer_bandwidth": ("", "bandwidth of the IMU's accelerometers"),
        "imu_gyro_bandwidth": ("", "bandwidth of the IMU's gyros"),
    }
    | {
        f"{sensor}_mount_{what}": (symbol, f"{said} of the mount of the {words}")
        for sensor, words in (
            ("accelerometer", "accelerometer"),
            ("gyro", "gyro"),
            ("imu_accelerometer", "IMU's accelerometers"),
            ("imu_gyro", "IMU's gyros"),
        )
        for what, symbol, said in (
            ("frequency", "f_h", "natural frequency"),
            ("damping", "zeta_h", "damping ratio"),
        )
    }
    | {
        f"imu_{letter}{axis}_scale": ("", f"reading of the IMU's {axis} {sensor} over the motion")
        for letter, sensor in (("a", "accelerometer"), ("g", "gyro"))
        for axis in "xyz"
    }
    | {
        f"imu_{letter}{axis}_drift": ("", f"drift of the IMU's {axis} {sensor} in one record")
        for letter, sensor in (("a", "accelerometer"), ("g", "gyro"))
        for axis in "xyz"
    }
)


def all_words() -> Mapping[str, ParameterWords]:
    """Of every parameter, those of all gear laws included, by the name that it has in results."""
    words = {p.name: (p.symbol, p.description) for p in parameter_table().values()}
    return {name: ParameterWords(*own) for name, own in (words | _OF_SENSORS).items()}
