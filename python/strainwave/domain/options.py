"""What may be set by hand of each stage; `strainwave.io.study` checks the `annotated_types`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

Positive = Annotated[float, Gt(0.0)]
Band = tuple[Positive, Positive]  # lowest and highest frequency [Hz]

EstimationMethod = Literal["pem", "moesp", "n4sid", "subspace"]
Channels = Literal["both", "motor"]
Route = Literal["equations", "transfer-function"]

PUBLISHED_RANGE = (0.5, 2.0)
"""How far from its start tuning as published may move a parameter, where no range is given."""


@dataclass(frozen=True, slots=True)
class RigidOptions:
    """Of the rigid-joint model, (5) to (7): `rigid`."""

    bandwidth_hz: Positive | None = None  # of the equations' filter; None: chosen from the data
    load_friction: bool | None = (
        None  # of rigid joints, in proportion to the load; None: by the data
    )


@dataclass(frozen=True, slots=True)
class LinkOptions:
    """Of the links' motion, (8) to (10): `links`."""

    time_constant: Positive = 0.2  # T_V [s] of the fusion (10)
    order: Literal[1, 2] = 2  # of its low-pass
    bandwidth_hz: Positive | None = None  # zero-phase, over all; None: only where angles are
    # differenced twice, and then as wide as their noise allows


@dataclass(frozen=True, slots=True)
class FrequencyOptions:
    """Of the nonparametric frequency responses: `responses`."""

    inputs: Annotated[int, Ge(1)] | None = None  # how many of the inputs to use; None: all
    segment: Positive | None = None  # [s] of Welch's method; None: a period, or a quarter record
    transient_periods: Annotated[int, Ge(0)] = 1  # left out at the start, where there are enough


@dataclass(frozen=True, slots=True)
class LinearOptions:
    """Of the state-space models, (11), (12): `statespace`."""

    # None: of 2 to 6, by held-out data and Schwarz's criterion
    order: Annotated[int, Ge(2), Le(10)] | None = None
    outputs: Channels = "both"
    inputs: Channels = "both"  # "motor": the interaction torque is left out
    # "subspace": the better of MOESP and of a long autoregression, which feedback does not harm
    method: EstimationMethod = "pem"
    horizon: Annotated[int, Ge(2)] | None = None  # past samples of a subspace estimate; None: AIC
    decimation: Annotated[int, Ge(1)] | None = None  # every how many-th sample is kept; None: from
    # the band. The band's upper edge follows it
    # "band": what a prediction-error estimate asks for; "decimation": as in the source, a low-pass
    # below the new Nyquist frequency, link velocities as fused
    filter: Literal["band", "decimation"] = "band"
    band_hz: Band | None = None  # of the filter; None: from the resonances found


@dataclass(frozen=True, slots=True)
class PhysicalOptions:
    """Of a joint's physical parameters: `physical`."""

    route: Route = "equations"  # of motion; or (15) to (18), from the state-space models
    band_hz: Band | None = None  # of the equations' filter; None: from the data
    use_rigid: bool = True  # whether what the rigid model knows joins as equations, or in (18)


@dataclass(frozen=True, slots=True)
class TuningOptions:
    """Of the whole-arm fit: `tuning`."""

    # `tuning` records in closed loop, motor velocities alone, no other stage's knowledge but the
    # start; Coulomb friction held, and all else in `PUBLISHED_RANGE` where `ranges` say nothing
    as_published: bool = False
    # (least, most) of a parameter over the value where the fit starts; "gear_stiffness" or, of one
    # joint, "gear_stiffness 2"
    ranges: Mapping[str, tuple[Positive, Positive]] = field(default_factory=dict)
    hold: tuple[str, ...] = ()  # parameters that stay where the fit starts, named as in `ranges`
    cutoff_hz: Positive | None = None  # of what is compared; None: from the resonances
    settling: bool | None = None  # whether friction takes its time; None: if the data say so
    closed_loop: bool = False  # servoed joints by references and servo, not recorded voltages
    least_deviation: Positive = 0.002  # of what the rigid step knows, as a share of each value
    max_iterations: Annotated[int, Ge(1)] = 100


@dataclass(frozen=True, slots=True)
class Options:
    """What may be set by hand, one record a stage: `[options]`."""

    rigid: RigidOptions = RigidOptions()
    links: LinkOptions = LinkOptions()
    responses: FrequencyOptions = FrequencyOptions()
    statespace: LinearOptions = LinearOptions()
    physical: PhysicalOptions = PhysicalOptions()
    tuning: TuningOptions = TuningOptions()


def chosen_options(options: Options) -> list[str]:
    """What differs from the defaults, as on the command line: "links.order=1"."""
    usual = asdict(Options())
    return [
        f"{stage}.{key}={value}"
        for stage, table in asdict(options).items()
        for key, value in table.items()
        if value != usual[stage][key]
    ]
