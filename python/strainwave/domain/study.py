"""A study: an arm, its experiments and options, and what checks, forms and documents know of them.

`options.toml` has the meaning of every option, its default in words, which also explains None, and
the reason for it. `study_keys.toml` has the keys of the tables; their ranges are wide: they detect
a wrong unit or an inverted ratio, not an unusual machine. `strainwave.io.study` checks the
constraints of `annotated_types`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, Le, MinLen

from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.domain.arm.description import ArmDescription, Positive, Vector
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.domain.keys import JointNumber
from strainwave.domain.steps import Merge, Resample, Step
from strainwave.errors import InvalidInput, suggest_name

Band = tuple[Positive, Positive]  # lowest and highest frequency [Hz]

Focus = Literal["prediction", "stability"]
EstimationMethod = Literal["pem", "moesp", "n4sid", "subspace"]
Channels = Literal["both", "motor"]
Route = Literal["equations", "transfer-function"]

PUBLISHED_RANGE = (0.9, 1.1)
"""Default range of a parameter over its starting value for a fit with `as_published`."""


class _Checked:
    """Mixin that refuses unknown fields by a message that names the nearest one."""

    __slots__ = ()

    def __new__(cls, *_: object, **given: object) -> Self:
        known = list(getattr(cls, "__dataclass_fields__", given))
        for name in given:
            if name not in known:
                raise InvalidInput(
                    f"there is no option {name!r}",
                    where=cls.__name__,
                    remedy=f"use {', '.join(known)}{suggest_name(name, known)}",
                )
        return super().__new__(cls)


@dataclass(frozen=True, slots=True)
class RigidOptions(_Checked):
    """Options of the rigid-joint model, (5) to (7): `rigid`."""

    bandwidth_hz: Positive | None = None


@dataclass(frozen=True, slots=True)
class LinkOptions(_Checked):
    """Options of the links' motion, (8) to (10): `links`."""

    time_constant: Positive = 0.2
    order: Literal[1, 2] = 2
    bandwidth_hz: Positive | None = None


@dataclass(frozen=True, slots=True)
class FrequencyOptions(_Checked):
    """Options of the nonparametric frequency responses: `responses`."""

    inputs: Annotated[int, Ge(1)] | None = None
    segment: Positive | None = None
    transient_periods: Annotated[int, Ge(0)] = 1


@dataclass(frozen=True, slots=True)
class LinearOptions(_Checked):
    """Options of the state-space models, (11), (12): `statespace`."""

    order: Annotated[int, Ge(2), Le(10)] | None = None
    outputs: Channels = "both"
    inputs: Channels = "both"
    method: EstimationMethod = "pem"
    focus: Focus = "prediction"
    horizon: Annotated[int, Ge(2)] | None = None
    decimation: Annotated[int, Ge(1)] | None = None
    sample_time: Positive | None = None
    filter: Literal["band", "decimation"] = "band"
    band_hz: Band | None = None


@dataclass(frozen=True, slots=True)
class PhysicalOptions(_Checked):
    """Options of a joint's physical parameters: `physical`."""

    route: Route = "equations"
    band_hz: Band | None = None
    use_rigid: bool = True


@dataclass(frozen=True, slots=True)
class WholeArmOptions(_Checked):
    """Options of the whole-arm fit: `tuning`."""

    as_published: bool = False
    ranges: Mapping[str, tuple[Positive, Positive]] = field(default_factory=dict)
    hold: tuple[str, ...] = ()
    cutoff_hz: Positive | None = None
    settling: bool | None = None
    closed_loop: bool = False
    least_deviation: Positive = 0.002
    max_iterations: Annotated[int, Ge(1)] = 100
    rival_effort: Annotated[float, Ge(0.0)] = 1.0


