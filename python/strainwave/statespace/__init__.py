"""State-space estimation: arrays of inputs and outputs in, models with uncertainty out."""

from strainwave.statespace.pem import PemOptions, pem
from strainwave.statespace.subspace import subspace
