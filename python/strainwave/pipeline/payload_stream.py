"""Load on an identified arm from samples in a loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from strainwave.domain import PayloadEstimate, Study
from strainwave.identification.payload_stream import DEFAULT_WINDOW, LoadStream
from strainwave.numerics.parallel import one_blas_thread
from strainwave.pipeline.payload import estimate_of, known_arm


class PayloadStream:
    """Estimate of a load from one sample at a time, of the latest `window` [s] of motion."""

    def __init__(
        self,
        document: Mapping[str, Any],
        source: Path,
        *,
        identified: Study | None = None,
        sample_time: float,
        window: float = DEFAULT_WINDOW,
    ) -> None:
        self._known = known_arm(document, source, identified)
        known = self._known
        self._stream = LoadStream(
            known.arm, known.prior, known.model, sample_time=sample_time, window=window
        )

    def update(self, angle: ArrayLike, torque: ArrayLike) -> None:
        """Add one sample of all joints, in 50 us for seven.

        `angle` are the channels `theta_m` [rad] of the study and `torque` its channels `torque`
        [N m] or `u` [V], or `tau_l` [N m] if the arm was identified from joint torque sensors. No
        velocity and no acceleration is needed. Raises ValueError unless there is one per joint.
        """
        self._stream.update(angle, torque)

    def reset(self) -> None:
        """Forget all samples: after a gap, or if another load is picked up."""
        self._stream.reset()

    @property
    def estimate(self) -> PayloadEstimate:
        """The load of the window, in tens of milliseconds; other threads may go on with updates.

        Raises NotIdentifiable while the motion was too short, or if it determines nothing.
        """
        with one_blas_thread():
            fit = self._stream.fit()
        return estimate_of(self._known, fit, self._known.study, ())
