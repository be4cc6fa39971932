//! Tables of the parameters, gear laws and effects of the core.

use pyo3::prelude::*;
use pyo3::wrap_pyfunction;
use strainwave_core::arm::{Arm, OneLink, SerialChain, TwoLink};
use strainwave_core::joint::{effects, gear};
use strainwave_core::parameter::{Parameter, Sign};
use strainwave_core::plant::config::{OwnedParameter, joint_parameters};

/// Owner, name, symbol, meaning, units of a revolute and of a prismatic joint, range.
type Row = (
    &'static str,
    &'static str,
    &'static str,
    &'static str,
    (&'static str, &'static str),
    &'static str,
);

fn row((owner, parameter): OwnedParameter) -> Row {
    let [revolute, prismatic] = parameter.units;
    let range = match parameter.sign {
        Sign::Any => "any",
        Sign::NonNegative => "non-negative",
        Sign::Positive => "positive",
    };
    let Parameter {
        name,
        symbol,
        meaning,
        ..
    } = parameter;
    (owner, name, symbol, meaning, (revolute, prismatic), range)
}

/// All parameters of the core, once per owner; see _core.pyi.
#[pyfunction]
fn parameter_table() -> Vec<Row> {
    let of =
        |owner, parameters: &'static [Parameter]| parameters.iter().map(move |&one| (owner, one));
    of("planar-two-link", TwoLink::<true>::PARAMETERS)
        .chain(of("single-joint", OneLink::PARAMETERS))
        .chain(of("serial", SerialChain::<1>::PARAMETERS))
        .chain(joint_parameters())
        .map(row)
        .collect()
}

/// The gear laws: name, parameters, whether the gear is elastic; see _core.pyi.
#[pyfunction]
fn gear_laws() -> Vec<(&'static str, Vec<&'static str>, bool)> {
    let names = |law: &gear::Law| law.parameters.iter().map(|one| one.name).collect();
    gear::all_laws()
        .iter()
        .map(|law| (law.name, names(law), law.elastic))
        .collect()
}

/// The effects: name, parameters, number of sizes, whether they require an elastic gear; see
/// _core.pyi.
#[pyfunction]
fn joint_effects() -> Vec<(&'static str, Vec<&'static str>, usize, bool)> {
    let names = |effect: &effects::EffectDeclaration| {
        effect.parameters.iter().map(|one| one.name).collect()
    };
    effects::DECLARATIONS
        .iter()
        .map(|effect| (effect.name, names(effect), effect.sizes, effect.of_gear))
        .collect()
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(parameter_table, module)?)?;
    module.add_function(wrap_pyfunction!(gear_laws, module)?)?;
    module.add_function(wrap_pyfunction!(joint_effects, module)?)
}
