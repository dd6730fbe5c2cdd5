//! Normal equations of one round: sums over many pixels, and their solution.

/// Normal equations of one round with `N` unknowns.
pub(super) struct Normal<const N: usize> {
    /// Sums of products of two derivatives; upper triangle only.
    matrix: [[f64; N]; N],
    /// Sums of products of a derivative and the residual.
    right: [f64; N],
    /// Sum of squared residuals.
    pub(super) squares: f64,
    /// Sum of the weights.
    pub(super) n: f32,
    /// Samples inside the plate and at its rim.
    pub(super) parts: [Part; 2],
}

/// Samples of a part of the plate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Part {
    /// Sum of the weights without the doubt about samples with a large residual.
    all: f32,
    /// That of the samples that do not show the plate.
    hidden: f32,
}

impl Part {
    /// Share of the samples that do not show the plate.
    pub(super) fn hidden_share(&self) -> f32 {
        self.hidden / self.all.max(1.0)
    }
}

pub(super) struct Solution<const N: usize> {
    pub(super) step: [f64; N],
    /// Predicted reduction of the sum of squares, if everything is linear.
    pub(super) taken: f64,
    /// Covariance of the unknowns if every sample has a variance of 1.
    pub(super) inverse: [[f64; N]; N],
}

impl<const N: usize> Normal<N> {
    pub(super) fn new() -> Self {
        Self {
            matrix: [[0.0; N]; N],
            right: [0.0; N],
            squares: 0.0,
            n: 0.0,
            parts: [Part::default(); 2],
        }
    }

    /// Adds a weighted prior: the unknown is `off` from its expected value.
    pub(super) fn expect(&mut self, unknown: usize, off: f32, weight: f64) {
        self.matrix[unknown][unknown] += weight;
        self.right[unknown] -= weight * f64::from(off);
    }

    /// Adds a weighted prior: a combination of unknowns is `off` from its expected value.
    pub(super) fn expect_combination(&mut self, factors: &[f64; N], off: f32, weight: f64) {
        for i in 0..N {
            for k in i..N {
                self.matrix[i][k] += weight * factors[i] * factors[k];
            }
            self.right[i] -= weight * factors[i] * f64::from(off);
        }
    }

    /// `None` if some unknowns are not independent of the others.
    pub(super) fn solve(mut self) -> Option<Solution<N>> {
        for i in 0..N {
            for k in 0..i {
                self.matrix[i][k] = self.matrix[k][i];
            }
        }
        let inverse = inverse(&self.matrix)?;
        let sum = |a: &[f64; N], b: &[f64; N]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let step = core::array::from_fn(|i| sum(&inverse[i], &self.right));
        Some(Solution {
            step,
            taken: sum(&step, &self.right),
            inverse,
        })
    }
}

/// Pixels whose products are summed at once.
const BATCH: usize = 32;

/// Independent sums that run in parallel.
const LANES: usize = 4;

/// Contribution of some pixels to the normal equations, one row per unknown, so that the products
/// of many pixels are computed at once.
pub(super) struct Batch<const N: usize> {
    derivatives: [[f32; BATCH]; N],
    residual: [f32; BATCH],
    weight: [f32; BATCH],
    len: usize,
    /// One over the residual at which a sample counts a quarter.
    per_tolerance: f32,
}

impl<const N: usize> Batch<N> {
    /// Samples with a residual far beyond `tolerance` hardly count.
    pub(super) fn new(tolerance: f32) -> Self {
        Self {
            per_tolerance: 1.0 / tolerance,
            derivatives: [[0.0; BATCH]; N],
            residual: [0.0; BATCH],
            weight: [0.0; BATCH],
            len: 0,
        }
    }

    #[inline]
    pub(super) fn push(
        &mut self,
        weight: f32,
        is_rim: bool,
        derivatives: [f32; N],
        residual: f32,
        normal: &mut Normal<N>,
    ) {
        let i = self.len;
        for (row, derivative) in self.derivatives.iter_mut().zip(derivatives) {
            row[i] = derivative;
        }
        let beyond = residual * self.per_tolerance;
        let doubt = 1.0 + beyond * beyond;
        let part = &mut normal.parts[usize::from(is_rim)];
        part.all += weight;
        part.hidden += if beyond.abs() > 1.0 { weight } else { 0.0 };
        self.residual[i] = residual;
        self.weight[i] = weight / (doubt * doubt);
        self.len += 1;
        if self.len == BATCH {
            self.add_to(normal);
        }
    }

    /// Adds the rest of the batch to the sums and empties it.
    pub(super) fn add_to(&mut self, normal: &mut Normal<N>) {
        self.weight[self.len..].fill(0.0);
        self.len = 0;
        let weighted = |row: &[f32; BATCH]| -> [f32; BATCH] {
            core::array::from_fn(|i| row[i] * self.weight[i])
        };
        for i in 0..N {
            let row = weighted(&self.derivatives[i]);
            for k in i..N {
                normal.matrix[i][k] += f64::from(dot(&row, &self.derivatives[k]));
            }
            normal.right[i] += f64::from(dot(&row, &self.residual));
        }
        normal.squares += f64::from(dot(&weighted(&self.residual), &self.residual));
        normal.n += self.weight.iter().sum::<f32>();
    }
}

fn dot(a: &[f32; BATCH], b: &[f32; BATCH]) -> f32 {
    let mut lanes = [0.0f32; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])
}

/// Inverse of a symmetric positive-definite matrix by Cholesky decomposition. `None` if it is not
/// positive definite.
fn inverse<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut lower = [[0.0; N]; N];
    for i in 0..N {
        for k in 0..=i {
            let known: f64 = (0..k).map(|j| lower[i][j] * lower[k][j]).sum();
            let left = matrix[i][k] - known;
            if i == k {
                // An unknown that depends only on the others has no digits left.
                if left.is_nan() || left <= 1e-12 * matrix[i][i] {
                    return None;
                }
                lower[i][i] = libm::sqrt(left);
            } else {
                lower[i][k] = left / lower[k][k];
            }
        }
    }
    let mut out = [[0.0; N]; N];
    for column in 0..N {
        let mut x = [0.0; N];
        for i in 0..N {
            let known: f64 = (0..i).map(|j| lower[i][j] * x[j]).sum();
            x[i] = (f64::from(u8::from(i == column)) - known) / lower[i][i];
        }
        for i in (0..N).rev() {
            let known: f64 = (i + 1..N).map(|j| lower[j][i] * x[j]).sum();
            x[i] = (x[i] - known) / lower[i][i];
        }
        for (row, x) in out.iter_mut().zip(x) {
            row[column] = x;
        }
    }
    Some(out)
}
