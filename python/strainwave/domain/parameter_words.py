"""Symbols and one-line descriptions of parameters.

Symbols are those of docs/notation.md in plain text: `m_M` is m with the index M.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from strainwave.domain.parameter_table import parameter_table


@dataclass(frozen=True, slots=True)
class ParameterText:
    """Symbol and one-line description of a parameter."""

    symbol: str  # empty: no symbol
    description: str


_SENSOR_PARAMETERS = (
    {
        "accelerometer_delay": ("D", "delay of the accelerometer relative to the motor encoder"),
        "gyro_delay": ("D", "delay of the gyro relative to the motor encoder"),
        "link_encoder_delay": ("D", "delay of the link encoder relative to the motor encoder"),
        "accelerometer_scale": ("s", "scale factor of the accelerometer"),
        "gyro_scale": ("s", "scale factor of the gyro"),
        "accelerometer_drift": ("r", "drift of the accelerometer's bias in one record"),
        "gyro_drift": ("r", "drift of the gyro's bias in one record"),
        "accelerometer_distance": ("l_a", "distance of the accelerometer from its link's own axis"),
        "accelerometer_bandwidth": ("", "bandwidth of the accelerometer"),
        "gyro_bandwidth": ("", "bandwidth of the gyro"),
        "accelerometer_tilt": (
            "",
            "angle between the accelerometer and the tangent, in the plane of motion",
        ),
        "imu_x": ("x", "position of the IMU along its link, from the link's own axis"),
        "imu_y": ("y", "position of the IMU across its link, from the link's own axis"),
        "imu_distance": ("", "distance of the IMU from its link's own axis"),
        "imu_roll": ("", "roll of the IMU in its link's frame, as in URDF"),
        "imu_pitch": ("", "pitch of the IMU in its link's frame, as in URDF"),
        "imu_yaw": ("", "yaw of the IMU in its link's frame, as in URDF"),
        "imu_accelerometer_delay": (
            "",
            "delay of the IMU's accelerometers relative to the motor encoder",
        ),
        "imu_gyro_delay": ("", "delay of the IMU's gyros relative to the motor encoder"),
        "imu_accelerometer_bandwidth": ("", "bandwidth of the IMU's accelerometers"),
        "imu_gyro_bandwidth": ("", "bandwidth of the IMU's gyros"),
    }
    | {
        f"{sensor}_mount_{quantity}": (symbol, f"{text} of the mount of the {sensor_text}")
        for sensor, sensor_text in (
            ("accelerometer", "accelerometer"),
            ("gyro", "gyro"),
            ("imu_accelerometer", "IMU's accelerometers"),
            ("imu_gyro", "IMU's gyros"),
        )
        for quantity, symbol, text in (
            ("frequency", "f_h", "natural frequency"),
            ("damping", "zeta_h", "damping ratio"),
        )
    }
    | {
        f"imu_{letter}{axis}_scale": ("", f"scale factor of the IMU's {axis} {sensor}")
        for letter, sensor in (("a", "accelerometer"), ("g", "gyro"))
        for axis in "xyz"
    }
    | {
        f"imu_{letter}{axis}_drift": (
            "",
            f"drift of the bias of the IMU's {axis} {sensor} in one record",
        )
        for letter, sensor in (("a", "accelerometer"), ("g", "gyro"))
        for axis in "xyz"
    }
)


def parameter_descriptions() -> Mapping[str, ParameterText]:
    """Symbols and descriptions of all parameters in results, by name."""
    words = {p.name: (p.symbol, p.description) for p in parameter_table().values()}
    return {name: ParameterText(*texts) for name, texts in (words | _SENSOR_PARAMETERS).items()}
