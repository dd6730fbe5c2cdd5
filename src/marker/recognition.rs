//! Recognition of a figure and its pose: candidates by the descriptor, pose by the fit, decision by
//! the residual of the fit.

mod expected;

use fourier::affine::{Normalised, align, normalise};
use fourier::contour::resample;
use fourier::descriptor::{Descriptor, describe};
use fourier::matching::{compare_both_ways, min_distance};
use fourier::wrapped;
use imgproc::fit::{
    CurvedFit, Fit, PlateMap, Pose, Prior, StretchPrior, Within, fit_curved_shape, fit_shape,
    refine_shape,
};

use crate::marker::Family;
use crate::marker::cutout::{Cutout, Figure, Plate, Square};
use crate::marker::optics::{ImagingReading, Optics};
use crate::marker::perspective::{Seen, StretchReading};
pub(crate) use crate::marker::recognition::expected::Expected;
use crate::marker::reference::{AngleReference, ORIENTATION_MIN, Reference, size_px};
use crate::marker::template::Pattern;

/// Maximum number of candidates that are fitted.
const CANDIDATES: usize = 4;

/// Maximum distance between the descriptors of candidate and figure: mean square distance of the
/// contour points, in units of the size.
const DISTANCE_MAX: f32 = 0.05;

/// Maximum distance relative to the nearest candidate: a factor, and an addend.
const DISTANCE_BEYOND: (f32, f32) = (4.0, 0.004);

/// Maximum distance between normalised contours of candidate and figure: mean square distance of
/// their points, where a disc has a radius of 1.
const ANGLE_DISTANCE_MAX: f32 = 0.08;

/// Standard deviation of the stretch that a contour shows.
const OF_CONTOUR: f32 = 0.04;

/// Maximum deviation of the stretch of a plate from what is expected, in standard deviations of
/// both. Pixels may outweigh the prior: trapezoids became triangles that were 12 deviations off.
const DEVIATION_MAX: f32 = 5.0;

/// The same for a candidate's contour, and what the square of a deviation adds to the distance.
const START_DEVIATION_MAX: f32 = 4.0;
const DISTANCE_OF_DEVIATION: f32 = 0.002;

/// Minimum correlation of a marker's plate with its pattern, for any position relative to the pixel
/// grid.
const ALIKE_MIN: f32 = 0.5;

/// Relative standard deviation of the plate size derived from a contour.
const PLATE_LN_SIGMA: f32 = 0.1;

/// Noise of white pixels relative to floor pixels. Sensors count photons, so it may be higher; the
/// processing in the camera levels that out.
const NOISE_OF_WHITE: f32 = 1.1;

/// Tolerance for the mean square residual due to noise, in standard deviations.
const NOISE_DEVIATIONS: f32 = 4.0;

/// Minimum residual of the second best explanation above the best: difference of the sums of
/// squares, in units of the noise. With equal priors, the probability of an error would be exp(-8).
const RIVAL_MIN: f32 = 16.0;

/// Minimum contrast between plate and marker, in units of the noise and in grey levels. With less,
/// noise could hide a hundredth of the plate; at 6, a robot in unfavourable colours was taken for a
/// keyhole.
pub(crate) const CONTRAST_DEVIATIONS: f32 = 7.0;

/// No ink is darker than black; noise and the rounding of grey levels require some tolerance.
const BLACKER_THAN_BLACK: f32 = 1.1;

/// Maximum blur relative to the plate's side. Above it markers cannot be distinguished: at a tenth,
/// half discs and squares are taken for drops and triangles.
const BLUR_SHARE_MAX: f32 = 0.085;

/// From this relative blur on, the maximum residual decreases in inverse proportion, because blur
/// hides the differences between figures. With 0.06 of the contrast, none of 5,000 figures was
/// taken for a wrong marker at a blur of a fortieth of the plate, but 40 of 1,275 at a fourteenth.
const BLUR_SHARE_FREE: f32 = 0.05;

/// If the paper covers less than this share of a drawing's plate, the real plate is smaller, and
/// the pixels outside of it do not count.
const PAPER_SHARE: f32 = 0.97;

/// Minimum visible share of the plate, without its blurred borders, for a recognition. With a
/// quarter, other figures were taken for a drop.
const SEEN_SHARE_MIN: f32 = 0.35;

