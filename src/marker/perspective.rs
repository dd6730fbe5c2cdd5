//! How the camera stretches plates, depending on where they are in the picture: the effect of its
//! tilt and of its lens, estimated from the recognised markers.
//!
//! A pixel at `q` from the middle of the picture, in widths of the picture, shows the point
//!
//! ```text
//! floor = root(1 + focal² m mᵀ) q / (1 + bend |q|² - m · q)
//! ```
//!
//! of the floor, apart from its scale and direction: `focal · m` is the slope of the floor relative
//! to the picture, `bend` the radial distortion of the lens in the division model (Fitzgibbon
//! 2001). The derivative of this map gives the stretch of a plate ([`CurvedFit::stretch`]), the
//! second derivative how it changes across the plate.
//!
//! Every reading is a measurement of the stretch at its place. They are collected in the cells of a
//! grid, older ones with less weight, and the four unknowns are fitted to the cells by least
//! squares (Levenberg-Marquardt).
//!
//! [`CurvedFit::stretch`]: imgproc::fit::CurvedFit::stretch

use imgproc::Size;
use imgproc::fit::StretchPrior;
use nalgebra::{Matrix2, Matrix4, SVector, Vector2, Vector4};

/// Cells of the grid in a row and in a column.
const COLUMNS: usize = 8;
const ROWS: usize = 6;

/// Standard deviation of the angle between a plate and the floor, radians, and what the stretch of
/// printed plates varies by.
const LEVEL_RAD: f64 = 0.0175;
const PRINTED: f64 = 0.0003;

/// Tolerance for robots on ramps and bent plates, when it is decided whether a stretch is possible.
const TOLERANCE: f32 = 0.01;

/// The readings of a cell do not determine its stretch better than this, because they are mostly of
/// one plate: standard deviation.
const CELL_MIN: f64 = 0.001;

/// Share of the weight of a reading that is left a frame later.
const KEPT: f64 = 0.998;

/// Unknowns before any marker was read, and their standard deviations: the slope of the floor over
/// the focal length, in x and y; the distortion; the logarithm of the focal length in widths of the
/// picture.
const START: Vector4<f64> = Vector4::new(0.0, 0.0, 0.0, 0.0);
const SIGMA: Vector4<f64> = Vector4::new(0.45, 0.45, 0.15, 0.3);

/// Slopes of the floor from which the fit starts besides the present one: at a slope of zero, the
/// picture's middle does not show in which direction the camera is tilted.
const STARTS: [[f64; 2]; 5] = [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]];

/// The fit starts from all of them in the first frames with readings, then every so many frames.
const FIRST_FRAMES: u32 = 30;
const EVERY_FRAMES: u32 = 64;

/// Number of votes that are kept, and the number that must agree before a camera of unknown
/// perspective has one. Four unknowns that fit five votes by chance fit six numbers by chance.
const VOTES: usize = 16;
const VOTES_MIN: usize = 5;

/// Votes that do not agree may be this share of all, one in so many.
const STRAY_VOTES: usize = 4;

/// A vote agrees with a perspective within this many standard deviations of both, one of them being
/// what a coarse model may be off.
const VOTE_DEVIATIONS: f64 = 3.0;
const VOTE_SIGMA: f64 = 0.005;

/// Two votes of a marker are independent if its heading differs by this much: a wrong shape turns
/// with its stretch, a plate does not.
const VOTE_TURN_RAD: f32 = 0.5;

/// Rounds of a fit.
const ROUNDS: usize = 8;

/// Standard deviation of the curvature besides that of the unknowns, relative to a plate as wide as
/// the picture.
const CURVATURE: f64 = 0.01;

/// The perspective is known with this standard deviation of the stretch.
const KNOWN: f32 = 0.03;

/// Up to this stretch, the contour of a marker is near enough to that of an upright plate.
const STRETCHED: f32 = 0.02;

/// What is expected of a plate at one place of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExpectedStretch {
    stretch: [f32; 2],
    sigma: f32,
    curvature: [[f32; 3]; 2],
    /// Standard deviation of the curvature, per pixel of the plate's side.
    curvature_sigma: f32,
}

