"""The compiled core: the arm's equations, servo and sensors; fits of state-space models."""

from collections.abc import Sequence
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DIVERGENCE_RATIO",
    "GEAR_CORNER",
    "Arm",
    "Experiment",
    "Innovations",
    "InnovationsFit",
    "LoadStream",
    "Subspace",
    "balancing",
    "block_products",
    "eigenvalues",
    "gear_laws",
    "huber_roots",
    "is_stable",
    "joint_effects",
    "loop_margins",
    "open_loops",
    "parameter_table",
    "reduce",
    "solve",
    "stabilising_gain",
    "symmetric_filter",
    "triangular_factor",
    "weighted_factor",
    "window_products",
]

DIVERGENCE_RATIO: float
"""Size of innovations of scaled outputs above which they diverge."""

GEAR_CORNER: float
"""Half width [rad] over which the knees of a three-slope gear are rounded."""

_Law = tuple[
    NDArray[np.float64],  # A (n, n)
    NDArray[np.float64],  # B (n, 3)
    NDArray[np.float64],  # C (n,)
    Sequence[float],  # D (3,)
    NDArray[np.float64],  # E (n,)
    Sequence[bool],  # states that hold (n,)
    NDArray[np.float64],  # states at rest per angle and voltage (n, 2)
]
_Servo = (
    tuple[Sequence[float], Sequence[float], float, Sequence[bool], Sequence[float] | None]
    | tuple[Sequence[_Law | None], float]
)

_WeightedEquations = tuple[
    NDArray[np.float64],  # regressors of the common unknowns (n_rows, n_common)
    NDArray[np.float64],  # standard deviations of the common unknowns (n_common,)
    NDArray[np.float64],  # regressors of the parameters (n_rows, n_parameters)
    NDArray[np.float64],  # targets (n_rows, n_targets)
    NDArray[np.float64],  # square roots of the weights (n_rows,)
    # local parts: rows, first unknown of each, its entries side by side, number of unknowns
    Sequence[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], int]],
    NDArray[np.float64],  # standard deviations of the unknowns of all parts (n_local,)
]

@final
class Experiment:
    """Inputs of an experiment, its initial state, and the quantities that it records."""

    @property
    def clock(self) -> tuple[float, int, int, int, int]:
        """Step [s], steps per tick, per servo reading and per sample, and number of samples."""

