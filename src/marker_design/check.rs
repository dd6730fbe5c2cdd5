//! Quality of markers: the results of `overcam markers check`.

use std::fmt::Write as _;

use imgproc::Size;
use random::SplitMix64;

use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
use crate::marker::drawing::{Drawing, read_drawing};
use crate::marker::name::check_unlike;
use crate::marker::optics::{Imaging, Optics};
use crate::marker::perspective::ExpectedStretch;
use crate::marker::reference::{Placement, plate_mask, render};
use crate::marker::{Family, FamilyError, MarkerFile, SEPARATION_MIN, matching};
use crate::marker_design::bound::{View, least_heading_sigma};
use crate::settings::Settings;

/// Sizes of the test plates, pixels.
const PLATES_PX: [f32; 9] = [8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 24.0, 28.0, 32.0];

/// Poor conditions: blur and noise of the test images.
const BLUR_PX: f32 = 1.0;
const NOISE: f32 = 6.0;

/// Good conditions: an ordinary plate in focus, black on white, with an ordinary sensor.
pub(crate) const GOOD_VIEW: View = View {
    plate_px: 24.0,
    blur_px: 0.6,
    noise: 3.0 / 185.0,
};

/// Number of rotations of each test plate. All must be recognised.
const TURNS: usize = 24;

/// Result for one marker.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// Name of the marker.
    pub name: String,
    /// Its quality, or why it cannot be used.
    pub quality: Result<Quality, FamilyError>,
}

/// Quality of a marker.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Absolute value of F(N-1) over that of F1: how clearly it shows its direction.
    pub elongation: f32,
    /// Minimum standard deviation of its heading on a plate of 24 pixels in good conditions,
    /// radians.
    pub heading_sigma_rad: f32,
    /// Distance from itself rotated by half a turn: mean square distance of the contour points, in
    /// units of the size.
    pub half_turn: f32,
    /// The nearest other marker, and its distance.
    pub nearest: Option<(String, f32)>,
    /// Smallest plate from which on it is always recognised in poor conditions, pixels; `None` if
    /// there is none.
    pub smallest_plate_px: Option<f32>,
}

/// Checks each marker and each pair, and tests every usable marker on small, blurred and noisy
/// plates.
#[must_use]
pub fn check(files: &[MarkerFile]) -> Vec<Check> {
    let learned: Vec<Result<(Drawing, Family), FamilyError>> = files
        .iter()
        .enumerate()
        .map(|(i, file)| {
            let others = files[..i].iter().chain(&files[i + 1..]);
            check_unlike(&file.name, others.map(|file| file.name.as_str()))?;
            let family = Family::from_files(std::slice::from_ref(file))?;
            Ok((read_drawing(&file.name, &file.svg)?, family))
        })
        .collect();
    let usable: Vec<&(Drawing, Family)> = learned.iter().flatten().collect();
    let family = Family {
        markers: usable
            .iter()
            .flat_map(|(_, family)| family.markers.clone())
            .collect(),
    };
    let mut index = 0;
    files
        .iter()
        .zip(&learned)
        .map(|(file, learned)| Check {
            name: file.name.clone(),
            quality: match learned {
                Ok((drawing, _)) => {
                    index += 1;
                    quality(&family, index - 1, drawing)
                }
                Err(error) => Err(error.clone()),
            },
        })
        .collect()
}

fn quality(family: &Family, marker: usize, drawing: &Drawing) -> Result<Quality, FamilyError> {
    let own = family.markers[marker].clearest();
    let nearest = family
        .markers
        .iter()
        .enumerate()
        .filter(|(other, _)| *other != marker)
        .map(|(_, other)| {
            let distance = matching::compare(own, other.clearest()).distance;
            (other.name.clone(), distance)
        })
        .min_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((second, distance)) = nearest.clone().filter(|(_, d)| *d < SEPARATION_MIN) {
        return Err(FamilyError::TooAlike {
            first: drawing.name.clone(),
            second,
            distance,
        });
    }
    let [_, half_turn] = matching::distances(own, own);
    let readable = |plate_px: &&f32| is_read_on(family, marker, drawing, **plate_px);
    let smallest_plate_px = PLATES_PX.iter().rev().take_while(readable).last().copied();
    Ok(Quality {
        elongation: own.elongation(),
        heading_sigma_rad: least_heading_sigma(drawing, GOOD_VIEW),
        half_turn,
        nearest,
        smallest_plate_px,
    })
}