impl ExpectedStretch {
    /// In the middle of a picture of 640 pixels, of a camera that is not known yet.
    pub(crate) fn unknown() -> Self {
        let size = Size {
            width: 640,
            height: 480,
        };
        Perspective::new(size).at([320.0, 240.0])
    }

    /// The prior of a fit.
    pub(crate) fn prior(&self, blur_px: f32, plate_px: f32) -> StretchPrior {
        StretchPrior {
            blur_px,
            stretch: self.stretch,
            sigma: self.sigma,
            curvature: self.curvature,
            curvature_sigma: self.curvature_sigma * plate_px,
        }
    }

    /// What a fit that started from this prior adds to it: a measurement of the stretch, and its
    /// variance. `None` if it adds nothing.
    pub(crate) fn reading(&self, stretch: [f32; 2], variance: [f32; 2]) -> Option<StretchReading> {
        let prior = f64::from(self.sigma * self.sigma);
        let variance = f64::from(variance[0].max(variance[1]));
        let information = 1.0 / variance - 1.0 / prior;
        if information.is_nan() || information <= 0.1 / prior {
            return None;
        }
        let measured = [0, 1].map(|i| {
            let (now, before) = (f64::from(stretch[i]), f64::from(self.stretch[i]));
            (now / variance - before / prior) / information
        });
        Some(StretchReading {
            stretch: measured,
            variance: 1.0 / information,
        })
    }

    /// Square of the deviation of a stretch that was measured with this variance, in standard
    /// deviations of both.
    pub(crate) fn deviation2(&self, stretch: [f32; 2], variance: f32) -> f32 {
        let off = [0, 1].map(|i| stretch[i] - self.stretch[i]);
        let tolerated = TOLERANCE * TOLERANCE;
        (off[0] * off[0] + off[1] * off[1]) / (self.sigma * self.sigma + variance + tolerated)
    }

    /// How plates are seen here.
    pub(crate) fn seen(&self) -> Seen {
        let [s, t] = self.stretch;
        if self.sigma > KNOWN {
            Seen::Unknown
        } else if s.hypot(t) > STRETCHED {
            Seen::AtAnAngle
        } else {
            Seen::FromAbove
        }
    }
}

/// How a camera sees plates at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Seen {
    /// As squares, or nearly.
    FromAbove,
    AtAnAngle,
    /// Its perspective is not known yet.
    Unknown,
}

/// A measurement of the stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StretchReading {
    stretch: [f64; 2],
    variance: f64,
}

impl StretchReading {
    pub(crate) fn stretch(&self) -> [f32; 2] {
        self.stretch.map(|s| s as f32)
    }

    /// Variance of each of the two numbers.
    pub(crate) fn variance(&self) -> f32 {
        self.variance as f32
    }
}

/// A marker that may have been seen at an angle by a camera of unknown perspective. It is no
/// reading; enough of them that agree are a perspective.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vote {
    pub(crate) pixel: [f64; 2],
    /// Index in the family.
    pub(crate) marker: usize,
    pub(crate) heading_rad: f32,
    pub(crate) reading: StretchReading,
}

impl Vote {
    /// Whether it says nothing that another vote does not say.
    fn repeats(&self, other: &Self) -> bool {
        let turn = fourier::wrapped(self.heading_rad - other.heading_rad).abs();
        self.marker == other.marker && turn < VOTE_TURN_RAD
    }
}

/// Estimate for a camera.
#[derive(Debug, Clone)]
pub(crate) struct Perspective {
    size: Size,
    votes: [Option<Vote>; VOTES],
    next_vote: usize,
    cells: [Cell; COLUMNS * ROWS],
    /// Slope of the floor over the focal length, distortion, logarithm of the focal length.
    unknowns: Vector4<f64>,
    covariance: Matrix4<f64>,
    /// Mean square of what the model leaves of the cells.
    misfit: f64,
    frames: u32,
}

/// Readings in one part of the picture.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    /// Sums, each weighted by the information of the reading.
    information: f64,
    place: [f64; 2],
    stretch: [f64; 2],
}

impl Perspective {
    pub(crate) fn new(size: Size) -> Self {
        Self {
            size,
            votes: [None; VOTES],
            next_vote: 0,
            cells: [Cell::default(); COLUMNS * ROWS],
            unknowns: START,
            covariance: Matrix4::from_diagonal(&SIGMA.component_mul(&SIGMA)),
            misfit: 0.0,
            frames: 0,
        }
    }

