//! Contours in; descriptors, matches and poses out (sections 2.2.2 and 2.2.3 of the paper).
//!
//! A closed contour is resampled to [`N`] points at equal distances along it ([`resample`](contour::resample)), taken as
//! complex numbers and transformed ([`fft`](fft::fft)). [`describe`](descriptor::describe) divides position, size,
//! orientation and start point out of the spectrum; [`compare`](matching::compare) compares what is left with
//! references and gives the orientation that the comparison settles.
//!
//! # Conventions
//!
//! Points are (x, y) in pixels, y downwards, taken as `x + jy`; contours run clockwise on the screen, which is the
//! positive sense of rotation in these axes. Angles are in radians from +x towards +y.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod contour;
pub mod descriptor;
pub mod fft;
pub mod matching;

pub use num_complex::Complex32;

/// Samples of a contour, and coefficients of a spectrum; the paper's N (section 2.2.2).
pub const N: usize = 32;

/// An angle brought into (-π, π].
#[must_use]
pub fn wrapped(angle_rad: f32) -> f32 {
    use core::f32::consts::{PI, TAU};
    let angle = libm::remainderf(angle_rad, TAU);
    if angle <= -PI { angle + TAU } else { angle }
}
