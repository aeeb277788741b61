//! Elementary functions that compile to vector code, and sums in a fixed order.
//!
//! The standard library's `exp` and `tanh` are calls for one number at a time; a decision needs some 50,000 of them.

/// `a * b + c`.
#[inline(always)]
pub(crate) fn fma<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// `eˣ` to 2 units in the last place for `x` in -87..=88, constant beyond.
#[inline(always)]
pub(crate) fn exp<const FUSED: bool>(x: f32) -> f32 {
    // Adding it leaves no bits for a fraction, so that the sum is rounded to a whole number.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts; the first has so few bits that its product with a small whole number is exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -0.000_212_194_44;
    let x = x.clamp(-87.0, 88.0);
    let rounded = fma::<FUSED>(x, std::f32::consts::LOG2_E, ROUND);
    let n = rounded - ROUND;
    // x = n ln 2 + r with |r| <= ln 2 / 2, where eight terms of the series leave 5e-9.
    let r = fma::<FUSED>(n, -LN_2_LOW, fma::<FUSED>(n, -LN_2_HIGH, x));
    let mut series = 1.0 / 5040.0;
    for factor in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        series = fma::<FUSED>(series, r, factor);
    }
    // 2ⁿ: the whole number is in the low bits of `rounded`, and goes into the exponent.
    let power = rounded.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    series * f32::from_bits(power)
}

/// Logistic function.
#[inline(always)]
pub(crate) fn sigmoid<const FUSED: bool>(x: f32) -> f32 {
    1.0 / (1.0 + exp::<FUSED>(-x))
}

/// Hyperbolic tangent, to 1e-7 absolute.
#[inline(always)]
pub(crate) fn tanh<const FUSED: bool>(x: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp::<FUSED>(2.0 * x))
}

/// Scalar product of two slices of one length.
#[inline(always)]
pub(crate) fn dot<const FUSED: bool>(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<STRANDS>(), b.as_chunks::<STRANDS>());
    let mut sums = [0.0f32; STRANDS];
    for (a, b) in a.iter().zip(b) {
        for i in 0..STRANDS {
            sums[i] = fma::<FUSED>(a[i], b[i], sums[i]);
        }
    }
    for ((sum, &a), &b) in sums.iter_mut().zip(a_rest).zip(b_rest) {
        *sum = fma::<FUSED>(a, b, *sum);
    }
    fold(sums, |a, b| a + b)
}

/// Sum of some numbers.
#[inline(always)]
pub(crate) fn sum(values: &[f32]) -> f32 {
    reduce(values, 0.0, |a, b| a + b)
}

/// Largest of some numbers; minus infinity of none.
#[inline(always)]
pub(crate) fn largest(values: &[f32]) -> f32 {
    // A comparison, unlike `f32::max`, is one instruction.
    reduce(values, f32::NEG_INFINITY, |a, b| if b > a { b } else { a })
}

/// Partial results that are kept apart, since one that waits for the last would take four cycles for each number.
const STRANDS: usize = 8;

#[inline(always)]
fn reduce(values: &[f32], start: f32, join: impl Fn(f32, f32) -> f32) -> f32 {
    let (chunks, rest) = values.as_chunks::<STRANDS>();
    let mut strands = [start; STRANDS];
    for chunk in chunks {
        for i in 0..STRANDS {
            strands[i] = join(strands[i], chunk[i]);
        }
    }
    for (strand, &value) in strands.iter_mut().zip(rest) {
        *strand = join(*strand, value);
    }
    fold(strands, join)
}

#[inline(always)]
fn fold(strands: [f32; STRANDS], join: impl Fn(f32, f32) -> f32) -> f32 {
    let fours: [f32; 4] = std::array::from_fn(|i| join(strands[i], strands[i + 4]));
    join(join(fours[0], fours[2]), join(fours[1], fours[3]))
}

/// Numbers to weights that sum to 1.
#[inline(always)]
pub(crate) fn softmax<const FUSED: bool>(values: &mut [f32]) {
    let most = largest(values);
    for value in values.iter_mut() {
        *value = exp::<FUSED>(*value - most);
    }
    let scale = 1.0 / sum(values);
    for value in values {
        *value *= scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn off(own: f32, exact: f64) -> f64 {
        ((f64::from(own) - exact) / exact).abs()
    }

    proptest! {
        #[test]
        fn exponentials_are_exact_to_rounding(x in -87.0f32..88.0) {
            for own in [exp::<true>(x), exp::<false>(x)] {
                prop_assert!(off(own, f64::from(x).exp()) < 2.5e-7, "{x}: {own}");
            }
        }

        #[test]
        fn sigmoid_and_tanh_are_exact_to_rounding(x in -30.0f32..30.0) {
            let exact = 1.0 / (1.0 + (-f64::from(x)).exp());
            prop_assert!((f64::from(sigmoid::<false>(x)) - exact).abs() < 2e-7);
            prop_assert!((f64::from(tanh::<false>(x)) - f64::from(x).tanh()).abs() < 3e-7);
        }

        #[test]
        fn reductions_take_every_entry(values in prop::collection::vec((-4i8..5, -4i8..5), 0..40)) {
            let (a, b): (Vec<f32>, Vec<f32>) = values.iter().map(|&(a, b)| (f32::from(a), f32::from(b))).unzip();
            let exact: i32 = values.iter().map(|&(a, b)| i32::from(a) * i32::from(b)).sum();
            prop_assert_eq!(dot::<false>(&a, &b), exact as f32);
            prop_assert_eq!(dot::<true>(&a, &b), exact as f32);
            prop_assert_eq!(sum(&a), values.iter().map(|v| i32::from(v.0)).sum::<i32>() as f32);
            let most = values.iter().map(|v| f32::from(v.0)).fold(f32::NEG_INFINITY, f32::max);
            prop_assert_eq!(largest(&a), most);
        }
    }

    #[test]
    fn far_out_nothing_overflows() {
        assert!(exp::<false>(f32::NEG_INFINITY) < 2e-38);
        assert!(exp::<false>(1e9).is_finite());
        assert_eq!(sigmoid::<false>(1e9), 1.0);
        assert!(sigmoid::<false>(-1e9) < 1e-37);
        assert_eq!((tanh::<false>(1e9), tanh::<false>(-1e9)), (1.0, -1.0));
    }

    #[test]
    fn softmax_shifts_nothing_away_and_ignores_minus_infinity() {
        let mut values = [1000.0, 1000.0, f32::NEG_INFINITY];
        softmax::<false>(&mut values);
        assert!(values[..2].iter().all(|v| (v - 0.5).abs() < 1e-6) && values[2] < 1e-37, "{values:?}");
    }
}
