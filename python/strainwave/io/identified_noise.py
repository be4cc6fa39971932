"""Noise of sensors and torques that an identification found, from result.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from strainwave.errors import InvalidInput


@dataclass(frozen=True, slots=True)
class IdentifiedNoise:
    """Standard deviations; empty for a result without them, as in earlier versions."""

    # by channel: of one sample; the angle for "omega_m1", the motor angle's velocity
    samples: Mapping[str, float] = field(default_factory=dict)
    # by joint, from 1: of the motor torque that the rigid model does not explain [N m]
    torques: Mapping[int, float] = field(default_factory=dict)
    torque_band_hz: float | None = None  # of `torques`


def noise_of(document: Mapping[str, Any], source: str = "the result") -> IdentifiedNoise:
    """The noise of a result document: of each channel the median over the records.

    `source` names the document in messages.
    """
    stages = document.get("stages") or {}
    rigid, tuned = stages.get("rigid") or {}, stages.get("tuned") or {}
    samples: dict[str, list[float]] = {}
    try:
        for test in (tuned.get("criticism") or {}).get("residuals", []):
            if test.get("sample_noise"):
                samples.setdefault(str(test["channel"]), []).append(float(test["sample_noise"]))
        torques = {int(one["joint"]): float(one["value"]) for one in rigid.get("torque_errors", [])}
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(
            "an entry of torque_errors or of the residuals lacks joint, channel or value",
            where=source,
            remedy="use a result.json as identify writes it",
        ) from error
    medians = {channel: float(np.median(values)) for channel, values in samples.items()}
    return IdentifiedNoise(medians, torques, rigid.get("bandwidth_hz"))
