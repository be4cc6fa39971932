//! Prediction-error method: minimises the determinant of the innovation covariance.
//!
//! The objective is (N/2) log det(E'E/N + F) + [`Barrier`]: the negative log-likelihood of Gaussian
//! innovations, concentrated over their covariance. Levenberg-Marquardt minimises it in local
//! coordinates. Its gradient is that of the sum of squares weighted by the inverse of the current
//! covariance (Ljung, System Identification, 2nd ed., (7.94) and 10.2), so one pass over the data
//! gives both. The barrier keeps the predictor stable. With a second barrier, A is stable as well; the
//! cost then exceeds that of the best stable model by about half per pole at the limit.

use crate::linalg::{cholesky, log_determinant, solve_lower, solve_lower_transposed};
use crate::model::{Model, Record};
use crate::predictor;
use crate::sensitivity::{NormalEquations, normal_equations};
use crate::stability::{Barrier, predictor_change};
use crate::tangent::Coordinates;

/// Free entries and stopping criteria.
#[derive(Clone, Debug)]
pub struct Options {
    /// Whether K is estimated; otherwise it is fixed.
    pub gain: bool,
    /// For each input, whether its column of D is estimated; otherwise it is fixed.
    pub feedthrough: Vec<bool>,
    /// Whether the initial states are estimated.
    pub initial_states: bool,
    /// Whether A is kept stable, in addition to A - K C.
    pub stable: bool,
    /// F, (p,): variances at the level of rounding, which keep the objective finite for exact data.
    pub floor: Vec<f64>,
    /// Largest number of accepted steps.
    pub max_iterations: usize,
    /// The fit has converged when the predicted decrease of the negative log-likelihood is at most
    /// this.
    pub tolerance: f64,
}

/// How the fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The predicted decrease of the cost is within the tolerance.
    Converged,
    /// Iteration limit reached.
    IterationLimit,
    /// A decrease is predicted but no step reaches it; usually at the boundary of stability.
    Stalled,
}

/// Result of a fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The best model; its predictor is stable.
    pub model: Model,
    /// E'E/N, (p, p).
    pub innovation_covariance: Vec<f64>,
    /// (N/2) log det.
    pub cost: f64,
    /// Covariance of all entries, (size, size), singular along similarity transformations. `None`
    /// if the data do not determine a direction.
    pub covariance: Option<Vec<f64>>,
    /// Number of free directions.
    pub n_parameters: usize,
    /// Decrease of the cost predicted by the quadratic model at the last point.
    pub predicted_decrease: f64,
    /// Number of accepted steps.
    pub iterations: usize,
    /// Number of passes over the data without derivatives.
    pub evaluations: usize,
    /// How the fit ended.
    pub status: Status,
}

/// Why a fit cannot start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidStart {
    /// A - K C of the starting model, or A if it must be stable, is not stable.
    Unstable,
    /// The innovations of the starting model are not finite.
    NotFinite,
}

/// Initial damping relative to the curvature. Close to Gauss-Newton, because a subspace method
/// gives a good starting model.
const INITIAL_DAMPING: f64 = 1e-4;

/// Damping above which a step no longer changes the innovations.
const MAX_DAMPING: f64 = 1e12;

/// A model, its innovation covariance and its cost.
struct Point {
    model: Model,
    covariance: Vec<f64>,
    whitener: Vec<f64>,
    cost: f64,
    /// Of A - K C, and of A if it is kept stable.
    barriers: Vec<Barrier>,
}

/// Barriers of a model; `None` if one of its matrices is unstable.
fn barriers(model: &Model, options: &Options) -> Option<Vec<Barrier>> {
    let n = model.shape.order;
    let mut barriers = vec![Barrier::at(&model.predictor_matrix(), n)?];
    if options.stable {
        barriers.push(Barrier::at(model.a(), n)?);
    }
    Some(barriers)
}