@dataclass(frozen=True, slots=True)
class Options(_Checked):
    """Options of all stages: `[options]`."""

    rigid: RigidOptions = RigidOptions()
    links: LinkOptions = LinkOptions()
    responses: FrequencyOptions = FrequencyOptions()
    statespace: LinearOptions = LinearOptions()
    physical: PhysicalOptions = PhysicalOptions()
    tuning: WholeArmOptions = WholeArmOptions()
    accept: tuple[str, ...] = ()  # codes of suspected faults that do not decide the status

    def __post_init__(self) -> None:
        """Make records of plain mappings: `Options(links={"order": 1})`."""
        for stage in fields(self):
            value: Any = getattr(self, stage.name)
            if isinstance(value, Mapping):
                record: Any = type(stage.default)
                object.__setattr__(self, stage.name, record(**value))


PUBLISHED_OPTIONS = Options(
    links=LinkOptions(order=1),  # the source does not give its time constant
    statespace=LinearOptions(order=4, focus="stability", sample_time=2e-3, filter="decimation"),
    physical=PhysicalOptions(route="transfer-function"),
    tuning=WholeArmOptions(as_published=True),
)
"""Options of the source, which gives each gear one stiffness."""


def changed_options(options: Options) -> list[str]:
    """Options that differ from the defaults, in the command line's notation: "links.order=1"."""
    defaults = asdict(Options())
    changed = asdict(options)
    accepted = changed.pop("accept")
    return [f"accept={','.join(accepted)}"] * bool(accepted) + [
        f"{stage}.{key}={value}"
        for stage, table in changed.items()
        for key, value in table.items()
        if value != defaults[stage][key]
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOption:
    """One option of a stage; `options.toml` has its texts, in Markdown."""

    name: str  # "links.order"
    stage: str  # title of its stage
    meaning: str
    default: str  # in words
    reason: str  # for the default
    value: Any  # the default; None: from the data
    choices: tuple[str, ...]  # TOML values to choose from; empty: any value


@cache
def study_options() -> tuple[StudyOption, ...]:
    """Options of all stages, in their order."""
    text = Path(__file__).with_name("options.toml").read_text(encoding="utf-8")
    options = []
    for stage, table in tomllib.loads(text).items():
        record = getattr(Options(), stage)
        hints = get_type_hints(type(record))
        options += [
            StudyOption(
                name=f"{stage}.{key}",
                stage=table["title"],
                value=getattr(record, key),
                choices=_choices(hints[key]),
                **texts,
            )
            for key, texts in table["options"].items()
        ]
    return tuple(options)


def _choices(hint: Any) -> tuple[str, ...]:
    kinds = (hint, *get_args(hint))
    literals = (get_args(kind) for kind in kinds if get_origin(kind) is Literal)
    return ("true", "false") if bool in kinds else tuple(map(str, next(literals, ())))


@dataclass(frozen=True, slots=True)
class ProgressEvent:
    """Start of a part of a run, or a step within it."""

    stage: str  # "read", "consistency", "rigid", "checks", "decoupled", "tuned", "report"
    fraction: float  # completed parts over all parts, from 0 to 1
    message: str  # current activity
    part: int  # from 1; parts that cannot run are skipped
    parts: int

    def __str__(self) -> str:
        return f"{self.part} of {self.parts}: {self.message}"


Progress = Callable[[ProgressEvent], None]
"""Called at the start of each part of a run, and at each evaluation of the whole-arm fit."""


def ignore_progress(_event: ProgressEvent) -> None:
    """Ignore progress events."""


Stage = Literal["rigid", "decoupled", "tuned"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""All stages in order; a run executes a prefix of them."""


KeyKind = Literal["number", "numbers", "text", "choice"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyKey:
    """One key of a table; `study_keys.toml` describes the fields."""

    key: str  # dotted for a table in the table: "imu.xyz"
    title: str = ""
    kind: KeyKind = "number"
    group: Literal["placement", "drive", "sensors", ""] = ""  # of a joint
    serial: bool | None = None
    unit: str = ""
    range: Sequence[float] | None = None  # smallest and largest
    other_unit: str = ""
    other_scale: float | None = None
    default: str = ""
    meaning: str = ""


@cache
def study_keys() -> dict[str, tuple[StudyKey, ...]]:
    """Keys by the name of their table."""
    text = Path(__file__).with_name("study_keys.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    return {name: tuple(StudyKey(**entry) for entry in table) for name, table in tables.items()}


Use = Literal["motion", "frequency", "sweep", "tuning", "check"]
Control = Literal["open", "servo"]
Meaning = Literal["motor", "sensor", "without-gravity", "without-friction", "desired"]
"""What a torque channel measures: the motor, or a sensor behind the gear."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Source of a channel in a table: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0
    meaning: Meaning = "motor"
    second_column: str | None = None  # of t: fractions of a second, or the time of day of a date

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns of the channel."""
        return tuple(filter(None, (self.column, self.second_column)))


@dataclass(frozen=True, slots=True)
class Prbs:
    """Maximum-length pseudo-random binary sequence of `2**order - 1` clocks."""

    order: Annotated[int, Ge(2)]
    clock: Positive  # [s]
    periods: Annotated[int, Ge(1)]
    amplitude: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Payload:
    """Known point mass on the last link of a chain."""

    mass: Positive  # [kg]
    xyz: Vector = (0.0, 0.0, 0.0)  # [m] centre of mass in the last link's frame

    @property
    def parameters(self) -> tuple[float, ...]:
        """Its ten standard parameters, in the order of the core."""
        return standard_parameters(self.mass, np.array(self.xyz), np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Experiment:
    """One log file and its use: `[[experiment]]`."""

    name: Annotated[str, MinLen(1)]
    # relative to the study file; "" if the data are passed in memory
    file: Annotated[str, MinLen(1)]
    use: Use
    control: tuple[Control, ...]  # one per joint
    joint: Annotated[JointNumber, Ge(1)] | None = None  # the excited joint
    prbs: Prbs | None = None
    start: float | None = None  # [s]
    stop: float | None = None  # [s]
    add: Mapping[str, str] = field(default_factory=dict)  # channel -> column added to it
    payload: Payload | None = None  # of serial arms
    steps: tuple[Step, ...] = ()  # of preprocessing, in order; merges come first

    @property
    def merges(self) -> tuple[Merge, ...]:
        """Logs that continue the record."""
        return tuple(step for step in self.steps if isinstance(step, Merge))

    @property
    def is_resampled(self) -> bool:
        """Whether a step gives the record another sampling period than that of its log."""
        return any(isinstance(step, Resample) for step in self.steps)


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """An arm and its experiments: a checked study file, or a study built in memory."""

    arm: ArmDescription
    experiments: tuple[Experiment, ...]
    channels: Mapping[str, Channel] = field(default_factory=dict)
    sample_rate: float | None = None  # [Hz] of logs without time stamps
    options: Options = field(default_factory=Options)  # `[options]`
    path: Path = Path("study")  # of the file; log paths are relative to its folder
    sha256: str = ""  # of the file

    def with_segments(self, experiments: Iterable[Experiment]) -> Study:
        """The study with the experiments of its logs: one per segment of a record with pauses."""
        return replace(self, experiments=tuple(experiments))

    def log_path(self, experiment: Experiment) -> Path:
        """Path of an experiment's log."""
        return self.path.parent / experiment.file

    def log_paths(self, experiment: Experiment) -> tuple[Path, ...]:
        """Paths of an experiment's log and of the logs that continue it."""
        merged = (self.path.parent / step.file for step in experiment.merges)
        return self.log_path(experiment), *merged


def channel_kinds() -> tuple[str, ...]:
    """Channels of each joint. The channel `t` belongs to the whole record."""
    return ("u", "torque", "theta_m", "omega_m", *link_channel_kinds(), "ref", "temperature")


def channel_names(count: int) -> tuple[str, ...]:
    """All channels that an arm of `count` joints can have."""
    return ("t", *(f"{name}{i}" for name in channel_kinds() for i in range(1, count + 1)))


def channel_parts(name: str) -> tuple[str, int]:
    """Kind and joint of a channel: ("theta_m", 2) of "theta_m2"; joint 0 of "t"."""
    kind = name.rstrip("0123456789")
    return kind, int(name[len(kind) :][:9] or 0)  # a name of a request may have any length
