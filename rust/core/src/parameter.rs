//! Declarations of parameters, next to the equations that they belong to.

/// Admissible values of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// Any finite value.
    Any,
    /// Zero or more.
    NonNegative,
    /// More than zero.
    Positive,
}

impl Sign {
    /// Whether a finite value is admissible.
    pub fn allows(self, value: f64) -> bool {
        match self {
            Self::Any => true,
            Self::NonNegative => value >= 0.0,
            Self::Positive => value > 0.0,
        }
    }

    /// Description of the admissible values.
    pub fn requirement(self) -> &'static str {
        match self {
            Self::Any => "finite",
            Self::NonNegative => "zero or positive",
            Self::Positive => "positive",
        }
    }
}

/// Declaration of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Name, as in docs/notation.md and in results.
    pub name: &'static str,
    /// Symbol in equations, as plain text: `m_M` is m with the index M.
    pub symbol: &'static str,
    /// Meaning, in one line.
    pub meaning: &'static str,
    /// Units for revolute and prismatic joints.
    pub units: [&'static str; 2],
    /// Admissible values.
    pub sign: Sign,
}

impl Parameter {
    /// A parameter of any sign, without a meaning yet.
    pub const fn any(name: &'static str, symbol: &'static str, units: [&'static str; 2]) -> Self {
        Self {
            name,
            symbol,
            meaning: "",
            units,
            sign: Sign::Any,
        }
    }

    /// As [`Parameter::any`], zero or more.
    pub const fn non_negative(
        name: &'static str,
        symbol: &'static str,
        units: [&'static str; 2],
    ) -> Self {
        Self {
            sign: Sign::NonNegative,
            ..Self::any(name, symbol, units)
        }
    }

    /// As [`Parameter::any`], more than zero.
    pub const fn positive(
        name: &'static str,
        symbol: &'static str,
        units: [&'static str; 2],
    ) -> Self {
        Self {
            sign: Sign::Positive,
            ..Self::any(name, symbol, units)
        }
    }

    /// The parameter with its meaning.
    pub const fn meaning(self, meaning: &'static str) -> Self {
        Self { meaning, ..self }
    }
}

/// A pure number.
pub const NO_UNIT: [&str; 2] = ["1", "1"];
/// kg m^2, or kg.
pub const INERTIA: [&str; 2] = ["kg m^2", "kg"];
/// N m, or N.
pub const TORQUE: [&str; 2] = ["N m", "N"];
/// N m s/rad, or N s/m.
pub const DAMPING: [&str; 2] = ["N m s/rad", "N s/m"];
/// N m/rad, or N/m.
pub const STIFFNESS: [&str; 2] = ["N m/rad", "N/m"];
/// rad/(N m), or m/N.
pub const COMPLIANCE: [&str; 2] = ["rad/(N m)", "m/N"];
/// rad, or m.
pub const ANGLE: [&str; 2] = ["rad", "m"];
/// rad/s, or m/s.
pub const VELOCITY: [&str; 2] = ["rad/s", "m/s"];
/// Hz.
pub const FREQUENCY: [&str; 2] = ["Hz", "Hz"];
/// V.
pub const VOLTAGE: [&str; 2] = ["V", "V"];
/// s.
pub const TIME: [&str; 2] = ["s", "s"];