@final
class Arm:
    """An arm with its known constants; parameters are flat lists in `parameter_names`' order."""

    def __new__(
        cls,
        joints: Sequence[tuple[str, Sequence[float], Sequence[float], Sequence[float]]],
        springs: Sequence[str],
        gear_ratio: Sequence[float],
        *,
        program: str = "serial",
        gravity: Sequence[float] = ...,
        transmission: Sequence[Sequence[float]] | None = None,
        torque_per_volt: Sequence[float] | None = None,
        current_loop_hz: Sequence[float | None] | None = None,
        encoder_counts: Sequence[float | None] | None = None,
        accelerometer_distance: Sequence[float] | None = None,
        accelerometer_hz: Sequence[float | None] | None = None,
        gyro_hz: Sequence[float | None] | None = None,
        imu_accelerometer_hz: Sequence[float | None] | None = None,
        imu_gyro_hz: Sequence[float | None] | None = None,
        effects: Sequence[Sequence[str]] | None = None,
        gear_corner: float = ...,
    ) -> Arm:
        """A chain of 1 to 7 rigid links on joints that are placed anywhere in space.

        A joint is "revolute" or "prismatic", its origin [m] and its roll, pitch and yaw [rad] at
        zero angle in the frame of the link before, and its axis in its own frame, as in URDF.
        `gravity` is an acceleration [m/s^2] in the base's frame, (0, 0, -9.81) by default. Each
        link has ten inertial parameters: its mass, its first moments m c and its inertia about its
        frame's origin, in its frame's axes. Its accelerometer sits at `accelerometer_distance`
        across the joint's axis, along the frame's x axis as far as that is across, and reads across
        both; on a prismatic joint it reads along the axis, at the origin. A gyro reads the rate
        about the axis. Of an IMU's signals there are those in the plane across the axis. With the
        rows of a `transmission` C, torsions are C n theta_M - q, and the motors carry n C' T;
        without it each motor moves its own joint. Raises ValueError for other numbers of joints,
        axes without a direction, a singular C, and a C that couples rigid and elastic gears.

        `program` names compiled programs: "serial" for these chains; "planar-two-link" and
        "single-joint" for planar arms, whose joints are given in the same way, and whose parameters
        are those of their closed forms. Raises ValueError for other programs, and for a
        `transmission` of a planar arm.
        """
    @property
    def n_joints(self) -> int: ...
    @property
    def parameter_names(self) -> list[tuple[str, int | None]]: ...
    def experiment(
        self,
        voltage: NDArray[np.float64],
        *,
        motor_angle: Sequence[float],
        step: float,
        steps_per_tick: int,
        steps_per_sample: int,
        samples: int,
        record: Sequence[str],
        reference: NDArray[np.float64] | None = None,
        servo: _Servo | None = None,
        steps_per_servo: int = 1,
        motor_velocity: Sequence[float] | None = None,
        link_angle: Sequence[float] | None = None,
        link_velocity: Sequence[float] | None = None,
        initial_voltage: Sequence[float] | None = None,
        link_sensors: Sequence[tuple[str, bool, NDArray[np.float64]]] | None = None,
    ) -> Experiment:
        """An experiment; `voltage` and `reference` have a row per tick and a column per joint.

        `servo` is (kp, ki, limit, active joints, gains of a position loop around it), or (laws,
        limit) with a linear law per joint, None for a joint without servo: v_k = C x_k +
        D (r_k, w_k, y_k), u_k = v_k + voltage_k limited, x_k+1 = A x_k + B (r_k, w_k, y_k) +
        E (u_k - voltage_k), with w the reference, r its integral from the first encoder reading,
        and y the encoder reading. Links without an angle hang on their gears in equilibrium.
        `link_sensors` are names for `record`, whether each is a gyro, and weights (n_joints,
        n_signals) of the links' signals. Raises ValueError for sizes that do not fit.
        """
    @property
    def lanes(self) -> int:
        """Numbers in a register: so many experiments take little longer than one."""
    def simulate(
        self, parameters: NDArray[np.float64], experiments: Sequence[Experiment]
    ) -> list[dict[str, NDArray[np.float64]]]:
        """Experiments, each with its row of `parameters`: arrays (samples, n_joints) by quantity.

        Neighbours with equal clocks and quantities share registers; the GIL is released. Raises
        ValueError for sizes that do not fit and values no arm can have, FloatingPointError where a
        motion leaves the finite numbers.
        """
    def sensitivities(
        self,
        parameters: NDArray[np.float64],
        experiment: Experiment,
        with_respect_to: Sequence[tuple[str, int | None]],
    ) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """One arm's experiment with its exact derivatives.

        For each quantity the values (samples, n_joints) that `simulate` gives and their tangents
        (samples, n_joints, n_directions). A direction is a name of `parameter_names`, or
        `initial_motor_angle`, `initial_motor_velocity`, `initial_link_angle` or
        `initial_link_velocity` and a joint from 1; where the links hang on their gears, the initial
        link angle is what is added to the hanging one. The GIL is released, so that records can run
        in threads. Errors are those of `simulate`.
        """
    def channel_sensitivities(
        self,
        parameters: NDArray[np.float64],
        experiment: Experiment,
        with_respect_to: Sequence[tuple[str, int | None]],
        channels: Sequence[tuple[int, int, float]],
        chain: NDArray[np.float64],
        *,
        variants: Sequence[tuple[NDArray[np.float64], Sequence[tuple[str, int | None]]]] = ...,
        taps: Sequence[NDArray[np.float64]] | None = None,
        samples_per_row: int = 1,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Channels of one arm's experiment with their exact derivatives, as `sensitivities`.

        A channel is the index of a quantity in the record, that of a joint, and a factor. Returns
        the channels (samples, n_channels) and their tangents (samples, n_channels, n_columns).
        `chain` (n_directions, n_columns) are the derivatives of the directions by the variables of
        the columns. `variants` are further directions, by sizes of effects that are zero, with
        other values of parameters that have no influence then. With `taps`, a list for each
        quantity, all equally long, samples x become rows, row r the sum of taps[t]
        x[r samples_per_row + t]. Errors are those of `simulate`, and ValueError for taps, channels
        and a chain that do not fit.
        """
    def base_regressor(
        self,
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Link-side torques per inertial parameter: (n_samples, n_joints, n_base)."""
    def motor_regressor(
        self,
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
        combinations: NDArray[np.float64],
        transmission: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Motor torques per combination of inertial parameters: (n_samples, n_joints, n).

        `combinations` (n_base, n); `transmission` (n_joints, n_joints) has link angles per motor
        angle. Raises ValueError for other shapes.
        """
    def link_torques(
        self,
        base: NDArray[np.float64],
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Link-side torques for base parameters, physical or not: (n_samples, n_joints)."""
    def link_motion(
        self,
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Motion of each link in its own frame: (n_samples, n_joints, 9).

        Angular velocity [rad/s], angular acceleration [rad/s^2], and specific force a - g [m/s^2]
        of the frame's origin. Frames as in `Arm`; a planar arm moves in the x-y plane,
        along x if it is prismatic, and gravity acts against y.
        """
    def link_motion_derivatives(
        self,
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> list[NDArray[np.float64]]:
        """Derivatives of `link_motion` by angles, velocities and accelerations.

        Three arrays (n_samples, n_joints, 9, n_joints), by link, entry and moved joint.
        """
    def inverse_dynamics(
        self,
        parameters: NDArray[np.float64],
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Motor torques of a links' motion behind rigid gears, (5): (n_samples, n_joints)."""
    def inertia_matrix(
        self, base: NDArray[np.float64], angle: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """M_L(q) of (2) for base parameters at each posture: (n_samples, n_joints, n_joints)."""
    def bias_torques(
        self,
        parameters: NDArray[np.float64],
        angle: NDArray[np.float64],
        velocity: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Centrifugal, Coriolis and gravity torques c + g of (2): (n_samples, n_joints)."""

def block_products(
    equations: _WeightedEquations, block: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Products of all columns without the local unknowns, each (n_columns, n_columns).

    Columns are those of `reduce`, in units of the parameters. `block` (n_rows,) is less than
    `count`; it is negative for priors. Returns the sum over all rows, the contribution of each
    block (count, ...), and that of the errors of priors. The GIL is released. Raises ValueError for
    sizes that do not fit, local unknowns of priors and entries that are not finite.
    """

def eigenvalues(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Real and imaginary parts (n_matrices, n, 2) of eigenvalues of matrices (n_matrices, n, n).

    Their order is not defined. The GIL is released. Raises ArithmeticError for entries that are not
    finite, and ValueError for matrices that are not square or not contiguous.
    """

def huber_roots(
    residual: NDArray[np.float64],
    leverage: NDArray[np.float64],
    target: NDArray[np.float64],
    group: NDArray[np.int64],
    std_per_median: float,
) -> NDArray[np.float64]:
    """Square roots (n_rows,) of Huber's weights, 1 for negative groups; see `root_weights`.

    Raises ValueError for sizes that do not fit.
    """

def loop_margins(
    loops: NDArray[np.float64], hz: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Margins (n_plants, 7) of open loops (n_plants, 2 n_omega), and encirclements (n_plants,).

    Columns of the loops are real and imaginary parts in turn, those of the margins the fields of
    `tune.margins.Margins` in their order. The GIL is released. Raises ValueError for sizes that do
    not fit and loops that are not contiguous.
    """

def open_loops(responses: NDArray[np.float64], roots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Loops (n_joints, n_plants, 2 n_omega), each with the loops of the other joints closed.

    `responses` (n_plants, n_pairs, 2 n_omega) are the symmetric S of pairs of joints, `roots`
    (n_joints, 2 n_omega) are those of the factors of `tune.margins.open_loops`; columns are real
    and imaginary parts in turn. The GIL is released. Raises ValueError for sizes that do not fit
    and arrays that are not contiguous.
    """

def reduce(
    equations: _WeightedEquations,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Fields of `ReducedRows`. The GIL is released.

    Linear in the rows where the windows follow one another. Raises ValueError for sizes that do not
    fit and entries that are not finite.
    """

def solve(
    equations: _WeightedEquations, noise: NDArray[np.float64]
) -> tuple[
    NDArray[np.float64],  # parameters (n_parameters, n_targets)
    NDArray[np.float64],  # common unknowns (n_common, n_targets)
    NDArray[np.float64],  # local unknowns (n_local, n_targets)
    NDArray[np.float64],  # residuals (n_rows, n_targets)
    NDArray[np.float64],  # norms of the parameters' columns
    NDArray[np.float64],  # singular values
    NDArray[np.float64],  # directions (n_parameters, n_parameters)
    NDArray[np.bool_],  # whether they are resolved
    NDArray[np.float64],  # leverages (n_rows,)
]:
    """Solution for each target and the other fields of `Factor`; see `factorise`.

    `noise` (n_parameters,) is the rms noise of each column. The GIL is released. Raises ValueError
    for sizes that do not fit and entries that are not finite.
    """

def symmetric_filter(
    signal: NDArray[np.float64],
    response: NDArray[np.float64],
    first: int,
    step: int,
    count: int,
) -> NDArray[np.float64]:
    """Samples (count, n_columns) of a signal (n_samples, n_columns) after a symmetric filter.

    `response` (n,) is the impulse response at the impulse and at later samples. The signal is
    extended at both ends by point reflection. The GIL is released. Raises ValueError for samples
    beyond the signal and for a longer response.
    """

def triangular_factor(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """R (n, n) of the QR decomposition of a contiguous table (n_rows, n). The GIL is released."""

def weighted_factor(
    columns: Sequence[NDArray[np.float64]],
    scale: NDArray[np.float64],
    residual: NDArray[np.float64],
    biased: Sequence[int],
) -> NDArray[np.float64]:
    """R (n + 1, n + 1) of the rows [scale columns, residual] without the biases of some channels.

    `columns` are derivatives (n_rows, n_channels, ...), n in all, `scale` (n_rows, n_channels)
    their factors. `residual` (n_rows, n_channels) contains the factors. The rows of each channel of
    `biased` are projected onto the complement of its factors. The table is not stored. The GIL is
    released.
    Raises ValueError for sizes that do not fit and arrays that are not contiguous.
    """

def balancing(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    k: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """State transformation that balances the predictor (A - K C, [B, K], C).

    None if the predictor is unstable or one of its Gramians is singular.
    """

def stabilising_gain(
    a: NDArray[np.float64],
    c: NDArray[np.float64],
    k: NDArray[np.float64],
    covariance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Gain K (n, p), or the gain of a stable predictor with the same noise spectrum.

    K is returned if A - K C is stable. Otherwise the Riccati equation with w = K e and v = e gives
    the stable predictor, for innovations e with a covariance (p, p).
    """

def is_stable(matrix: NDArray[np.float64]) -> bool:
    """Whether all eigenvalues are inside the unit circle, by more than 1e-12."""

@final
class Innovations:
    """Stacked records and the sizes of a model for them.

    `samples` are rows of inputs and outputs, contiguous, which are not copied. `values` are A, B,
    C, D, K row by row and one initial state a record. A `whitener` L is the lower factor of the
    innovations' covariance. Sizes that do not fit raise ValueError.
    """

    def __new__(
        cls,
        order: int,
        n_inputs: int,
        samples: NDArray[np.float64],
        lengths: Sequence[int],
    ) -> Innovations: ...
    def residuals(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """e[k] = y[k] - C x[k] - D u[k]: (n_samples, n_outputs)."""
    def jacobian(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives of the innovations: (n_samples, n_outputs, n_entries + order).

        The last columns are those of the initial state of the sample's own record.
        """
    def scores(
        self, values: NDArray[np.float64], whitener: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """E' W (d e / d values) of every sample, W^-1 = L L': (n_samples, n_entries + order)."""
    def normal_equations(
        self, values: NDArray[np.float64], whitener: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """J'WJ and J'We with respect to `values`, W^-1 = L L'."""
    def linear(
        self,
        values: NDArray[np.float64],
        feedthrough: Sequence[bool] | None,
        floor: float | None,
    ) -> NDArray[np.float64] | None:
        """`values` with B, D and the initial states by linear least squares.

        Without `feedthrough`, only the initial states are estimated. With a `floor`, a second
        solution weights the outputs by the inverse covariance of the innovations of the first, plus
        the floor. None if the predictor overflows.
        """
    def fit(
        self,
        values: NDArray[np.float64],
        gain: bool,
        feedthrough: Sequence[bool],
        initial_states: bool,
        stable: bool,
        floor: Sequence[float],
        max_iterations: int,
        tolerance: float,
    ) -> InnovationsFit:
        """Prediction-error fit from a start whose predictor is stable.

        With `stable`, the start has a stable A, and all iterates keep it.
        """

@final
class Subspace:
    """Subspace methods for one data set and one horizon; triangular factors are kept.

    The order of `data` is ignored.
    """

    def __new__(cls, data: Innovations, horizon: int) -> Subspace: ...
    def regression(self) -> tuple[NDArray[np.float64], int]:
        """R of [u[k], z[k-1], ..., z[k-horizon], y[k]] and its number of rows of data."""
    def realise(
        self,
        method: str,
        feedthrough: Sequence[bool],
        floor: float,
        *,
        order: int | None,
        max_order: int,
    ) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
        """Order; balanced model as values of `Innovations`, initial states zero; singular values.

        Without an `order`, the singular values select one of at most `max_order`. `floor` is added
        to the variance of every output.
        """

@final
class InnovationsFit:
    """The end of a prediction-error fit."""

    @property
    def values(self) -> NDArray[np.float64]: ...
    @property
    def innovation_covariance(self) -> NDArray[np.float64]: ...
    @property
    def covariance(self) -> NDArray[np.float64] | None: ...
    @property
    def cost(self) -> float: ...
    @property
    def predicted_decrease(self) -> float: ...
    @property
    def n_parameters(self) -> int: ...
    @property
    def iterations(self) -> int: ...
    @property
    def evaluations(self) -> int: ...
    @property
    def status(self) -> Literal["converged", "iteration-limit", "stalled"]: ...

def parameter_table() -> list[
    tuple[str, str, str, str, tuple[str, str], Literal["any", "non-negative", "positive"]]
]:
    """Every parameter that the core knows: owner, name, symbol, meaning, units, range.

    The owner is a kind of arm, "drive", "gear" (what every elastic gear has), a law of gears or an
    effect; a name that two laws share is there for each. The units are those of a revolute and of a
    prismatic joint.
    """

def gear_laws() -> list[tuple[str, list[str], bool]]:
    """The laws of gears: name, names of its parameters in their order, whether it gives way."""

def joint_effects() -> list[tuple[str, list[str], int, bool]]:
    """The effects: name, parameters in their order, how many of these are sizes, of_gear.

    The sizes come first; an effect whose sizes are all zero is not there. One `of_gear` takes an
    elastic gear.
    """

@final
class LoadStream:
    """Equations of a load on an identified arm, from samples of motor angles and torques."""

    def __new__(
        cls,
        arm: Arm,
        *,
        chain: Arm | None,
        sample_time: float,
        bandwidth_hz: float,
        motion_poles_hz: float,
        samples_per_row: int,
        rows_per_block: int,
        blocks: int,
        transmission: NDArray[np.float64],
        inverse: NDArray[np.float64],
        links: Sequence[float],
        motor_inertia: Sequence[float],
        friction: NDArray[np.float64],
        shared: Sequence[tuple[int, float]],
        terms: Sequence[tuple[str, int, float, float]],
        compliance: Sequence[float],
        zero: Sequence[float],
        per_command: Sequence[float],
        decay: Sequence[float],
        delay: Sequence[float],
        slow: Sequence[float],
        weight: Sequence[float],
    ) -> LoadStream:
        """A stream without samples.

        `chain` is the general chain of an arm with a program of its own. `links` are base
        parameters, `friction` (n_joints, 3) viscous and Coulomb friction and offset of the joints,
        `shared` links from 0 and their viscous friction, `terms` effects with joint from 0, shape
        and size. `decay` is that of current loops over a sample, `delay` [samples] by which torques
        are late, `slow` [rad/s] the speed below which a motor may stick, and `weight` the
        reciprocal errors of the torques. Raises ValueError for sizes that do not fit.
        """
    def update(self, angle: NDArray[np.float64], input: NDArray[np.float64]) -> None:
        """Add a sample of motor angles [rad] and inputs (n_joints,); ValueError for other sizes."""
    def reset(self) -> None:
        """Forget all samples."""
    def equations(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Factors (n_blocks, n + 1, n + 1) of the equations, and products (n_blocks, n, n_arm).

        The n unknowns are the friction of all joints and the ten parameters of the load; the
        products are those of the equations with the columns of links, motors and shared friction.
        """

def window_products(
    first: NDArray[np.int64], entries: NDArray[np.float64], unknowns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Product (n_rows,) of a `Banded` matrix with a vector.

    Raises ValueError for windows that reach beyond the vector.
    """
