"""Poles on the negative real axis, which have no continuous-time equivalent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, StateSpace
from strainwave.statespace.propagation import propagate


def remove_alternating_poles(model: StateSpace) -> StateSpace:
    """Remove poles on the negative real axis, which have no continuous-time equivalent.

    Such a pole alternates in sign from sample to sample and models the edge of the band, at
    Nyquist. Within the band it is a constant gain, which is added to D. The covariance is
    propagated. Returns the model itself if it has no such pole.
    """
    values, vectors = np.linalg.eig(model.A)
    alternating = np.flatnonzero((values.imag == 0.0) & (values.real <= 0.0))
    if not len(alternating) or len(alternating) == model.order:
        return model
    z, w = float(values[alternating[0]].real), np.linalg.inv(vectors)[alternating[0]].real
    # w'A = z w': `complement` is the invariant subspace
    complement = np.linalg.svd(w[None])[2][1:].T
    reduced = _without(z, complement, model)

    def entries(near: StateSpace) -> FloatArray:
        other = _without(z, complement, near)
        return np.concatenate([np.ravel(m) for m in (other.A, other.B, other.C, other.D, other.K)])

    if model.covariance is not None:
        reduced = replace(reduced, covariance=propagate(model, entries)[1])
    return remove_alternating_poles(reduced)


def _without(z: float, others: FloatArray, model: StateSpace) -> StateSpace:
    """Remove the pole nearest to z, in the basis `others` projected along that pole's eigenvector.

    The basis is a smooth function of the model, as `propagate` requires.
    """
    values, vectors = np.linalg.eig(model.A)
    index = int(np.argmin(np.abs(values - z)))
    pole, v, w = values[index].real, vectors[:, index].real, np.linalg.inv(vectors)[index].real
    basis = others - np.outer(v, w @ others)
    projection = np.linalg.inv(np.column_stack([basis, v]))[:-1]
    return replace(
        model,
        A=projection @ model.A @ basis,
        B=projection @ model.B,
        C=model.C @ basis,
        D=model.D + np.outer(model.C @ v, w @ model.B) / (1.0 - pole),
        K=projection @ model.K,
        initial_states=model.initial_states @ projection.T,
        covariance=None,
    )