impl Point {
    fn at(model: Model, records: &[Record<'_>], options: &Options) -> Option<Self> {
        let barriers = barriers(&model, options)?;
        let p = model.shape.outputs;
        let innovations = predictor::innovations(&model, records);
        let covariance = predictor::covariance(&innovations, p);
        let mut floored = covariance.clone();
        for (o, floor) in options.floor.iter().enumerate() {
            floored[o * p + o] += floor;
        }
        let whitener = cholesky(&floored, p)?;
        let samples = (innovations.len() / p) as f64;
        let cost = 0.5 * samples * log_determinant(&whitener, p);
        let point = Self {
            model,
            covariance,
            whitener,
            cost,
            barriers,
        };
        cost.is_finite().then_some(point)
    }
}

/// Fits a model to records from a starting model.
pub fn fit(start: Model, records: &[Record<'_>], options: &Options) -> Result<Fit, InvalidStart> {
    if barriers(&start, options).is_none() {
        return Err(InvalidStart::Unstable);
    }
    let free = free_entries(&start, options);
    let mut point = Point::at(start, records, options).ok_or(InvalidStart::NotFinite)?;
    let mut damping = INITIAL_DAMPING;
    let (mut iterations, mut evaluations) = (0, 1);
    loop {
        let step = Step::new(&point, records, &free);
        let predicted_decrease = step.predicted_decrease();
        let status = if predicted_decrease <= options.tolerance {
            Some(Status::Converged)
        } else if iterations == options.max_iterations {
            Some(Status::IterationLimit)
        } else {
            match step.search(&point, records, options, &mut damping, &mut evaluations) {
                Some(better) => {
                    point = better;
                    iterations += 1;
                    None
                }
                None => Some(Status::Stalled),
            }
        };
        if let Some(status) = status {
            return Ok(Fit {
                covariance: step.covariance(&point.model, &free),
                n_parameters: step.coordinates.width,
                model: point.model,
                innovation_covariance: point.covariance,
                cost: point.cost,
                predicted_decrease,
                iterations,
                evaluations,
                status,
            });
        }
    }
}

fn free_entries(model: &Model, options: &Options) -> Vec<usize> {
    let shape = model.shape;
    let mut free: Vec<usize> = (0..shape.d().start).collect();
    free.extend(
        shape
            .d()
            .filter(|entry| options.feedthrough[(entry - shape.d().start) % shape.inputs]),
    );
    if options.gain {
        free.extend(shape.k());
    }
    if options.initial_states {
        free.extend(shape.entries()..model.values.len());
    }
    free
}

/// Quadratic model of the cost at a point, in local coordinates.
struct Step {
    coordinates: Coordinates,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    /// Information matrix of all entries of the model.
    information: Vec<f64>,
}

impl Step {
    fn new(point: &Point, records: &[Record<'_>], free: &[usize]) -> Self {
        let NormalEquations {
            hessian: information,
            gradient,
            ..
        } = normal_equations(&point.model, records, &point.whitener);
        let coordinates = Coordinates::at(&point.model, free, &standard_deviations(&information));
        let reduced_information = coordinates.reduce_hessian(&information);
        let gradient = coordinates.reduce_gradient(&gradient);
        let changes: Vec<Vec<f64>> = (0..coordinates.width)
            .map(|index| coordinates.direction(index))
            .collect();
        let of_predictor = changes.iter().map(|c| predictor_change(&point.model, c));
        let of_plant = changes.iter().map(|c| c[point.model.shape.a()].to_vec());
        let directions: [Vec<Vec<f64>>; 2] = [of_predictor.collect(), of_plant.collect()];
        let with_barriers = |definite: bool| {
            let mut sums = (gradient.clone(), reduced_information.clone());
            for (barrier, directions) in point.barriers.iter().zip(&directions) {
                let (slope, curvature) = barrier.along(directions, definite);
                sums.0.iter_mut().zip(slope).for_each(|(g, s)| *g += s);
                sums.1.iter_mut().zip(curvature).for_each(|(h, c)| *h += c);
            }
            sums
        };
        let (mut total_gradient, mut hessian) = with_barriers(false);
        if cholesky(&hessian, coordinates.width).is_none() {
            (total_gradient, hessian) = with_barriers(true);
        }
        Self {
            gradient: total_gradient,
            hessian,
            coordinates,
            information,
        }
    }

    /// -(H + damping I)^-1 g, if the sum is positive definite.
    fn direction(&self, damping: f64) -> Option<Vec<f64>> {
        let width = self.coordinates.width;
        let mut damped = self.hessian.clone();
        for i in 0..width {
            damped[i * width + i] += damping;
        }
        let factor = cholesky(&damped, width)?;
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        solve_lower(&factor, width, &mut step);
        solve_lower_transposed(&factor, width, &mut step);
        Some(step)
    }

    /// Half the squared Newton decrement: the predicted decrease of a full step.
    fn predicted_decrease(&self) -> f64 {
        // Undetermined directions predict no decrease; slight damping excludes them.
        let step = self.direction(0.0).or_else(|| self.direction(1e-12));
        step.map_or(f64::INFINITY, |step| -0.5 * dot(&self.gradient, &step))
    }

    /// Increases the damping until the cost decreases; Nielsen's rule (Report IMM-REP-1999-05).
    ///
    /// Returns `None` if no damping below [`MAX_DAMPING`] decreases the cost.
    fn search(
        &self,
        point: &Point,
        records: &[Record<'_>],
        options: &Options,
        damping: &mut f64,
        evaluations: &mut usize,
    ) -> Option<Point> {
        let mut growth = 2.0;
        while *damping < MAX_DAMPING {
            if let Some(step) = self.direction(*damping) {
                let expected = 0.5 * (*damping * dot(&step, &step) - dot(&self.gradient, &step));
                let mut model = point.model.clone();
                self.coordinates.advance(&mut model.values, &step);
                *evaluations += 1;
                if let Some(trial) = Point::at(model, records, options) {
                    let value = |at: &Point| at.barriers.iter().map(|b| b.value).sum::<f64>();
                    let decrease = (point.cost - trial.cost) + (value(point) - value(&trial));
                    let gain = decrease / expected;
                    if gain > 0.0 {
                        *damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
                        return Some(trial);
                    }
                }
            }
            *damping *= growth;
            growth *= 2.0;
        }
        None
    }

    /// Inverse of the information over all free entries of the model, in orthonormal coordinates.
    fn covariance(&self, model: &Model, free: &[usize]) -> Option<Vec<f64>> {
        let coordinates = Coordinates::at(model, free, &vec![1.0; model.values.len()]);
        let mut information = coordinates.reduce_hessian(&self.information);
        let width = coordinates.width;
        let scale: Vec<f64> = standard_deviations(&information);
        for i in 0..width {
            for j in 0..width {
                information[i * width + j] *= scale[i] * scale[j];
            }
        }
        let factor = cholesky(&information, width)?;
        let mut inverse = vec![0.0; width * width];
        let mut column = vec![0.0; width];
        for j in 0..width {
            column.fill(0.0);
            column[j] = 1.0;
            solve_lower(&factor, width, &mut column);
            solve_lower_transposed(&factor, width, &mut column);
            for i in 0..width {
                inverse[i * width + j] = column[i] * scale[i] * scale[j];
            }
        }
        Some(coordinates.expand(&inverse))
    }
}

/// Standard deviation of each parameter if the others were known; 1 without information.
fn standard_deviations(information: &[f64]) -> Vec<f64> {
    let size = information.len().isqrt();
    (0..size)
        .map(|i| match information[i * size + i] {
            curvature if curvature > 0.0 => 1.0 / curvature.sqrt(),
            _ => 1.0,
        })
        .collect()
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}
