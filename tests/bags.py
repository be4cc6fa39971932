"""ROS bags on disk for tests of reading, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from strainwave.domain import FloatArray

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
START = 1_700_000_000_000_000_000
"""[ns] when the recorder was started."""

Message = tuple[str, int, Any]
"""Topic, when it was recorded [ns], and what it says."""


def stamps(time: FloatArray) -> list[int]:
    return [START + round(1e9 * t) for t in time]


def header(ns: int, store: Any = STORE) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return kind(0, stamp, "") if store is STORE1 else kind(stamp, "")


def joint_state(
    ns: int,
    position: Mapping[str, float],
    velocity: Iterable[float] = (),
    effort: Iterable[float] = (),
    store: Any = STORE,
) -> Any:
    arrays = [np.array([*values]) for values in (position.values(), velocity, effort)]
    kind = store.types["sensor_msgs/msg/JointState"]
    return kind(header(ns, store), list(position), *arrays)


def imu(ns: int, y: float) -> Any:
    vector, quaternion = (
        STORE.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion")
    )
    return STORE.types["sensor_msgs/msg/Imu"](
        header=header(ns),
        orientation=quaternion(0.0, 0.0, 0.0, 1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(0.0, 0.0, 0.0),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(0.0, y, 9.81),
        linear_acceleration_covariance=np.zeros(9),
    )


def floats(values: Iterable[float]) -> Any:
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return STORE.types["std_msgs/msg/Float64MultiArray"](layout, np.array([*values], dtype=float))


def write(
    path: Path,
    messages: Iterable[Message],
    storage: str = "MCAP",
    silent: Mapping[str, str] | None = None,
) -> Path:
    """A rosbag2 directory; the topics in `silent` have no messages."""
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        connections: dict[str, Any] = {}
        for topic, kind in (silent or {}).items():
            connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
        for topic, ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], ns, data)
    return path


def write_ros1(path: Path, messages: Iterable[Message]) -> Path:
    with Writer1(path) as writer:
        connections: dict[str, Any] = {}
        for topic, ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE1)
            writer.write(connections[topic], ns, STORE1.serialize_ros1(message, kind))
    return path


def of_columns(columns: Mapping[str, FloatArray]) -> list[Message]:
    """A log of two joints as messages of a rig: joint states, an IMU and commands."""
    messages: list[Message] = []
    for k, ns in enumerate(stamps(columns["t"])):
        position = {"shoulder": columns["theta_m1"][k] / 100.0, "elbow": columns["theta_m2"][k]}
        messages.append(("/joint_states", ns, joint_state(ns, position)))
        messages.append(("/imu1", ns, imu(ns, columns["a1"][k])))
        messages.append(("/cmd", ns, floats([columns["u1"][k], columns["u2"][k]])))
    return messages


CHANNELS = """
[channels]
theta_m1 = { topic = "/joint_states", field = "position", name = "shoulder", scale = 100.0 }
theta_m2 = { topic = "/joint_states", field = "position", name = "elbow" }
a1 = { topic = "/imu1", field = "linear_acceleration.y" }
u1 = { topic = "/cmd", field = "data[0]" }
u2 = { topic = "/cmd", field = "data[1]" }
"""