/// Minimum R² for a marker on part of its plate, and its maximum residual as a share of that for a
/// whole plate. Real markers had an R² of at least 0.989; half a figure in a shadow had 0.987.
const PART_R_SQUARED_MIN: f32 = 0.988;
const PART_RESIDUAL_RATIO: f32 = 0.8;

/// Maximum exponent of the tone curve for a marker on part of its plate. A triangular shadow in a
/// compressed picture was a tee with an exponent of 1.4. Whole plates with thick ink have up to 1.3.
const PART_TONE_MAX: f32 = 1.25;

/// Thresholds for the recognition of markers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecognitionSettings {
    /// Maximum residual besides noise: RMS over the plate, as a share of the contrast.
    pub residual_ratio_max: f32,
    /// Minimum contrast between plate and marker, grey levels.
    pub contrast_min: f32,
    /// Smallest plate, side in pixels.
    pub plate_min_px: f32,
    /// Largest plate, side in pixels.
    pub plate_max_px: f32,
}

/// A recognised marker, in the coordinates of the cut-out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recognised {
    /// Index in the family.
    pub marker: usize,
    /// Centre of the plate, pixels.
    pub centre: [f32; 2],
    /// Direction in which the drawing points up, from +x towards +y.
    pub heading_rad: f32,
    /// Side of the plate, pixels.
    pub plate_px: f32,
    /// Share of the plate's variance explained by the marker, 0 to 1.
    pub confidence: f32,
    /// Covariance of x, y (pixels) and heading (radians).
    pub covariance: [[f32; 3]; 3],
    /// Whether it is a reading. A plate at an angle to a camera of unknown perspective is none, only
    /// a vote for a perspective.
    pub(crate) is_certain: bool,
    /// Blur and tone curve of the camera, if the marker shows them.
    pub(crate) imaging: Option<ImagingReading>,
    /// How the camera stretches the plate, if the marker shows it.
    pub(crate) stretch: Option<StretchReading>,
}

/// A marker that matches a figure.
#[derive(Debug, Clone, Copy)]
struct Candidate<'a> {
    marker: usize,
    reference: &'a Reference,
    distance: f32,
    turn_rad: f32,
}

/// A marker and its initial pose.
type Start = (usize, Placed);

/// Where a plate may be.
#[derive(Debug, Clone, Copy)]
enum Placed {
    Upright(Pose),
    /// Seen at an angle.
    AtAnAngle(PlateMap),
}

/// A fit, and the stretch if it was fitted.
#[derive(Debug, Clone, Copy)]
struct Fitted {
    fit: Fit,
    stretch: Option<StretchReading>,
}

