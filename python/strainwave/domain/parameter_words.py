"""What parameters are called in equations, and what they are in one line.

Symbols are those of docs/notation.md, as plain text: `m_M` is m with the index M.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from strainwave.domain.gear_laws import gear_parameters


@dataclass(frozen=True, slots=True)
class ParameterWords:
    """A parameter's symbol and one-line description."""

    symbol: str  # empty: none
    description: str


_WORDS = {
    "alpha": ("alpha", "inertia of link 1 and of link 2's mass at axis 2, about axis 1"),
    "beta": ("beta", "inertia of link 2 about axis 2"),
    "gamma": ("gamma", "coupling of the links: link length times first moment of link 2"),
    "gravity_torque_1": ("G1", "largest gravity torque of link 1, link 2's mass at axis 2"),
    "gravity_torque_2": ("G2", "largest gravity torque of link 2"),
    "rigid_inertia": ("", "alpha + m_M1/n1²: inertia of joint 1 with its motor, at the link"),
    "inertia": ("c_1", "m_M + n² m_L: motor and link together, at the motor"),
    "motor_inertia": ("m_M", "inertia of motor and wave generator, at the motor"),
    "motor_viscous_friction": ("d_M", "viscous friction of the motor, at the motor"),
    "motor_coulomb_friction": ("f_M", "Coulomb friction of the motor, at the motor"),
    "friction_offset": ("f_0", "constant part of the friction, at the motor"),
    "link_mass": ("m", "mass of the link"),
    "link_first_moment_x": ("m c", "mass of the link times its centre's x in the link's frame"),
    "link_first_moment_y": ("m c", "mass of the link times its centre's y in the link's frame"),
    "link_first_moment_z": ("m c", "mass of the link times its centre's z in the link's frame"),
    "link_inertia_xx": ("I", "xx entry of the link's inertia about its frame's origin"),
    "link_inertia_xy": ("I", "xy entry of the link's inertia about its frame's origin"),
    "link_inertia_yy": ("I", "yy entry of the link's inertia about its frame's origin"),
    "link_inertia_xz": ("I", "xz entry of the link's inertia about its frame's origin"),
    "link_inertia_yz": ("I", "yz entry of the link's inertia about its frame's origin"),
    "link_inertia_zz": ("I", "zz entry of the link's inertia about its frame's origin"),
    "link_inertia": ("m_L", "inertia that the gear moves with the arm stretched, at the link"),
    "link_viscous_friction": ("d_L", "viscous friction of the link, at the link"),
    "total_viscous_friction": ("c_0", "d_M + n² d_L: viscous friction of the joint, at the motor"),
    "gear_damping": ("d_G", "damping of the gear, at the link"),
    "friction_settling_time": ("tau", "time constant in which friction brings the motor to rest"),
    "stribeck_friction": ("f_S", "excess of the friction at standstill over Coulomb friction"),
    "stribeck_velocity": ("w_s", "motor velocity at which 1/e of the Stribeck friction is left"),
    "hysteresis_torque": ("T_h", "largest torque of the gear's hysteresis, at the link"),
    "hysteresis_twist": ("delta_h", "torsion in which the hysteresis reverses, at the link"),
    "kinematic_error_cos": ("a", "cosine part of the gear's kinematic error, at the link"),
    "kinematic_error_sin": ("b", "sine part of the gear's kinematic error, at the link"),
    "accelerometer_delay": ("D", "delay of the accelerometer behind the motor encoder"),
    "gyro_delay": ("D", "delay of the gyro behind the motor encoder"),
    "link_encoder_delay": ("D", "delay of the link encoder behind the motor encoder"),
    "accelerometer_scale": ("s", "reading of the accelerometer over the motion"),
    "gyro_scale": ("s", "reading of the gyro over the motion"),
    "accelerometer_distance": ("l_a", "distance of the accelerometer from its link's own axis"),
    "accelerometer_bandwidth": ("", "bandwidth of the accelerometer"),
    "gyro_bandwidth": ("", "bandwidth of the gyro"),
    "accelerometer_tilt": ("", "angle of the accelerometer to the tangent, in the plane of motion"),
    "imu_x": ("x", "place of the IMU along its link, from the link's own axis"),
    "imu_y": ("y", "place of the IMU across its link, from the link's own axis"),
    "imu_distance": ("", "distance of the IMU from its link's own axis"),
    "imu_roll": ("", "roll of the IMU in its link's frame, as in URDF"),
    "imu_pitch": ("", "pitch of the IMU in its link's frame, as in URDF"),
    "imu_yaw": ("", "yaw of the IMU in its link's frame, as in URDF"),
    "imu_accelerometer_delay": ("", "delay of the IMU's accelerometers behind the motor encoder"),
    "imu_gyro_delay": ("", "delay of the IMU's gyros behind the motor encoder"),
    "imu_accelerometer_bandwidth": ("", "bandwidth of the IMU's accelerometers"),
    "imu_gyro_bandwidth": ("", "bandwidth of the IMU's gyros"),
} | {
    f"imu_{letter}{axis}_scale": ("", f"reading of the IMU's {axis} {sensor} over the motion")
    for letter, sensor in (("a", "accelerometer"), ("g", "gyro"))
    for axis in "xyz"
}


def all_words() -> Mapping[str, ParameterWords]:
    """Of every parameter, those of all gear laws included, by the name that it has in results."""
    of_gears = {p.name: (p.symbol, p.description) for p in gear_parameters().values()}
    return {name: ParameterWords(*words) for name, words in (_WORDS | of_gears).items()}
