//! Vectors in the plane, which also serve as complex numbers.

pub(crate) fn add(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

pub(crate) fn sub(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn scale(a: [f64; 2], by: f64) -> [f64; 2] {
    [a[0] * by, a[1] * by]
}

pub(crate) fn norm_squared(a: [f64; 2]) -> f64 {
    a[0] * a[0] + a[1] * a[1]
}

pub(crate) fn norm(a: [f64; 2]) -> f64 {
    libm::sqrt(norm_squared(a))
}

/// Product of complex numbers. With a unit vector, a rotation.
pub(crate) fn complex_mul(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

pub(crate) fn conjugate(a: [f64; 2]) -> [f64; 2] {
    [a[0], -a[1]]
}

/// Unit vector along `a`, or +x if `a` has no direction.
pub(crate) fn direction(a: [f64; 2]) -> [f64; 2] {
    let length = norm(a);
    if length > 0.0 && length.is_finite() {
        scale(a, 1.0 / length)
    } else {
        [1.0, 0.0]
    }
}