impl Family {
    /// The marker on a plate, with its pose; `None` if there is none or it is ambiguous.
    pub(crate) fn recognise(
        &self,
        plate: &Plate<'_>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        let by_figure = plate.figure.and_then(|figure| {
            self.recognise_contour(&figure, Some(plate), cutout, optics, settings)
        });
        by_figure.or_else(|| {
            let starts = self.starts_by_pattern(plate.square()?, cutout, optics)?;
            self.best_fit(starts, None, cutout, optics, settings)
        })
    }

    /// Recognises a figure whose plate is unknown. `None` if it is not a marker, or ambiguous.
    pub(crate) fn recognise_figure(
        &self,
        figure: &Figure<'_>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        self.recognise_contour(figure, None, cutout, optics, settings)
    }

    fn recognise_contour(
        &self,
        figure: &Figure<'_>,
        plate: Option<&Plate<'_>>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        let upright = || {
            let starts = self.starts_by_contour(figure, optics)?;
            self.best_fit(starts, plate, cutout, optics, settings)
        };
        let at_an_angle = || {
            let starts = self.starts_at_an_angle(figure, optics)?;
            self.best_fit(starts, plate, cutout, optics, settings)
        };
        match optics.stretch.seen() {
            Seen::FromAbove => upright(),
            // At any angle, too many figures of other things are those of markers.
            Seen::Unknown => upright().or_else(|| {
                at_an_angle().map(|read| Recognised {
                    is_certain: false,
                    ..read
                })
            }),
            Seen::AtAnAngle => at_an_angle().or_else(upright),
        }
    }

    /// The best fit, if it explains the pixels and no other fit does. `plate` is given if it may be
    /// smaller than drawn.
    fn best_fit(
        &self,
        starts: [Option<Start>; CANDIDATES],
        plate: Option<&Plate<'_>>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        let noise = optics.imaging.noise();
        let mut best: Option<(Start, Option<Within<'_>>, Fitted)> = None;
        let mut rival = f32::INFINITY;
        for start in starts.into_iter().flatten() {
            let mut within = None;
            let mut fitted = self.fitted(start, None, cutout, optics, settings);
            if !fitted.is_some_and(|fitted| explains(&fitted.fit, noise, settings)) {
                let paper = plate.and_then(|plate| smaller_paper(plate, plate_px(&start.1)));
                let part = paper
                    .and_then(|paper| self.fitted(start, Some(paper), cutout, optics, settings))
                    .filter(|part| shows_enough(&part.fit, noise, settings));
                if part.is_some() {
                    (within, fitted) = (paper, part);
                }
            }
            let Some(fitted) = fitted else { continue };
            match &mut best {
                Some((.., before)) if before.fit.residual <= fitted.fit.residual => {
                    rival = rival.min(fitted.fit.residual);
                }
                best => {
                    if let Some((.., before)) = best {
                        rival = rival.min(before.fit.residual);
                    }
                    *best = Some((start, within, fitted));
                }
            }
        }
        let ((marker, placed), within, fitted) = best?;
        if !explains(&fitted.fit, noise, settings) || !clear(&fitted.fit, rival, noise) {
            return None;
        }
        // A camera whose perspective is unknown gets no more freedom for the decision, only for
        // the pose.
        let Fitted { fit, stretch } = match (optics.stretch.seen(), placed) {
            (Seen::Unknown, Placed::Upright(_)) => self
                .refined(marker, &fitted.fit, within, cutout, optics, settings)
                .filter(|refined| explains(&refined.fit, noise, settings))
                .unwrap_or(fitted),
            _ => fitted,
        };
        read(marker, &fit, settings).map(|read| Recognised {
            imaging: optics.imaging.reading(&fit),
            stretch,
            ..read
        })
    }

    /// Fits a marker from an initial pose.
    fn fitted(
        &self,
        (marker, placed): Start,
        within: Option<Within<'_>>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Fitted> {
        let layers = self.markers[marker].template.layers();
        let Cutout { grey, size, .. } = cutout;
        let (prior, expected) = priors(optics, settings, plate_px(&placed));
        let map = match placed {
            Placed::AtAnAngle(map) => map,
            Placed::Upright(pose) if optics.stretch.seen() != Seen::Unknown => {
                PlateMap::upright(&pose)
            }
            Placed::Upright(pose) => {
                let fit = fit_shape(grey, size, within, layers, pose, &prior)?;
                return Some(Fitted { fit, stretch: None });
            }
        };
        fit_curved_shape(grey, size, within, layers, map, &prior, &expected)
            .and_then(|curved| likely(curved, optics))
    }

    /// Continues an upright fit with any stretch.
    fn refined(
        &self,
        marker: usize,
        upright: &Fit,
        within: Option<Within<'_>>,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Fitted> {
        let layers = self.markers[marker].template.layers();
        let Cutout { grey, size, .. } = cutout;
        let pose = &upright.pose;
        let (prior, expected) = priors(optics, settings, pose.plate_px);
        refine_shape(grey, size, within, layers, pose, &prior, &expected)
            .and_then(|curved| likely(curved, optics))
    }

    /// Initial poses of the markers whose contours, seen at any angle, are nearest to that of a
    /// figure.
    fn starts_at_an_angle(
        &self,
        figure: &Figure<'_>,
        optics: &Optics,
    ) -> Option<[Option<Start>; CANDIDATES]> {
        let seen = normalise(figure.contour)?;
        let magnitudes = seen.magnitudes();
        let blur_px = optics.imaging.blur_px();
        let mut nearest = [None::<(f32, Start)>; CANDIDATES];
        for (marker, of_marker) in self.markers.iter().enumerate() {
            let Some(reference) = of_marker.nearest_reference(blur_px, size_px(&seen)) else {
                continue;
            };
            let reference = &reference.at_an_angle;
            if min_distance(&magnitudes, &reference.magnitudes) > ANGLE_DISTANCE_MAX {
                continue;
            }
            for aligned in align(&seen, &reference.normalised).into_iter().flatten() {
                if aligned.distance > ANGLE_DISTANCE_MAX {
                    continue;
                }
                let Some(map) = map_of(&seen, reference, aligned.turn_rad) else {
                    continue;
                };
                let deviation2 = optics
                    .stretch
                    .deviation2(map.stretch(), OF_CONTOUR * OF_CONTOUR);
                if deviation2 > START_DEVIATION_MAX * START_DEVIATION_MAX {
                    continue;
                }
                let off = aligned.distance + DISTANCE_OF_DEVIATION * deviation2;
                let farther = |kept: &Option<(f32, Start)>| kept.is_none_or(|(kept, _)| off < kept);
                if let Some(place) = nearest.iter().position(farther) {
                    nearest[place..].rotate_right(1);
                    nearest[place] = Some((off, (marker, Placed::AtAnAngle(map))));
                }
            }
        }
        let limit = DISTANCE_BEYOND.0 * nearest[0]?.0 + DISTANCE_BEYOND.1;
        let is_near = |&(off, _): &(f32, Start)| off <= limit;
        Some(nearest.map(|kept| kept.filter(is_near).map(|(_, start)| start)))
    }

    /// Initial poses of the markers whose contours are nearest to that of a figure.
    fn starts_by_contour(
        &self,
        figure: &Figure<'_>,
        optics: &Optics,
    ) -> Option<[Option<Start>; CANDIDATES]> {
        let descriptor = describe(&resample(figure.contour), ORIENTATION_MIN).ok()?;
        let candidates = self.candidates(&descriptor);
        let nearest = candidates[0]?.distance;
        let limit = (DISTANCE_BEYOND.0 * nearest + DISTANCE_BEYOND.1).min(DISTANCE_MAX);
        Some(candidates.map(|candidate| {
            let candidate = candidate.filter(|candidate| candidate.distance <= limit)?;
            let pose = start(figure, &descriptor, &candidate, optics);
            Some((candidate.marker, Placed::Upright(pose)))
        }))
    }

    /// Initial poses of the markers that correlate best with a plate sampled at a few points, at
    /// each of its four rotations.
    fn starts_by_pattern(
        &self,
        square: Square,
        cutout: Cutout<'_>,
        optics: &Optics,
    ) -> Option<[Option<Start>; CANDIDATES]> {
        let (sin, cos) = square.turn_rad.sin_cos();
        let mut seen = Pattern::of(|[u, v]| {
            let [u, v] = [u, v].map(|c| c * square.side_px);
            let x = square.centre[0] + cos * u - sin * v;
            let y = square.centre[1] + sin * u + cos * v;
            interpolated(cutout, x, y)
        })?;
        let mut likely = [None::<(f32, Start)>; CANDIDATES];
        for quarters in 0..4 {
            for (marker, of_marker) in self.markers.iter().enumerate() {
                let alike = seen.correlation(of_marker.template.pattern());
                if alike < ALIKE_MIN {
                    continue;
                }
                let less = |kept: &Option<(f32, Start)>| kept.is_none_or(|(kept, _)| kept < alike);
                if let Some(place) = likely.iter().position(less) {
                    likely[place..].rotate_right(1);
                    let turn = std::f32::consts::FRAC_PI_2 * quarters as f32;
                    let pose = Pose {
                        centre: square.centre,
                        turn_rad: square.turn_rad + turn,
                        plate_px: square.side_px,
                        blur_px: optics.imaging.blur_px(),
                    };
                    likely[place] = Some((alike, (marker, Placed::Upright(pose))));
                }
            }
            seen = seen.turned();
        }
        Some(likely.map(|likely| likely.map(|(_, start)| start)))
    }

    /// The markers nearest to a descriptor, each upright and upside down, in ascending order of
    /// distance.
    fn candidates(&self, descriptor: &Descriptor) -> [Option<Candidate<'_>>; CANDIDATES] {
        let mut nearest = [None::<Candidate<'_>>; CANDIDATES];
        let magnitudes = descriptor.magnitudes();
        for (marker, of_marker) in self.markers.iter().enumerate() {
            let mut ways = [None::<Candidate<'_>>; 2];
            for sizes in &of_marker.references {
                let Some(reference) = nearest_size(sizes, descriptor.size_px) else {
                    continue;
                };
                if min_distance(&magnitudes, &reference.magnitudes) > DISTANCE_MAX {
                    continue;
                }
                let both = compare_both_ways(descriptor, &reference.descriptor);
                for (way, found) in ways.iter_mut().zip(both) {
                    if way.is_none_or(|way| found.distance < way.distance) {
                        *way = Some(Candidate {
                            marker,
                            reference,
                            distance: found.distance,
                            turn_rad: found.turn_rad,
                        });
                    }
                }
            }
            for candidate in ways.into_iter().flatten() {
                let farther = |kept: &Option<Candidate<'_>>| {
                    kept.is_none_or(|kept| candidate.distance < kept.distance)
                };
                if let Some(place) = nearest.iter().position(farther) {
                    nearest[place..].rotate_right(1);
                    nearest[place] = Some(candidate);
                }
            }
        }
        nearest
    }
}

/// Side of the plate at the start of a fit.
fn plate_px(placed: &Placed) -> f32 {
    match placed {
        Placed::Upright(pose) => pose.plate_px,
        Placed::AtAnAngle(map) => map.unit_px,
    }
}

/// What a fit says, if its size is permitted.
fn read(marker: usize, fit: &Fit, settings: &RecognitionSettings) -> Option<Recognised> {
    let size_fits = (settings.plate_min_px..=settings.plate_max_px).contains(&fit.pose.plate_px);
    size_fits.then(|| Recognised {
        marker,
        centre: fit.pose.centre,
        // The drawing points up, against the y axis.
        heading_rad: wrapped(fit.pose.turn_rad - std::f32::consts::FRAC_PI_2),
        plate_px: fit.pose.plate_px,
        confidence: fit.r_squared,
        covariance: fit.covariance,
        is_certain: true,
        imaging: None,
        stretch: None,
    })
}

/// What a fit of a plate starts from.
fn priors(optics: &Optics, settings: &RecognitionSettings, plate_px: f32) -> (Prior, StretchPrior) {
    let imaging = &optics.imaging;
    (
        imaging.prior(PLATE_LN_SIGMA, settings.residual_ratio_max),
        optics.stretch.prior(imaging.blur_px(), plate_px),
    )
}

/// A fit, if its stretch is possible for this camera.
fn likely(curved: CurvedFit, optics: &Optics) -> Option<Fitted> {
    let CurvedFit {
        fit,
        stretch,
        stretch_variance,
    } = curved;
    let stretch = optics.stretch.reading(stretch, stretch_variance);
    let is_likely = |reading: &StretchReading| {
        let deviation2 = optics
            .stretch
            .deviation2(reading.stretch(), reading.variance());
        deviation2 <= DEVIATION_MAX * DEVIATION_MAX
    };
    stretch
        .as_ref()
        .is_none_or(is_likely)
        .then_some(Fitted { fit, stretch })
}

/// The map of a plate whose figure is an affine picture of that of the reference. `None` if it
/// would have to be seen from the side.
fn map_of(seen: &Normalised, reference: &AngleReference, turn_rad: f32) -> Option<PlateMap> {
    let (sin, cos) = turn_rad.sin_cos();
    let [[a, b], [_, d]] = reference.normalised.to_pixels;
    let determinant = a * d - b * b;
    let inverse = [[d, -b], [-b, a]].map(|row| row.map(|c| c / determinant));
    // From pixels of the reference to pixels of the picture.
    let map = product(seen.to_pixels, product([[cos, -sin], [sin, cos]], inverse));
    let [x, y] = reference.centre_from_figure_px;
    let centre = [0, 1].map(|i: usize| seen.centre[i] + map[i][0] * x + map[i][1] * y);
    let column = |k: usize| [0, 1].map(|i: usize| map[i][k] * reference.plate_px);
    PlateMap::affine(centre, [column(0), column(1)])
}

fn product(a: [[f32; 2]; 2], b: [[f32; 2]; 2]) -> [[f32; 2]; 2] {
    [0, 1].map(|i: usize| [0, 1].map(|k: usize| a[i][0] * b[0][k] + a[i][1] * b[1][k]))
}

/// The paper of a plate, if it is smaller than the plate of the initial pose.
fn smaller_paper<'a>(plate: &Plate<'a>, plate_px: f32) -> Option<Within<'a>> {
    let share = plate.paper_px2 as f32 / (plate_px * plate_px);
    (plate.touches || share < PAPER_SHARE).then_some(plate.paper)
}

