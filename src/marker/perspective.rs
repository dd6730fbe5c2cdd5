//! How the camera stretches plates, depending on where they are in the picture: the effect of its
//! tilt and of its lens, estimated from the recognised markers.
//!
//! Every reading is a measurement of the stretch at its place. They are collected in the cells of a
//! grid, older ones with less weight, and the four unknowns are fitted to the cells by least
//! squares (Levenberg-Marquardt).

mod camera;
mod expected;
mod votes;

use imgproc::Size;
use nalgebra::{Matrix4, Vector4};

use crate::marker::perspective::camera::{curvature, denominator, stretch_and_slopes};
use crate::marker::perspective::votes::Votes;

pub(crate) use crate::marker::perspective::expected::{ExpectedStretch, Seen, StretchReading};
pub(crate) use crate::marker::perspective::votes::Vote;

/// Cells of the grid in a row and in a column.
const COLUMNS: usize = 8;
const ROWS: usize = 6;

/// Standard deviation of the angle between a plate and the floor, radians, and what the stretch of
/// printed plates varies by.
const LEVEL_RAD: f64 = 0.0175;
const PRINTED: f64 = 0.0003;

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

/// What the model may be off where few votes have shown it, standard deviation.
const VOTE_SIGMA: f64 = 0.005;

/// Rounds of a fit.
const ROUNDS: usize = 8;

/// Standard deviation of the curvature besides that of the unknowns, relative to a plate as wide as
/// the picture.
const CURVATURE: f64 = 0.01;

impl ExpectedStretch {
    /// In the middle of a picture of 640 pixels, of a camera that is not known yet.
    pub(crate) fn unknown() -> Self {
        let size = Size {
            width: 640,
            height: 480,
        };
        Perspective::new(size).at([320.0, 240.0])
    }
}

/// Estimate for a camera.
#[derive(Debug, Clone)]
pub(crate) struct Perspective {
    size: Size,
    votes: Votes,
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
            votes: Votes::NONE,
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

    /// Adopts the perspective that enough votes agree on.
    pub(crate) fn vote(&mut self, votes: impl Iterator<Item = Vote>) {
        let mut any = false;
        for vote in votes {
            self.votes.add(vote);
            any = true;
        }
        let fit = |votes: &mut dyn Iterator<Item = Vote>| {
            let mut trial = Self::new(self.size);
            votes.for_each(|vote| trial.add(vote.pixel, vote.reading));
            trial.fit();
            trial
        };
        if any && let Some(agreed) = self.votes.agreed(fit, Self::deviation) {
            *self = agreed;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::perspective::camera::stretch;

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
