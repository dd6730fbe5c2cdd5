//! A drawing from an image: the outline of a shape that was cut by hand and lies on its plate.

use imgproc::Size;
use imgproc::tone::ToneCurve;

use crate::image::frame::Picture;
use crate::marker::MarkerFile;
use crate::marker::colour::{intensity, project};
use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
use crate::marker::drawing::svg_of;

/// Minimum side of a traced plate, pixels: on smaller ones, blur rounds off the corners.
const PLATE_MIN_PX: f32 = 40.0;

/// Reasons why an image gives no drawing.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TraceError {
    /// There is no dark figure on a light square.
    #[error(
        "no dark shape on a light, square plate is seen; lay the plate on a darker floor, with light all around the shape"
    )]
    NoPlate,
    /// The plate is too small.
    #[error(
        "the largest plate with a shape is {side_px:.0} pixels wide, at least {PLATE_MIN_PX} are needed; bring it nearer to the camera"
    )]
    TooSmall {
        /// Its side.
        side_px: f32,
    },
}

/// The drawing of the shape on the largest plate in an image. Its up direction is that of the
/// image, aligned with the nearest side of the plate.
///
/// # Errors
///
/// [`TraceError`] if there is no plate with a shape, or it is too small.
pub fn trace(picture: &Picture, name: &str) -> Result<MarkerFile, TraceError> {
    let size = picture.size;
    let whole = size.bounds();
    let mask = vec![1; size.area()];
    let mut grey = vec![0; size.area()];
    intensity(picture, whole, &mut grey);
    let by_brightness = largest(size, &grey, &mask);
    let by_colour =
        project(picture, whole, &mask, &mut grey).and_then(|_| largest(size, &grey, &mask));
    let wider = |a: &(f32, Vec<[f32; 2]>), b: &(f32, Vec<[f32; 2]>)| a.0.total_cmp(&b.0);
    let found = by_brightness.into_iter().chain(by_colour).max_by(wider);
    let (side_px, outline) = found.ok_or(TraceError::NoPlate)?;
    if side_px < PLATE_MIN_PX {
        return Err(TraceError::TooSmall { side_px });
    }
    Ok(MarkerFile {
        name: name.to_owned(),
        svg: svg_of(&outline),
    })
}

/// The largest plate with a figure: its side, and the figure's outline in units of the side, from
/// the plate's centre, upright.
fn largest(size: Size, grey: &[u8], mask: &[u8]) -> Option<(f32, Vec<[f32; 2]>)> {
    let mut largest: Option<(f32, Vec<[f32; 2]>)> = None;
    let cutout = Cutout { size, grey, mask };
    find_plates(
        cutout,
        &ToneCurve::new(1.0),
        &mut CutoutScratch::new(size),
        |plate| {
            let (Some(figure), Some(square)) = (plate.figure, plate.exact_square()) else {
                return false;
            };
            if largest
                .as_ref()
                .is_none_or(|(side, _)| square.side_px > *side)
            {
                // The rotation nearest to upright, of the four.
                let quarter = std::f32::consts::FRAC_PI_2;
                let turn_rad = square.turn_rad - quarter * (square.turn_rad / quarter).round();
                let (sin, cos) = turn_rad.sin_cos();
                let upright = |&[x, y]: &[f32; 2]| {
                    let [dx, dy] = [x - square.centre[0], y - square.centre[1]];
                    [cos * dx + sin * dy, cos * dy - sin * dx].map(|d| d / square.side_px)
                };
                let outline = figure.contour.iter().map(upright).collect();
                largest = Some((square.side_px, outline));
            }
            true
        },
    );
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::BUILT_IN;
    use crate::marker::drawing::read_drawing;
    use crate::marker::reference::{Placement, render};

    const SIZE: Size = Size {
        width: 200,
        height: 180,
    };

    fn view(name: &str, plate_px: f32, turn_rad: f32) -> Picture {
        let (_, svg) = BUILT_IN.iter().find(|(n, _)| *n == name).expect("built in");
        let drawing = read_drawing(name, svg).expect("a drawing");
        let place = Placement {
            centre: [97.3, 88.8],
            turn_rad,
            plate_px,
        };
        let grey = render(&drawing, SIZE, place, 0.8);
        Picture {
            size: SIZE,
            red: grey.clone(),
            green: grey.clone(),
            blue: grey,
        }
    }

    /// A traced drawing equals the original: shape, heading, size and position on the plate.
    #[test]
    fn what_is_traced_is_what_was_drawn() {
        for (i, (name, svg)) in BUILT_IN.iter().enumerate() {
            let turn_rad = 0.1 * (i as f32 - 6.0);
            let file = trace(&view(name, 110.0, turn_rad), "new").expect("a plate");
            let [seen, drawn] = [("new", file.svg.as_str()), (*name, svg)]
                .map(|(name, svg)| read_drawing(name, svg).expect("a drawing").outline);
            let [a, b] = [&seen, &drawn].map(|outline| {
                fourier::descriptor::describe(&fourier::contour::resample(outline), 0.05)
                    .expect("a marker shows its orientation")
            });
            let alike = fourier::matching::compare(&a, &b);
            assert!(alike.distance < 0.002, "{name}: {}", alike.distance);
            assert!(alike.turn_rad.abs() < 0.02, "{name}: {}", alike.turn_rad);
            let [seen, drawn] = [seen, drawn].map(|outline| fourier::contour::region(&outline));
            assert!((seen.area / drawn.area - 1.0).abs() < 0.05, "{name}");
            for (a, b) in seen.centre.into_iter().zip(drawn.centre) {
                assert!((a - b).abs() < 0.02, "{name}: {:?}", seen.centre);
            }
        }
    }

    #[test]
    fn what_cannot_be_traced_is_reported() {
        let small = trace(&view("arrow", 30.0, 0.0), "new").expect_err("too small");
        assert!(matches!(small, TraceError::TooSmall { side_px } if (side_px - 30.0).abs() < 2.0));
        assert_eq!(trace(&Picture::new(SIZE), "new"), Err(TraceError::NoPlate));
    }
}