/// Whether enough of a partial plate is visible, and fits well enough.
fn shows_enough(fit: &Fit, noise: f32, settings: &RecognitionSettings) -> bool {
    let seen_px2 = fit.n * (fit.block_px * fit.block_px) as f32;
    let stricter = RecognitionSettings {
        residual_ratio_max: PART_RESIDUAL_RATIO * settings.residual_ratio_max,
        ..*settings
    };
    seen_px2 >= SEEN_SHARE_MIN * fit.pose.plate_px * fit.pose.plate_px
        && fit.r_squared >= PART_R_SQUARED_MIN
        && fit.tone <= PART_TONE_MAX
        && explains(fit, noise, &stricter)
}

/// Interpolated grey value; `None` outside of the cut-out.
fn interpolated(cutout: Cutout<'_>, x: f32, y: f32) -> Option<f32> {
    let (width, height) = (cutout.size.width, cutout.size.height);
    if !(x >= 0.0 && y >= 0.0 && x < (width - 1) as f32 && y < (height - 1) as f32) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    let (x, y) = (x - column as f32, y - row as f32);
    let at = |i: usize| f32::from(cutout.grey[row * width + column + i]);
    let across = |i: usize| at(i) + x * (at(i + 1) - at(i));
    Some(across(0) + y * (across(width) - across(0)))
}

