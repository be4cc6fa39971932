"""Defective samples are interpolated and masked, and no equation or row of a fit uses them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from elastic_runs import log_of, prbs_run, rig
from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.records.preparation import coarsen_steps, dataset_of
from strainwave.signals import hygiene
from strainwave.signals.channels import unmeasured
from strainwave.signals.hygiene import interpolate_masked, repair_record
from strainwave.signals.hygiene.defects import Defect
from strainwave.signals.link_motion import prepare_link_signals
from strainwave.signals.motor import prepare_motor_signals

ARM = Arm.of(rig().arm)
CUTOFF = 100.0  # [Hz] low-pass of the whole-arm dataset


@cache
def log() -> Log:
    return log_of(prbs_run(rig()), seed=0)


def spoilt(channel: str, start: int, stop: int, kind: hygiene.Kind = "spikes") -> Log:
    usable, excluded_channels = repair_record(log(), ARM, [Defect(kind, channel, start, stop, 1.0)])
    assert usable is not None
    assert excluded_channels == ()
    return usable


# --- interpolation and correction -------------------------------------------------------------


@given(
    st.lists(st.booleans(), min_size=5, max_size=60).filter(lambda bad: not all(bad)),
    st.floats(-3.0, 3.0),
)
def test_interpolation_restores_a_straight_line(where: list[bool], slope: float) -> None:
    """Linear interpolation restores a straight line exactly."""
    is_defective = np.array(where)
    is_defective[0] = is_defective[-1] = False
    x = slope * np.arange(len(is_defective))
    defective = np.where(is_defective, 1e6, x)
    np.testing.assert_allclose(interpolate_masked(defective, is_defective), x, atol=1e-12 * len(x))


def test_a_voltage_holds_its_last_value() -> None:
    x: FloatArray = np.array([9.0, 1.0, 2.0, 9.0, 9.0, 3.0])
    is_defective = x == 9.0
    assert interpolate_masked(x, is_defective, hold=True).tolist() == [1.0, 1.0, 2.0, 2.0, 2.0, 3.0]


def test_an_encoder_step_is_subtracted_in_whole_counts() -> None:
    count = 2.0 * np.pi / 8192
    x = log().channels["theta_m1"].copy()
    x[5000:] += 300 * count
    stepped = replace(log(), channels={**log().channels, "theta_m1": x})
    step = Defect("encoder-steps", "theta_m1", 5000, 5001, 300.3 * count)
    usable, _ = repair_record(stepped, ARM, [step])
    assert usable is not None
    assert np.flatnonzero(usable.masked["theta_m1"]).tolist() == [4999, 5000]
    error = usable.channels["theta_m1"] - log().channels["theta_m1"]
    assert np.abs(error[~usable.masked["theta_m1"]]).max() < 1e-9


# --- excluded records and channels ------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "share", "used"),
    [
        ("a2", 0.15, ()),
        ("a2", 0.3, ("a2",)),
        ("theta_m1", 0.15, ()),
        ("theta_m1", 0.3, None),
        ("u1", 0.0005, ()),
        ("u1", 0.02, None),
    ],
)
def test_a_channel_with_many_defects_is_excluded(
    channel: str, share: float, used: tuple[str, ...] | None
) -> None:
    """A channel with many defects is excluded; a motor angle or input excludes the record."""
    stop = 4000 + int(share * len(log()))
    usable, excluded_channels = repair_record(
        log(), ARM, [Defect("frozen", channel, 4000, stop, 1.0)]
    )
    if used is None:
        assert usable is None
        assert excluded_channels == (channel,)
    else:
        assert usable is not None
        assert excluded_channels == used
        assert (channel in usable.channels) == (not used)


def test_an_encoder_with_many_steps_is_excluded() -> None:
    steps = [Defect("encoder-steps", "theta_m2", k, k + 1, 0.3) for k in range(100, 2300, 100)]
    assert repair_record(log(), ARM, steps) == (None, ("theta_m2",))
    wraps = [replace(step, wraps=True) for step in steps]
    assert repair_record(log(), ARM, wraps)[0] is not None


# --- equations and rows without defective samples ---------------------------------------------


def test_rigid_equations_exclude_defective_samples() -> None:
    """The rigid step excludes long stretches with defective torque or motion, not short ones."""
    of_torque = prepare_motor_signals(spoilt("u1", 5000, 5040), ARM)
    assert not of_torque.valid[5000:5040, 0].any()
    assert of_torque.valid[5000:5040, 1].all()
    of_motion = prepare_motor_signals(spoilt("theta_m2", 5000, 5040), ARM)
    assert not of_motion.valid[5000:5040].any()
    assert prepare_motor_signals(spoilt("u1", 5000, 5003), ARM).valid[5000:5003].all()


def test_linear_models_use_only_short_interpolated_stretches() -> None:
    """Linear models use short interpolated stretches and exclude long ones."""
    assert prepare_link_signals(spoilt("a1", 5000, 5003), ARM).valid[5000:5003].all()
    assert not prepare_link_signals(spoilt("a1", 5000, 5100, "frozen"), ARM).valid[5000:5100].any()


def test_the_whole_arm_fit_excludes_rows_with_defective_samples() -> None:
    """The whole-arm fit excludes rows whose filter includes defective samples."""
    record = dataset_of(spoilt("a2", 5000, 5003), ARM, CUTOFF)
    assert record.is_counted is not None
    names = [channel.channel for channel in record.channels]
    reach = 0.5 * len(record.kernels.smooth) * log().sample_time
    near = np.abs(record.time - log().time[5001]) < reach
    for k, name in enumerate(names):
        excluded = ~record.is_counted[:, k]
        assert excluded.any() == (name == "a2")
        assert not (excluded & ~near).any()
    assert near[~record.is_counted.all(axis=1)].all()
    assert (~record.is_counted).sum() >= near.sum() - 2
    assert dataset_of(log(), ARM, CUTOFF).is_counted is None


def test_masks_are_decimated_with_their_channels() -> None:
    """Masks are decimated together with their channels."""
    record = coarsen_steps(dataset_of(spoilt("a2", 5001, 5002), ARM, CUTOFF), 2e-3)
    assert record.is_counted is not None
    assert not record.is_counted.all()
    assert np.flatnonzero(unmeasured(record.log, ("a2",))).tolist() == [5001 // 8]
