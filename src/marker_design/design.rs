//! New markers: shapes with the largest distances found from each other, and from themselves upside
//! down.
//!
//! A shape is given by its radius in a number of directions, the same on the left and on the right,
//! joined by a smooth curve. Of many random shapes, those with a clear and exact direction are
//! kept. They are selected one by one, each time the shape with the greatest distance to its
//! nearest selected neighbour. The distance is measured as in recognition, on a small plate in a
//! blurred image: details visible only on a large plate do not count.

use std::f32::consts::TAU;

use fourier::contour::resample;
use fourier::descriptor::{Descriptor, describe};
use fourier::matching::{compare, distances};
use random::SplitMix64;

use crate::marker::drawing::{Drawing, read_drawing, svg_of};
use crate::marker::reference::Reference;
use crate::marker::{self, Family, FamilyError, Marker, MarkerFile, SEPARATION_MIN};
use crate::marker_design::bound::least_heading_sigma;
use crate::marker_design::check::{GOOD_VIEW, is_read_on};

/// Plate and blur for which shapes must differ, pixels.
const PLATE_PX: f32 = 12.0;
const BLUR_PX: f32 = 0.8;

/// Plate on which a shape must be recognised in poor conditions. On a smaller one it is too blurred
/// for a reliable recognition.
const READ_PX: f32 = 14.0;

/// Minimum distance on a small plate: half of the one required on a large plate, because blur
/// reduces every difference.
const SMALL_SEPARATION_MIN: f32 = SEPARATION_MIN / 2.0;

/// Number of directions from up to down with a radius of their own.
const DIRECTIONS: usize = 8;

/// Minimum and maximum radius, in units of the plate's side: thinner shapes are lost on a small
/// plate, and the plate's border must stay light.
const RADIUS: (f32, f32) = (0.13, 0.4);

/// Maximum change of the radius from one direction to the next.
const STEP_MAX: f32 = 0.22;

/// Number of corners of an outline.
const CORNERS: usize = 96;

/// Number of random shapes per requested marker.
const TRIED_FOR_EACH: usize = 600;

/// Minimum elongation of a shape.
const ELONGATION_MIN: f32 = 0.13;

/// Maximum standard deviation of its heading in radians, see [`GOOD_VIEW`].
const HEADING_SIGMA_MAX: f32 = 0.001;

/// A shape and its appearance.
struct Shape {
    drawing: Drawing,
    sharp: Descriptor,
    small: Descriptor,
}

impl Shape {
    /// `None` if it is not visible on a small plate.
    fn new(drawing: Drawing) -> Option<Self> {
        let sharp = describe(&resample(&drawing.outline), marker::ELONGATION_MIN).ok()?;
        let small = Reference::learn(&drawing, PLATE_PX, BLUR_PX)
            .ok()?
            .descriptor;
        Some(Self {
            drawing,
            sharp,
            small,
        })
    }

    /// The same, if its direction is clear on large and on small plates.
    fn new_with_direction(drawing: Drawing) -> Option<Self> {
        // Most random shapes are rejected here, before anything is rendered.
        let is_exact = least_heading_sigma(&drawing, GOOD_VIEW) <= HEADING_SIGMA_MAX;
        let shape = is_exact.then(|| Self::new(drawing)).flatten()?;
        let min = shape.sharp.elongation().min(shape.small.elongation());
        (min >= ELONGATION_MIN).then_some(shape)
    }

    /// Distance from itself upside down on a small plate; 0 if it is too small on a large one.
    fn to_half_turn(&self) -> f32 {
        let [_, sharp] = distances(&self.sharp, &self.sharp);
        let [_, small] = distances(&self.small, &self.small);
        if sharp < SEPARATION_MIN { 0.0 } else { small }
    }

    /// The same for another shape.
    fn distance(&self, other: &Self) -> f32 {
        let sharp = compare(&self.sharp, &other.sharp).distance;
        let small = compare(&self.small, &other.small).distance;
        if sharp < SEPARATION_MIN { 0.0 } else { small }
    }
}