/// The initial pose from the contour.
fn start(
    figure: &Figure<'_>,
    descriptor: &Descriptor,
    candidate: &Candidate<'_>,
    optics: &Optics,
) -> Pose {
    let (sin, cos) = candidate.turn_rad.sin_cos();
    let from_figure = candidate.reference.centre_from_figure;
    let [dx, dy] = from_figure.map(|d| d * descriptor.size_px);
    let [x, y] = figure.region.centre;
    Pose {
        centre: [x + cos * dx - sin * dy, y + sin * dx + cos * dy],
        turn_rad: candidate.turn_rad,
        plate_px: descriptor.size_px * candidate.reference.plate_per_size,
        blur_px: optics.imaging.blur_px(),
    }
}

/// Whether the residual of a fit is noise, and its contrast is not.
fn explains(fit: &Fit, noise: f32, settings: &RecognitionSettings) -> bool {
    let block = fit.block_px as f32;
    let noise = NOISE_OF_WHITE * noise / block;
    let blur_share = fit.pose.blur_px / fit.pose.plate_px;
    let residual_max =
        settings.residual_ratio_max * (BLUR_SHARE_FREE / blur_share).min(1.0) * fit.contrast;
    let spread = 1.0 + NOISE_DEVIATIONS * (2.0 / fit.n).sqrt();
    let left = fit.residual / block;
    left * left <= noise * noise * spread + residual_max * residual_max
        && fit.contrast >= settings.contrast_min.max(CONTRAST_DEVIATIONS * noise)
        && fit.contrast <= BLACKER_THAN_BLACK * fit.light
        && blur_share <= BLUR_SHARE_MAX
}

/// Whether the residual of every other explanation is clearly larger.
fn clear(fit: &Fit, rival: f32, noise: f32) -> bool {
    let unit = fit.residual.max(noise);
    fit.n * (rival * rival - fit.residual * fit.residual) >= RIVAL_MIN * unit * unit
}

/// The reference with the nearest size, by ratio.
fn nearest_size(references: &[Reference], size_px: f32) -> Option<&Reference> {
    let ratio = |r: &&Reference| (r.descriptor.size_px / size_px).ln().abs();
    references
        .iter()
        .min_by(|a, b| ratio(a).total_cmp(&ratio(b)))
}