    /// What is expected of a plate at a pixel.
    pub(crate) fn at(&self, pixel: [f64; 2]) -> ExpectedStretch {
        let at = self.relative_to_middle(pixel);
        let (stretch, slopes) = stretch_and_slopes(&self.unknowns, at);
        // Of the two numbers, the less certain one.
        let variance = slopes
            .map(|slope| slope.dot(&(self.covariance * slope)))
            .into_iter()
            .fold(0.0, f64::max);
        // In the middle of the picture, the stretch of a camera with little tilt depends on the
        // square of the slope only.
        let focal = self.unknowns[3].exp();
        let slope_variance = self.covariance[(0, 0)] + self.covariance[(1, 1)];
        let of_square = focal * focal * slope_variance / 4.0;
        let between = between_plates(stretch);
        let sigma = (variance + of_square * of_square + self.misfit + between * between).sqrt();
        let width = self.size.width as f64;
        // The curvature is the slope over the focal length in the middle of the picture, and
        // changes by up to six times the distortion for every width from there.
        let from_middle2 = at[0] * at[0] + at[1] * at[1];
        let curvature_variance =
            slope_variance / 2.0 + 36.0 * from_middle2 * self.covariance[(2, 2)];
        let curvature_sigma = (curvature_variance + CURVATURE * CURVATURE).sqrt() / width;
        ExpectedStretch {
            stretch: stretch.map(|s| s as f32),
            sigma: sigma as f32,
            curvature: curvature(&self.unknowns, at).map(|row| row.map(|c| (c / width) as f32)),
            curvature_sigma: curvature_sigma as f32,
        }
    }

    /// Updates the estimate from the readings of a frame, each with its place.
    pub(crate) fn learn(&mut self, readings: impl Iterator<Item = ([f64; 2], StretchReading)>) {
        for cell in &mut self.cells {
            cell.keep(KEPT);
        }
        let mut any = false;
        for (pixel, reading) in readings {
            self.add(pixel, reading);
            any = true;
        }
        if any {
            self.fit();
        }
    }

    /// Adopts a perspective if enough votes agree on it.
    pub(crate) fn vote(&mut self, votes: impl Iterator<Item = Vote>) {
        let mut any = false;
        for vote in votes {
            let repeated = |kept: &Option<Vote>| kept.is_some_and(|kept| vote.repeats(&kept));
            let place = self.votes.iter().position(repeated).unwrap_or_else(|| {
                self.next_vote = (self.next_vote + 1) % VOTES;
                self.next_vote
            });
            self.votes[place] = Some(vote);
            any = true;
        }
        let mut kept = self.votes;
        let count = |votes: &[Option<Vote>; VOTES]| votes.iter().flatten().count();
        let n = count(&kept);
        if !any || n < VOTES_MIN {
            return;
        }
        for _ in 0..=n / STRAY_VOTES {
            let mut trial = Self::new(self.size);
            for vote in kept.iter().flatten() {
                trial.add(vote.pixel, vote.reading);
            }
            trial.fit();
            let deviation = |vote: &Option<Vote>| vote.map_or(0.0, |vote| trial.deviation(&vote));
            let deviations = kept.each_ref().map(deviation);
            let worst = (0..VOTES).max_by(|&a, &b| deviations[a].total_cmp(&deviations[b]));
            let Some(worst) = worst.filter(|&worst| deviations[worst] > VOTE_DEVIATIONS) else {
                *self = trial;
                return;
            };
            kept[worst] = None;
            if count(&kept) < VOTES_MIN {
                return;
            }
        }
    }

    /// How far a vote is from this perspective, in standard deviations of both.
    fn deviation(&self, vote: &Vote) -> f64 {
        let StretchReading { stretch, variance } = vote.reading;
        let (expected, _) = stretch_and_slopes(&self.unknowns, self.relative_to_middle(vote.pixel));
        let off = [0, 1].map(|i: usize| stretch[i] - expected[i]);
        let between = between_plates(expected);
        let variance = variance + between * between + VOTE_SIGMA * VOTE_SIGMA;
        off[0].hypot(off[1]) / variance.sqrt()
    }

