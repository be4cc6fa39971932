"""Records: the frozen data that stages pass on, study and logs -> signals -> models -> outcome.

Samples are rows everywhere: arrays are (n_samples, n_joints) or (n_samples,). All units SI, angles
in rad. Joints are numbered from 1 where a person reads them and from 0 as array columns.
"""

from __future__ import annotations

from strainwave.records.answers import Caution, Parameter, Prediction, Suspicion
from strainwave.records.arm import ArmModel, Criticism, ResidualTest, RicherModel, TorqueHistogram
from strainwave.records.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from strainwave.records.joints import (
    Check,
    Decoupled,
    JointModel,
    RecordModel,
    Resonance,
    Sweep,
    SweepPoint,
)
from strainwave.records.outcome import Comparison, Identification
from strainwave.records.rigid import RigidModel
from strainwave.records.signals import Delay, Fusion, Lag, LinkSignals, LinkSource, Log, Signals
from strainwave.records.statespace import (
    ContinuousStateSpace,
    FrequencyResponse,
    Hold,
    HypothesisTest,
    InputOutput,
    Mode,
    ModelCheck,
    Modes,
    OrderSelection,
    StateSpace,
)
from strainwave.records.study import (
    CHANNELS,
    Arm,
    ArmKind,
    Channel,
    Control,
    Effect,
    Experiment,
    Joint,
    Motion,
    NonNegative,
    Positive,
    Prbs,
    Servo,
    Spring,
    Study,
    TopicChannel,
    Use,
    channel_names,
)

__all__ = [
    "CHANNELS",
    "Arm",
    "ArmKind",
    "ArmModel",
    "BoolArray",
    "Caution",
    "Channel",
    "Check",
    "Comparison",
    "ComplexArray",
    "ContinuousStateSpace",
    "Control",
    "Criticism",
    "Decoupled",
    "Delay",
    "Effect",
    "Experiment",
    "FloatArray",
    "FrequencyResponse",
    "Fusion",
    "Hold",
    "HypothesisTest",
    "Identification",
    "InputOutput",
    "IntArray",
    "Joint",
    "JointModel",
    "Lag",
    "LinkSignals",
    "LinkSource",
    "Log",
    "Mode",
    "ModelCheck",
    "Modes",
    "Motion",
    "NonNegative",
    "OrderSelection",
    "Parameter",
    "Positive",
    "Prbs",
    "Prediction",
    "RecordModel",
    "ResidualTest",
    "Resonance",
    "RicherModel",
    "RigidModel",
    "Servo",
    "Signals",
    "Spring",
    "StateSpace",
    "Study",
    "Suspicion",
    "Sweep",
    "SweepPoint",
    "TopicChannel",
    "TorqueHistogram",
    "Use",
    "channel_names",
]