/// At most `count` shapes that are distinguishable from each other and from the markers in
/// `others`, best first. The same `seed` gives the same shapes.
///
/// # Errors
///
/// [`FamilyError`] if one of `others` is not a marker.
pub fn design(
    count: usize,
    seed: u64,
    others: &[MarkerFile],
) -> Result<Vec<MarkerFile>, FamilyError> {
    let mut family = Family::from_files(others)?;
    let mut selected = Vec::new();
    for file in others {
        selected.extend(Shape::new(read_drawing(&file.name, &file.svg)?));
    }
    let mut random = SplitMix64(seed);
    let mut shapes: Vec<Shape> = (0..count * TRIED_FOR_EACH)
        .filter_map(|_| {
            let outline = outline(&radii(&mut random));
            Shape::new_with_direction(Drawing {
                name: String::new(),
                outline,
            })
        })
        .collect();
    let mut chosen = Vec::new();
    while chosen.len() < count {
        let nearest = |shape: &Shape| {
            let to_others = selected.iter().map(|other| shape.distance(other));
            to_others.fold(shape.to_half_turn(), f32::min)
        };
        let farthest = shapes
            .iter()
            .map(nearest)
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((index, _)) = farthest.filter(|(_, distance)| *distance >= SMALL_SEPARATION_MIN)
        else {
            break;
        };
        let shape = shapes.swap_remove(index);
        let Ok(learned) = Marker::learn(&shape.drawing) else {
            continue;
        };
        family.markers.push(learned);
        if !is_read_on(&family, family.markers.len() - 1, &shape.drawing, READ_PX) {
            family.markers.pop();
            continue;
        }
        chosen.push(MarkerFile {
            name: format!("shape{:02}", chosen.len() + 1),
            svg: svg_of(&shape.drawing.outline),
        });
        selected.push(shape);
    }
    Ok(chosen)
}

/// Random radii, from up to down.
fn radii(random: &mut SplitMix64) -> [f32; DIRECTIONS + 1] {
    let mut radii = [0.0; DIRECTIONS + 1];
    let mut last = None::<f32>;
    for radius in &mut radii {
        let (min, max) = match last {
            Some(last) => (RADIUS.0.max(last - STEP_MAX), RADIUS.1.min(last + STEP_MAX)),
            None => RADIUS,
        };
        *radius = min + (max - min) * random.unit_f32();
        last = Some(*radius);
    }
    radii
}

/// The outline of a shape with the given radii, from up to down.
fn outline(radii: &[f32; DIRECTIONS + 1]) -> Vec<[f32; 2]> {
    (0..CORNERS)
        .map(|corner| {
            let angle = TAU * corner as f32 / CORNERS as f32;
            let (sin, cos) = angle.sin_cos();
            let radius = radius_at(radii, angle);
            [radius * sin, -radius * cos]
        })
        .collect()
}

/// The radius in a direction: a smooth curve through the given ones (Catmull and Rom 1974), clamped
/// to their limits.
fn radius_at(radii: &[f32; DIRECTIONS + 1], angle: f32) -> f32 {
    let at = angle / TAU * (2 * DIRECTIONS) as f32;
    let from = at as usize;
    let t = at - from as f32;
    // Down the right side and up the left side.
    let around = |i: usize| {
        let i = i % (2 * DIRECTIONS);
        radii[i.min(2 * DIRECTIONS - i)]
    };
    let [a, b, c, d] = [3, 4, 5, 6].map(|i| around(from + 2 * DIRECTIONS + i - 4));
    let curve =
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)));
    curve.clamp(RADIUS.0, RADIUS.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::built_in_files;
    use crate::marker_design::check::check;

    #[test]
    fn designed_markers_are_a_usable_family_and_the_same_every_time() {
        let others = built_in_files();
        let designed = design(5, 1, &others).expect("the built-in markers");
        assert_eq!(designed.len(), 5);
        assert_eq!(designed, design(5, 1, &others).expect("as before"));
        for check in check(&[others, designed].concat()) {
            assert!(check.quality.is_ok(), "{check:?}");
        }
    }

    #[test]
    fn an_outline_is_the_same_on_both_sides_and_passes_its_radii() {
        let radii = [0.4, 0.3, 0.2, 0.14, 0.2, 0.3, 0.36, 0.3, 0.2];
        for i in 0..=DIRECTIONS {
            let angle = TAU * i as f32 / (2 * DIRECTIONS) as f32;
            assert!((radius_at(&radii, angle) - radii[i]).abs() < 1e-4, "{i}");
            let (right, left) = (angle + 0.1, TAU - angle - 0.1);
            assert!((radius_at(&radii, right) - radius_at(&radii, left)).abs() < 1e-4);
        }
    }
}
