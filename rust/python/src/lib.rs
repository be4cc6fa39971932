//! Python bindings of the core: convert, compute without the GIL, map the error. No arithmetic.

mod arguments;
mod arm;
mod eigenvalues;
mod experiment;
mod least_squares;
mod load_stream;
mod open_loops;
mod parameters;
mod statespace;
mod symmetric_filter;
mod triangular;

use pyo3::prelude::*;

/// The compiled core of strainwave.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<arm::Arm>()?;
    module.add_class::<experiment::Experiment>()?;
    module.add_class::<load_stream::LoadStream>()?;
    statespace::register(module)?;
    least_squares::register(module)?;
    triangular::register(module)?;
    symmetric_filter::register(module)?;
    eigenvalues::register(module)?;
    open_loops::register(module)?;
    parameters::register(module)?;
    module.add("GEAR_CORNER", strainwave_core::joint::gear::CORNER)?;
    Ok(())
}
