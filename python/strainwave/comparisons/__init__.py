"""The claims of the source, Figs. 4 to 15, put to the built-in arm whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from strainwave.comparisons import amplitude, decoupled, feedback, inputs, refinement, steps
from strainwave.comparisons.document import to_json
from strainwave.comparisons.rig import Rig
from strainwave.parameters import Values
from strainwave.records import Comparison

__all__ = ["ComparisonOptions", "compare", "to_json"]


@dataclass(frozen=True, slots=True)
class ComparisonOptions:
    """How much is simulated."""

    amplitudes: tuple[float, ...] = (2.0, 4.0, 6.0, 8.0, 10.0)  # [V]
    payloads: tuple[int, ...] = (5, 3, 1, 0)  # [kg]
    records: int = 4  # of one period, at each amplitude


def compare(
    tuned: Mapping[tuple[str, int | None], float] | None = None,
    *,
    seed: int = 0,
    options: ComparisonOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Comparison, ...]:
    """Every comparison, in the order of the source's figures.

    Parameters
    ----------
    tuned : mapping, optional
        (name, joint) -> value of the arm with its full payload, as tuned on closed-loop records.
        None: as the equations of motion give them, joint by joint.
    seed : int
        Of the sensors' noise and of the motions.
    options : ComparisonOptions, optional
    progress : callable
        Told what is being done.

    Returns
    -------
    tuple of Comparison
    """
    chosen = options or ComparisonOptions()
    rig = Rig(seed, progress)
    progress("comparing: inputs")
    found = [inputs.prbs(rig), inputs.free(rig), inputs.servoed(rig)]
    progress("comparing: refinement")
    before = refinement.modified_values(rig)
    after: Values = dict(tuned) if tuned is not None else refinement.grey_box_values(rig)
    found += [refinement.responses(rig, joint, after) for joint in (1, 2)]
    found += [steps.tuning(rig, before, after), steps.validation(rig, after)]
    progress("comparing: second input and output")
    found += [decoupled.inputs(rig), decoupled.outputs(rig, chosen.payloads)]
    progress("comparing: closed loop")
    found.append(feedback.methods(rig))
    swept = {
        joint: amplitude.levels(rig, joint, chosen.amplitudes, chosen.records) for joint in (1, 2)
    }
    found += [amplitude.responses(swept), amplitude.squares(swept)]
    return tuple(sorted(found, key=lambda comparison: comparison.figure))
