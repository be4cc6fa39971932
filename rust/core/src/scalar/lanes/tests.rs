use super::*;
use crate::program::Width;
use proptest::prelude::*;

/// Every operation of a register, for the numbers of a lane.
fn operations<R: Real>(a: R, b: R, c: R) -> [R; 14] {
    let (sin, cos) = (a * 1e-2).sin_cos();
    [
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        a + 0.5,
        a.abs(),
        a.min(b),
        a.max(b),
        a.copysign(b),
        sin,
        cos,
        a.mul_add(b, c),
        (a * 1e-2).exp(),
    ]
}

/// Operations in lanes are those of `One` on the number of each lane, bit by bit.
fn check_operations<R: Real, One: Real>(numbers: &[[f64; MAX_LANES]; 3]) {
    let [a, b, c] = numbers.map(|of| R::load(&of));
    let actual = operations(a, b, c);
    for lane in 0..R::LANES {
        let [a, b, c] = numbers.map(|of| One::splat(of[lane]));
        for (k, expected) in operations(a, b, c).into_iter().enumerate() {
            let (actual, expected) = (actual[k].lane(lane), expected.lane(0));
            assert_eq!(
                actual.to_bits(),
                expected.to_bits(),
                "operation {k} of {numbers:?}"
            );
        }
    }
    let any_negative = numbers[0][..R::LANES].iter().any(|&number| number < 0.0);
    assert_eq!(a.any_negative(), any_negative);
}

fn check_lanes<R: Lanes>(numbers: &[f64; MAX_LANES], from: [Option<usize>; MAX_LANES]) {
    let four: [f64; 4] = std::array::from_fn(|k| 10.0 + k as f64);
    let actual = R::load(numbers).replace_selected(&R::selection(from), &four);
    let mut rows = [[0.0; 4]; MAX_LANES];
    let all = std::array::from_fn(|k| R::load(numbers) + four[k]);
    R::store_rows(&all, &mut rows);
    for lane in 0..R::LANES {
        assert_eq!(
            actual.lane(lane),
            from[lane].map_or(numbers[lane], |k| four[k])
        );
        assert_eq!(rows[lane], four.map(|of| numbers[lane] + of));
    }
}

fn check_moves<R: Packed>(numbers: &[f64; MAX_LANES]) {
    let pack = R::load(numbers);
    for two in [false, true] {
        let by = if two { 2 } else { 1 };
        let (up, down) = (pack.shift_up(two, 7.0), pack.shift_down(two));
        for lane in 0..R::LANES {
            let (below, above) = (lane.checked_sub(by), lane + by);
            assert_eq!(up.lane(lane), below.map_or(7.0, |k| numbers[k]));
            assert_eq!(
                down.lane(lane),
                if above < R::LANES {
                    numbers[above]
                } else {
                    0.0
                }
            );
            assert_eq!(pack.spread_end(false).lane(lane), numbers[0]);
            assert_eq!(pack.spread_end(true).lane(lane), numbers[R::LANES - 1]);
        }
    }
}

proptest! {
    #[test]
    fn lanes_compute_as_single_numbers(
        numbers in prop::array::uniform3(prop::array::uniform8(-9.0..9.0f64)),
        from in prop::array::uniform8(prop::option::of(0usize..4)),
        special in prop::sample::select(vec![0.0, -0.0, f64::NAN, f64::INFINITY, 1.0]),
    ) {
        let mut numbers = numbers;
        numbers[1][0] = special;
        // without the instruction, `f64` rounds twice as the baseline of x86-64 does
        #[cfg(target_arch = "x86_64")]
        check_operations::<F64x2, f64>(&numbers);
        if Width::COMPILED <= Width::detect() {
            check_operations::<Pack, Fused>(&numbers);
            check_lanes::<Pack>(&numbers[0], from);
            check_moves::<Pack>(&numbers[0]);
        }
        #[cfg(target_arch = "x86_64")]
        if Width::detect() == Width::Avx512 {
            check_operations::<F64x8, Fused>(&numbers);
            check_lanes::<F64x8>(&numbers[0], from);
        }
    }
}
