"""Options of each stage, the stages of a run, and its progress.

`options.toml` has the meaning of every option, its default in words, which also explains None, and
the reason for it. `strainwave.io.study` checks the constraints of `annotated_types`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from annotated_types import Ge, Gt, Le

from strainwave.errors import InvalidInput, suggest_name

Positive = Annotated[float, Gt(0.0)]
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


@cache
def option_texts() -> dict[str, dict[str, Any]]:
    """By stage its `title` and its `options`: by key `meaning`, `default` and `reason`."""
    return tomllib.loads(Path(__file__).with_name("options.toml").read_text(encoding="utf-8"))


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