    fn add(&mut self, pixel: [f64; 2], StretchReading { stretch, variance }: StretchReading) {
        let [x, y] = pixel;
        let column = (x * COLUMNS as f64 / self.size.width as f64) as usize;
        let row = (y * ROWS as f64 / self.size.height as f64) as usize;
        let place = self.relative_to_middle(pixel);
        let cell = &mut self.cells[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)];
        let between = between_plates(stretch);
        cell.add(place, stretch, 1.0 / (variance + between * between));
    }

    fn relative_to_middle(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let Size { width, height } = self.size;
        let width = width as f64;
        [x / width - 0.5, (y - height as f64 / 2.0) / width]
    }

    fn fit(&mut self) {
        let mut best = self.descend(self.unknowns);
        if self.frames < FIRST_FRAMES || self.frames.is_multiple_of(EVERY_FRAMES) {
            for [x, y] in STARTS {
                let from = Vector4::new(x, y, START[2], START[3]);
                let other = self.descend(from);
                if other.squares < best.squares {
                    best = other;
                }
            }
        }
        self.frames = self.frames.saturating_add(1);
        self.unknowns = best.unknowns;
        self.covariance = best.covariance;
        self.misfit = best.misfit;
    }

    /// Levenberg-Marquardt from a start.
    fn descend(&self, from: Vector4<f64>) -> Estimate {
        let mut unknowns = from;
        let mut equations = self.equations(&unknowns);
        let mut damping = 1e-3;
        for _ in 0..ROUNDS {
            let mut matrix = equations.matrix;
            for i in 0..4 {
                matrix[(i, i)] *= 1.0 + damping;
            }
            let Some(inverse) = matrix.try_inverse() else {
                break;
            };
            let next = unknowns + inverse * equations.right;
            let tried = self.equations(&next);
            if tried.squares < equations.squares {
                let is_last = equations.squares - tried.squares < 1e-3;
                (unknowns, equations) = (next, tried);
                damping *= 0.1;
                if is_last {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        Estimate {
            unknowns,
            covariance: equations.matrix.try_inverse().unwrap_or(self.covariance),
            squares: equations.squares,
            misfit: equations.misfit,
        }
    }

    /// Sums over all cells and the prior. Infinite squares for a floor that the picture could not
    /// show.
    fn equations(&self, unknowns: &Vector4<f64>) -> Equations {
        let mut equations = Equations {
            matrix: Matrix4::zeros(),
            right: Vector4::zeros(),
            squares: 0.0,
            misfit: 0.0,
        };
        for i in 0..4 {
            let weight = 1.0 / (SIGMA[i] * SIGMA[i]);
            let off = START[i] - unknowns[i];
            equations.matrix[(i, i)] += weight;
            equations.right[i] += weight * off;
            equations.squares += weight * off * off;
        }
        let corner = [0.5, 0.5 * self.size.height as f64 / self.size.width as f64];
        let all = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
        if all
            .iter()
            .any(|[x, y]| denominator(unknowns, [x * corner[0], y * corner[1]]) < 0.1)
        {
            equations.squares = f64::INFINITY;
            return equations;
        }
        let (mut total, mut left) = (0.0, 0.0);
        for cell in self.cells.iter().filter(|cell| cell.information > 0.0) {
            let mean = |sum: f64| sum / cell.information;
            let weight = cell.information.min(1.0 / (CELL_MIN * CELL_MIN));
            let (stretch, slopes) = stretch_and_slopes(unknowns, cell.place.map(mean));
            for i in 0..2 {
                let off = mean(cell.stretch[i]) - stretch[i];
                equations.matrix += weight * slopes[i] * slopes[i].transpose();
                equations.right += weight * off * slopes[i];
                equations.squares += weight * off * off;
                // What the uncertainty of the cell does not account for.
                left += weight * (off * off - 1.0 / weight).max(0.0);
                total += weight;
            }
        }
        if total > 0.0 {
            equations.misfit = left / total;
        }
        equations
    }
}

impl Cell {
    fn keep(&mut self, share: f64) {
        self.information *= share;
        self.place = self.place.map(|sum| sum * share);
        self.stretch = self.stretch.map(|sum| sum * share);
    }

    fn add(&mut self, place: [f64; 2], stretch: [f64; 2], information: f64) {
        self.information += information;
        for i in 0..2 {
            self.place[i] += information * place[i];
            self.stretch[i] += information * stretch[i];
        }
    }
}

/// Result of a fit.
struct Estimate {
    unknowns: Vector4<f64>,
    covariance: Matrix4<f64>,
    squares: f64,
    misfit: f64,
}

/// Normal equations of a round.
struct Equations {
    matrix: Matrix4<f64>,
    right: Vector4<f64>,
    squares: f64,
    misfit: f64,
}

/// Standard deviation of the stretch between plates in one place. The stretch is a quarter of the
/// squared angle of view, so that it varies with the root of it.
fn between_plates([s, t]: [f64; 2]) -> f64 {
    PRINTED + LEVEL_RAD * s.hypot(t).sqrt()
}

/// `1 + bend |q|² - m · q`; proportional to the inverse of the distance from the camera.
fn denominator(unknowns: &Vector4<f64>, [x, y]: [f64; 2]) -> f64 {
    1.0 + unknowns[2] * (x * x + y * y) - unknowns[0] * x - unknowns[1] * y
}

/// Derivatives of the denominator.
fn slope_of_denominator(unknowns: &Vector4<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    [
        2.0 * unknowns[2] * x - unknowns[0],
        2.0 * unknowns[2] * y - unknowns[1],
    ]
}

/// Derivatives of `q / denominator`.
fn jacobian(unknowns: &Vector4<f64>, at: [f64; 2]) -> Matrix2<f64> {
    let d = denominator(unknowns, at);
    let slope = slope_of_denominator(unknowns, at);
    Matrix2::from_fn(|i, k| {
        let diagonal = if i == k { 1.0 / d } else { 0.0 };
        diagonal - at[i] * slope[k] / (d * d)
    })
}

/// The two numbers of the stretch at a place, in widths of the picture from its middle.
fn stretch(unknowns: &Vector4<f64>, at: [f64; 2]) -> [f64; 2] {
    let jacobian = jacobian(unknowns, at);
    let slope = unknowns[3].exp() * Vector2::new(unknowns[0], unknowns[1]);
    let metric = Matrix2::identity() + slope * slope.transpose();
    // Of the floor, seen from the picture; the picture's is its inverse.
    let on_floor = jacobian.transpose() * metric * jacobian;
    let root = on_floor.determinant().max(1e-12).sqrt();
    let (xx, xy, yy) = (
        on_floor[(1, 1)] / root,
        -on_floor[(0, 1)] / root,
        on_floor[(0, 0)] / root,
    );
    // The logarithm of a symmetric matrix of determinant 1, halved.
    let cosh = ((xx + yy) / 2.0).max(1.0);
    let sinh = (cosh * cosh - 1.0).sqrt();
    let ratio = if sinh > 1e-6 {
        (cosh + sinh).ln() / sinh
    } else {
        1.0
    };
    [(xx - yy) / 4.0 * ratio, xy / 2.0 * ratio]
}

/// The stretch, and its derivatives with respect to the unknowns.
fn stretch_and_slopes(unknowns: &Vector4<f64>, at: [f64; 2]) -> ([f64; 2], [Vector4<f64>; 2]) {
    const STEP: f64 = 1e-4;
    let mut slopes = [SVector::zeros(); 2];
    for i in 0..4 {
        let moved = |step: f64| {
            let mut unknowns = *unknowns;
            unknowns[i] += step;
            stretch(&unknowns, at)
        };
        let (before, after) = (moved(-STEP), moved(STEP));
        for (slope, (before, after)) in slopes.iter_mut().zip(before.into_iter().zip(after)) {
            slope[i] = (after - before) / (2.0 * STEP);
        }
    }
    (stretch(unknowns, at), slopes)
}

/// Terms of second degree of the map at a place, as movements in the picture: factors of x², xy and
/// y² for x and y. Lengths in widths of the picture.
fn curvature(unknowns: &Vector4<f64>, at: [f64; 2]) -> [[f64; 3]; 2] {
    let d = denominator(unknowns, at);
    let slope = slope_of_denominator(unknowns, at);
    let second = |i: usize, j: usize, k: usize| {
        let is = |a: usize, b: usize| f64::from(u8::from(a == b));
        let bend = 2.0 * unknowns[2] * is(j, k);
        -(is(i, j) * slope[k] + is(i, k) * slope[j] + at[i] * bend) / (d * d)
            + 2.0 * at[i] * slope[j] * slope[k] / (d * d * d)
    };
    let terms = [(0, 0, 0.5), (0, 1, 1.0), (1, 1, 0.5)];
    let columns = terms.map(|(j, k, share)| share * Vector2::new(second(0, j, k), second(1, j, k)));
    let inverse = jacobian(unknowns, at).try_inverse();
    let inverse = inverse.unwrap_or_else(Matrix2::identity);
    let [xx, xy, yy] = columns.map(|column| inverse * column);
    [0, 1].map(|i: usize| [xx[i], xy[i], yy[i]])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        width: 640,
        height: 480,
    };

    /// What a plate shows whose stretch is this, measured with a standard deviation of 0.02.
    fn shown(perspective: &Perspective, pixel: [f64; 2], stretch: [f64; 2]) -> StretchReading {
        let expected = perspective.at(pixel);
        let (own, prior) = (1.0 / 0.0004, 1.0 / f64::from(expected.sigma).powi(2));
        let mean = [0, 1].map(|i: usize| {
            ((own * stretch[i] + prior * f64::from(expected.stretch[i])) / (own + prior)) as f32
        });
        let variance = (1.0 / (own + prior)) as f32;
        let reading = expected.reading(mean, [variance; 2]);
        reading.unwrap_or(StretchReading {
            stretch,
            variance: 1.0,
        })
    }

    #[test]
    fn a_reading_is_what_the_fit_adds_to_its_prior() {
        let perspective = Perspective::new(SIZE);
        let reading = shown(&perspective, [100.0, 50.0], [0.1, -0.05]);
        assert!((reading.variance - 0.0004).abs() < 1e-6);
        assert!(
            (reading.stretch[0] - 0.1).abs() < 1e-4 && (reading.stretch[1] + 0.05).abs() < 1e-4
        );
        let expected = perspective.at([100.0, 50.0]);
        assert_eq!(
            expected.reading([0.0; 2], [expected.sigma.powi(2); 2]),
            None
        );
    }

    #[test]
    fn the_slopes_of_the_map_are_those_of_the_floor() {
        let unknowns = Vector4::new(0.4, -0.3, -0.2, 0.1);
        let floor = |[x, y]: [f64; 2]| [x, y].map(|c| c / denominator(&unknowns, [x, y]));
        let at = [0.3, -0.2];
        const STEP: f64 = 1e-3;
        let moved = |x: f64, y: f64| floor([at[0] + x * STEP, at[1] + y * STEP]);
        let jacobian = jacobian(&unknowns, at);
        let inverse = jacobian.try_inverse().expect("it is regular");
        for i in 0..2 {
            let slope = (moved(1.0, 0.0)[i] - moved(-1.0, 0.0)[i]) / (2.0 * STEP);
            assert!((slope - jacobian[(i, 0)]).abs() < 1e-4);
        }
        let of_second_degree = |direction: [f64; 2]| {
            let [x, y] = direction;
            let (before, after, here) = (moved(-x, -y), moved(x, y), floor(at));
            let bend = [0, 1].map(|i: usize| before[i] + after[i] - 2.0 * here[i]);
            inverse * Vector2::from(bend) / (2.0 * STEP * STEP)
        };
        let found = curvature(&unknowns, at);
        let (along_x, along_y) = (of_second_degree([1.0, 0.0]), of_second_degree([0.0, 1.0]));
        let both = of_second_degree([1.0, 1.0]);
        for (i, [xx, xy, yy]) in found.into_iter().enumerate() {
            assert!((xx - along_x[i]).abs() < 1e-3 && (yy - along_y[i]).abs() < 1e-3);
            assert!((xx + xy + yy - both[i]).abs() < 1e-3);
        }
    }

    /// A camera that is tilted by 30 degrees: its axis, and what is half as far off it.
    #[test]
    fn the_stretch_of_a_tilted_camera() {
        let slope = 30f64.to_radians().tan();
        let unknowns = Vector4::new(0.0, slope, 0.0, 0.0);
        let [s, t] = stretch(&unknowns, [0.0, 0.0]);
        assert!((s + 30f64.to_radians().cos().ln() / 2.0).abs() < 1e-9 && t.abs() < 1e-9);
        assert!(stretch(&unknowns, [0.0, 0.3])[0] > s);
        assert!(stretch(&unknowns, [0.0, -0.3])[0] < s);
    }

    #[test]
    fn a_tilted_camera_with_a_wide_lens_is_learned() {
        let truth = Vector4::new(0.3, -0.5, -0.25, 0.15);
        let mut perspective = Perspective::new(SIZE);
        let of = |perspective: &Perspective, pixel: [f64; 2]| {
            stretch(&truth, perspective.relative_to_middle(pixel))
        };
        assert!(perspective.at([600.0, 400.0]).sigma > 0.1);
        for frame in 0..20 {
            let place = |i: i32| {
                let x = f64::from(frame * 31 % 90 + i % 4 * 170);
                [x, f64::from(i / 4 * 380 + frame)]
            };
            let readings: Vec<_> = (0..8)
                .map(place)
                .map(|place| (place, shown(&perspective, place, of(&perspective, place))))
                .collect();
            perspective.learn(readings.into_iter());
        }
        for place in [[320.0, 240.0], [600.0, 400.0], [30.0, 60.0]] {
            let expected = perspective.at(place);
            assert!(expected.sigma < 0.02, "{place:?}: {expected:?}");
            for (found, truth) in expected.stretch.into_iter().zip(of(&perspective, place)) {
                assert!(
                    (f64::from(found) - truth).abs() < 0.02,
                    "{place:?}: {expected:?}, not {truth:?}"
                );
            }
        }
        assert_eq!(perspective.at([320.0, 240.0]).seen(), Seen::AtAnAngle);
        assert_eq!(ExpectedStretch::unknown().seen(), Seen::Unknown);
    }

    fn votes_of(stretch_at: impl Fn(usize, [f64; 2]) -> [f64; 2], n: usize) -> Vec<Vote> {
        let vote = |i: usize| {
            let pixel = [(97 * i % 600) as f64 + 20.0, (61 * i % 440) as f64 + 20.0];
            Vote {
                pixel,
                marker: i % 2,
                heading_rad: 0.4 * i as f32,
                reading: StretchReading {
                    stretch: stretch_at(i, pixel),
                    variance: 4e-6,
                },
            }
        };
        (0..n).map(vote).collect()
    }

    #[test]
    fn five_votes_that_agree_are_a_perspective() {
        let truth = Vector4::new(0.2, -0.5, 0.0, 0.0);
        let place = Perspective::new(SIZE);
        let of = |_: usize, pixel: [f64; 2]| stretch(&truth, place.relative_to_middle(pixel));
        let mut perspective = Perspective::new(SIZE);
        perspective.vote(votes_of(of, 4).into_iter());
        assert_eq!(perspective.at([320.0, 240.0]).seen(), Seen::Unknown);
        perspective.vote(votes_of(of, 5).into_iter());
        assert_eq!(perspective.at([320.0, 240.0]).seen(), Seen::AtAnAngle);
        let expected = perspective.at([500.0, 100.0]).stretch;
        let truth = of(0, [500.0, 100.0]);
        for (found, truth) in expected.into_iter().zip(truth) {
            assert!(
                (f64::from(found) - truth).abs() < 0.02,
                "{found}, not {truth}"
            );
        }
    }

    #[test]
    fn a_shape_that_turns_with_its_stretch_is_no_perspective() {
        let mut perspective = Perspective::new(SIZE);
        // The same again and again counts once.
        let same = votes_of(|_, _| [0.2, 0.1], 1);
        for _ in 0..20 {
            perspective.vote(same.iter().copied());
        }
        assert_eq!(perspective.at([320.0, 240.0]).seen(), Seen::Unknown);
        let turning = |i: usize, _: [f64; 2]| {
            let (sin, cos) = (0.8 * i as f64).sin_cos();
            [0.2 * cos, 0.2 * sin]
        };
        perspective.vote(votes_of(turning, 30).into_iter());
        assert_eq!(perspective.at([320.0, 240.0]).seen(), Seen::Unknown);
    }
}
