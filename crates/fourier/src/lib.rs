//! Contours in; descriptors, matches and poses out (sections 2.2.2 and 2.2.3 of the paper).
//!
//! A closed contour is resampled to [`N`] points with equal spacing
//! ([`resample`](contour::resample)), taken as complex numbers and transformed ([`fft`](fft::fft)).
//! [`describe`](descriptor::describe) normalises the spectrum for position, size, orientation and
//! start point. [`compare`](matching::compare) compares the result with references and
//! resolves the ambiguity of the orientation.
//!
//! # Conventions
//!
//! Points are (x, y) in pixels, y down, taken as `x + jy`. Contours run clockwise on the screen,
//! which is the positive sense of rotation in these axes. Angles are in radians from +x towards +y.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod affine;
pub mod contour;
pub mod descriptor;
pub mod fft;
pub mod matching;

pub use num_complex::Complex32;

/// Number of samples of a contour and of coefficients of a spectrum; the paper's N (section 2.2.2).
pub const N: usize = 32;

/// Wraps an angle into (-π, π].
#[must_use]
pub fn wrapped(angle_rad: f32) -> f32 {
    use core::f32::consts::{PI, TAU};
    let angle = libm::remainderf(angle_rad, TAU);
    if angle <= -PI { angle + TAU } else { angle }
}
