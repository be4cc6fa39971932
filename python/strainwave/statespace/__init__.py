"""State-space estimation from input-output data, with covariances.

`subspace` estimates a model without a starting value; `pem` refines it by prediction-error
minimisation. Both expect channels without means, see `remove_means`. `check_model` tests the
residuals and `select_order` compares orders. `to_continuous`, `frequency_response` and `modes`
derive quantities from a model with their uncertainty; `propagate` does so for any function.
"""

from strainwave.statespace._scaled import remove_means as remove_means
from strainwave.statespace.derived import frequency_response as frequency_response
from strainwave.statespace.derived import modes as modes
from strainwave.statespace.derived import nearest as nearest
from strainwave.statespace.derived import poles_and_zeros as poles_and_zeros
from strainwave.statespace.derived import propagate as propagate
from strainwave.statespace.derived import (
    remove_alternating_poles as remove_alternating_poles,
)
from strainwave.statespace.derived import to_continuous as to_continuous
from strainwave.statespace.order import select_order as select_order
from strainwave.statespace.pem import PemOptions as PemOptions
from strainwave.statespace.pem import pem as pem
from strainwave.statespace.residuals import check_model as check_model
from strainwave.statespace.subspace import subspace as subspace
from strainwave.statespace.subspace import subspace_orders as subspace_orders
