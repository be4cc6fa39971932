//! Tests of the parent module.

use super::*;

#[test]
fn first_order_has_its_analytic_ramp_response() {
    let (hz, h) = (5.0, 1e-3);
    let lag = 1.0 / (std::f64::consts::TAU * hz);
    let mut filter = LowPass::first_order(hz, h, 0.0);
    for k in 1..=200 {
        let t = f64::from(k) * h;
        filter.update(t);
        let exact = t - lag * (1.0 - (-t / lag).exp());
        assert!((filter.output() - exact).abs() < 1e-14);
    }
}

#[test]
fn butterworth_has_its_analytic_step_response() {
    let (hz, h) = (300.0, 1.25e-4);
    let w = std::f64::consts::TAU * hz / std::f64::consts::SQRT_2;
    let mut filter = LowPass::butterworth(hz, h, 0.0);
    filter.input = 1.0; // a step at t = 0
    for k in 1..=100 {
        filter.update(1.0);
        let phase = w * f64::from(k) * h;
        let exact = 1.0 - (-phase).exp() * (phase.cos() + phase.sin());
        assert!((filter.output() - exact).abs() < 1e-12);
    }
}

#[test]
fn feedthrough_form_is_equivalent() {
    let mut filter = LowPass::butterworth(300.0, 1.25e-4, 0.7);
    let other: Feedthrough<f64, 2> = filter.feedthrough();
    let mut state = other.at_rest(0.7);
    for k in 0..100 {
        let reading = f64::from(k * k % 17) - 8.0;
        filter.update(reading);
        let output = other.update(&mut state, reading);
        assert!((output - filter.output()).abs() < 1e-13);
    }
}

#[test]
fn stays_at_rest() {
    let mut filter = LowPass::butterworth(300.0, 1.25e-4, 9.81);
    filter.update(9.81);
    assert!((filter.output() - 9.81).abs() < 1e-14);
}
