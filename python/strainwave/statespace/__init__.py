"""State-space estimation from input-output data, with covariances.

`subspace` estimates a model without a starting value; `pem` refines it by prediction-error
minimisation. Both expect channels without means, see `remove_means`. `check_model` tests the
residuals and `select_order` compares orders. `to_continuous`, `frequency_response` and `modes`
derive quantities from a model with their uncertainty; `propagate` does so for any function.
"""

from strainwave.statespace._stack import remove_means
from strainwave.statespace.alternating_poles import remove_alternating_poles
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
    "remove_alternating_poles",
    "remove_means",
    "select_order",
    "subspace",
    "subspace_orders",
    "to_continuous",
]
