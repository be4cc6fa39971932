"""State-space estimation: arrays of inputs and outputs in, models with uncertainty out.

`subspace` needs no start and `pem` refines it, both on deviations from a working point, as
`without_means` gives them; `check_model` and `select_order` judge. What follows from a model, with
its uncertainty: `to_continuous`, `frequency_response`, `modes`, and anything else by `propagate`.
"""

from strainwave.statespace._stack import without_means
from strainwave.statespace.continuous import to_continuous
from strainwave.statespace.modes import modes, nearest, poles_and_zeros
from strainwave.statespace.order import select_order
from strainwave.statespace.pem import PemOptions, pem
from strainwave.statespace.propagation import propagate
from strainwave.statespace.residuals import check_model
from strainwave.statespace.response import frequency_response
from strainwave.statespace.subspace import subspace, subspace_orders

__all__ = [
    "PemOptions",
    "check_model",
    "frequency_response",
    "modes",
    "nearest",
    "pem",
    "poles_and_zeros",
    "propagate",
    "select_order",
    "subspace",
    "subspace_orders",
    "to_continuous",
    "without_means",
]