/// Whether a marker of a family is always recognised on plates of a size in poor conditions.
pub(crate) fn is_read_on(family: &Family, marker: usize, drawing: &Drawing, plate_px: f32) -> bool {
    let side = (1.5 * plate_px) as usize + 8;
    let size = Size {
        width: side,
        height: side,
    };
    let mut scratch = CutoutScratch::new(size);
    let mut imaging = Imaging::new();
    imaging.noise = NOISE;
    let optics = Optics {
        imaging,
        stretch: ExpectedStretch::unknown(),
    };
    let settings = Settings::default().recognition(None);
    let mut random = SplitMix64(1);
    (0..TURNS).all(|turn| {
        let place = Placement {
            centre: [0, 1].map(|_| side as f32 / 2.0 + random.unit_f32() - 0.5),
            turn_rad: std::f32::consts::TAU * (turn as f32 + random.unit_f32()) / TURNS as f32,
            plate_px,
        };
        let mut grey = render(drawing, size, place, BLUR_PX);
        for pixel in &mut grey {
            let noise = random.normal() as f32;
            *pixel = (f32::from(*pixel) + NOISE * noise)
                .round()
                .clamp(0.0, 255.0) as u8;
        }
        // If a marker reaches the edge of its plate, only the border of the shape shows where it
        // ends.
        let mask = if drawing.touches() {
            plate_mask(size, place)
        } else {
            vec![1; size.area()]
        };
        let cutout = Cutout {
            size,
            grey: &grey,
            mask: &mask,
        };
        let (mut right, mut wrong) = (false, false);
        find_plates(cutout, &imaging.tone(), &mut scratch, |plate| {
            let read = family
                .recognise(&plate, cutout, &optics, &settings)
                .filter(|read| read.is_certain);
            if let Some(read) = read {
                let heading = place.turn_rad - std::f32::consts::FRAC_PI_2;
                let turned = fourier::wrapped(read.heading_rad - heading).abs();
                let is_right = read.marker == marker && turned < 0.5;
                (right, wrong) = (right || is_right, wrong || !is_right);
            }
            read.is_some()
        });
        right && !wrong
    })
}

/// The checks as text. `cm_per_px` is the width of a pixel on the floor.
#[must_use]
pub fn table(checks: &[Check], cm_per_px: Option<f64>) -> String {
    let width = checks
        .iter()
        .map(|check| check.name.chars().count())
        .max()
        .map_or(6, |longest| longest.max(6));
    let mut out = format!(
        "{:width$}  direction  heading  half turn  nearest other{:pad$}  smallest plate\n",
        "marker",
        "",
        pad = width.saturating_sub(6)
    );
    for check in checks {
        let quality = match &check.quality {
            Ok(quality) => quality,
            Err(error) => {
                // Writing to a `String` cannot fail.
                let _ = writeln!(out, "{:width$}  unusable: {error}", check.name);
                continue;
            }
        };
        let nearest = match &quality.nearest {
            Some((name, distance)) => format!("{distance:.3} {name}"),
            None => "none".to_owned(),
        };
        let plate = match (quality.smallest_plate_px, cm_per_px) {
            (Some(px), Some(cm)) => format!("{px} px = {:.1} cm", f64::from(px) * cm),
            (Some(px), None) => format!("{px} px"),
            (None, _) => format!("more than {} px", PLATES_PX[PLATES_PX.len() - 1]),
        };
        let _ = writeln!(
            out,
            "{:width$}  {:9.3}  {:6.3}°  {:9.3}  {nearest:nearest_width$}  {plate}",
            check.name,
            quality.elongation,
            quality.heading_sigma_rad.to_degrees(),
            quality.half_turn,
            nearest_width = width + 7
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::built_in_files;

    #[test]
    fn the_built_in_markers_are_good_ones() {
        for check in check(&built_in_files()) {
            let quality = check.quality.expect("a usable marker");
            assert!(quality.elongation >= 0.1, "{}", check.name);
            let smallest = quality.smallest_plate_px.expect("readable");
            assert!(smallest <= 24.0, "{}: {smallest} px", check.name);
        }
    }

    #[test]
    fn a_marker_may_fill_its_plate() {
        let file = MarkerFile {
            name: "arrow".to_owned(),
            svg: r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><path d="M50 0L100 50H70V100H30V50H0Z"/></svg>"#
                .to_owned(),
        };
        let [check] = &check(&[file])[..] else {
            panic!("one marker")
        };
        let quality = check.quality.as_ref().expect("a usable marker");
        assert!(quality.smallest_plate_px.expect("readable") <= 24.0);
    }

    #[test]
    fn what_cannot_be_used_is_named_with_the_reason() {
        let file = |name: &str, path: &str| MarkerFile {
            name: name.to_owned(),
            svg: format!(
                r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><path d="{path}"/></svg>"#
            ),
        };
        let files = [
            file("triangle", "M50 12L84 86H16Z"),
            file("square", "M25 25H75V75H25Z"),
            file("twin", "M50 13L83 86H17Z"),
        ];
        let text = table(&check(&files), Some(0.5));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4, "{text}");
        assert!(lines[1].contains("markers triangle and twin"), "{text}");
        assert!(lines[2].contains("its elongation is 0.0"), "{text}");
        assert!(lines[3].contains("markers twin and triangle"), "{text}");
        let alone = table(&check(&files[..1]), Some(0.5));
        assert!(
            alone.contains("none") && alone.contains(" px = "),
            "{alone}"
        );
    }
}
