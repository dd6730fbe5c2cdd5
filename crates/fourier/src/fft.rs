//! Fast Fourier transform of fixed length [`N`] = 32.
//!
//! Decimation in time with radix 2 (Cooley and Tukey 1965): the samples are put into bit-reversed
//! order, then five rounds of butterflies double the length of the finished transforms from 1 to
//! 32. All lengths and factors are known at compile time; nothing is allocated or planned.
//!
//! Neither direction scales: a transform and its inverse multiply by [`N`]. Index `k` of the
//! spectrum is frequency `k` up to `N / 2` and `k - N` above.
//!
//! Cost: 80 butterflies.

use crate::{Complex32, N};

/// Rounds of butterflies: the binary logarithm of [`N`].
const ROUNDS: u32 = N.trailing_zeros();

/// cos(2πk / 32) for a quarter circle.
const COSINES: [f32; N / 4 + 1] = [
    1.0,
    0.980_785_3,
    0.923_879_5,
    0.831_469_6,
    core::f32::consts::FRAC_1_SQRT_2,
    0.555_570_24,
    0.382_683_43,
    0.195_090_32,
    0.0,
];

/// exp(-2πjk / 32) for a half circle.
const FACTORS: [Complex32; N / 2] = {
    let mut factors = [Complex32::new(0.0, 0.0); N / 2];
    let mut k = 0;
    while k < N / 2 {
        factors[k] = if k <= N / 4 {
            Complex32::new(COSINES[k], -COSINES[N / 4 - k])
        } else {
            Complex32::new(-COSINES[N / 2 - k], -COSINES[k - N / 4])
        };
        k += 1;
    }
    factors
};

/// Replaces samples by their spectrum: `F[k] = sum of c[n] exp(-2πjkn / N)`.
pub fn fft(samples: &mut [Complex32; N]) {
    for i in 0..N {
        let reversed = i.reverse_bits() >> (usize::BITS - ROUNDS);
        if i < reversed {
            samples.swap(i, reversed);
        }
    }
    let mut half = 1;
    while half < N {
        for pair in samples.chunks_exact_mut(2 * half) {
            let (even, odd) = pair.split_at_mut(half);
            for (k, (even, odd)) in even.iter_mut().zip(odd).enumerate() {
                let turned = *odd * FACTORS[k * (N / 2 / half)];
                *odd = *even - turned;
                *even += turned;
            }
        }
        half *= 2;
    }
}

/// Replaces a spectrum by [`N`] times its samples: `c[n] = sum of F[k] exp(2πjkn / N)`.
pub fn inverse_fft(spectrum: &mut [Complex32; N]) {
    // Conjugating before and after reverses the sign of all exponents.
    spectrum.iter_mut().for_each(|f| *f = f.conj());
    fft(spectrum);
    spectrum.iter_mut().for_each(|f| *f = f.conj());
}

/// Frequency of index `k` of the spectrum: negative from `N / 2 + 1` on.
#[must_use]
pub const fn frequency(k: usize) -> i32 {
    if k <= N / 2 {
        k as i32
    } else {
        k as i32 - N as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rounding error of five rounds in single precision, for samples of magnitude 1.
    const TOLERANCE: f32 = 1e-5;

    fn samples() -> impl Strategy<Value = [Complex32; N]> {
        proptest::array::uniform32(
            (-1f32..1.0, -1f32..1.0).prop_map(|(re, im)| Complex32::new(re, im)),
        )
    }

    #[test]
    fn a_turning_pointer_is_one_line() {
        for frequency in [1, 5, N - 1] {
            let mut samples = core::array::from_fn(|n| {
                let angle = core::f32::consts::TAU * (frequency * n % N) as f32 / N as f32;
                Complex32::new(libm::cosf(angle), libm::sinf(angle))
            });
            fft(&mut samples);
            for (k, f) in samples.iter().enumerate() {
                let expected = if k == frequency { N as f32 } else { 0.0 };
                assert!(
                    (f - Complex32::new(expected, 0.0)).norm() < N as f32 * TOLERANCE,
                    "F[{k}] = {f}"
                );
            }
        }
    }

    proptest! {
        #[test]
        fn equals_rustfft(samples in samples()) {
            let mut ours = samples;
            fft(&mut ours);
            let mut theirs = samples;
            rustfft::FftPlanner::new().plan_fft_forward(N).process(&mut theirs);
            for (a, b) in ours.iter().zip(&theirs) {
                prop_assert!((a - b).norm() < N as f32 * TOLERANCE);
            }
        }

        #[test]
        fn transform_and_inverse_multiply_by_n(samples in samples()) {
            let mut there_and_back = samples;
            fft(&mut there_and_back);
            inverse_fft(&mut there_and_back);
            for (a, b) in there_and_back.iter().zip(&samples) {
                prop_assert!((a / N as f32 - b).norm() < TOLERANCE);
            }
        }
    }
}
