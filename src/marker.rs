//! Marker families: the appearance of markers, and their recognition (sections 2.2.2 and 2.2.3 of
//! the paper).
//!
//! [`read_folder`] finds the SVG files, [`name`] checks marker names, [`drawing`] reads a marker
//! from a file; `cutout` finds the dark figures on the bright plates of a shape.
//!
//! The descriptor of a figure's contour is matched with the `reference`s. The `template`s of the
//! best candidates are fitted to the pixels of the plate, and the residual of the fit decides
//! (`recognition`). Blur and noise are common to all plates of a camera; `optics` estimates them
//! meanwhile, and `perspective` what its tilt and its lens do to plates. If intensity does not separate marker and plate, `colour` may. `bound` gives the best
//! possible accuracy of a pose.

pub(crate) mod colour;
pub(crate) mod cutout;
pub mod drawing;
mod folder;
pub mod name;
pub(crate) mod optics;
pub(crate) mod perspective;
mod recognition;
pub(crate) mod reference;
pub(crate) mod search;
mod template;

use fourier::descriptor::Descriptor;
pub(crate) use fourier::matching;
use fourier::matching::{compare, distances};

use crate::marker::drawing::{Drawing, DrawingError, read_drawing};
pub use crate::marker::folder::read_folder;
use crate::marker::name::{NameError, check_name, check_unlike};
pub(crate) use crate::marker::recognition::Expected;
pub use crate::marker::recognition::{Recognised, RecognitionSettings};
use crate::marker::reference::{BLURS_PX, NoReference, PLATES_PX, Reference};
use crate::marker::template::Template;

/// The built-in family: name and SVG text.
pub const BUILT_IN: [(&str, &str); 13] = [
    ("arrow", include_str!("../markers/arrow.svg")),
    ("bat", include_str!("../markers/bat.svg")),
    ("chevron", include_str!("../markers/chevron.svg")),
    ("crown", include_str!("../markers/crown.svg")),
    ("cup", include_str!("../markers/cup.svg")),
    ("glider", include_str!("../markers/glider.svg")),
    ("goblet", include_str!("../markers/goblet.svg")),
    ("keyhole", include_str!("../markers/keyhole.svg")),
    ("moth", include_str!("../markers/moth.svg")),
    ("sprout", include_str!("../markers/sprout.svg")),
    ("swift", include_str!("../markers/swift.svg")),
    ("tee", include_str!("../markers/tee.svg")),
    ("triangle", include_str!("../markers/triangle.svg")),
];

/// Minimum elongation of a marker. Below it, noise rotates the contour's orientation too far for
/// the fit to start. At 0.07, plates of 14 px are read.
pub const ELONGATION_MIN: f32 = 0.04;

/// Minimum distance between two markers, and between a marker and itself rotated by half a turn:
/// mean square distance of the contour points, in units of the size.
pub const SEPARATION_MIN: f32 = 0.012;

/// The file of a marker, as stored in a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MarkerFile {
    /// Name of the marker: the file's name without `.svg`.
    pub name: String,
    /// The file's text.
    pub svg: String,
}

/// Reasons to reject a family.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FamilyError {
    /// The folder cannot be read.
    #[error("markers {folder}: {reason}; give a folder of SVG files")]
    Unreadable {
        /// The folder.
        folder: String,
        /// Error message of the system.
        reason: String,
    },
    /// There are no drawings in the folder.
    #[error(
        "markers {folder}: no .svg file in it; copy one of the built-in markers there to start from"
    )]
    Empty {
        /// The folder.
        folder: String,
    },
    /// A drawing is not a marker.
    #[error(transparent)]
    Drawing(#[from] DrawingError),
    /// A drawing is compressed.
    #[error("markers {file}: a compressed drawing is not read; unpack it into a .svg file")]
    Compressed {
        /// The file.
        file: String,
    },
    /// The encoding of a drawing is unknown.
    #[error("markers {file}: {reason}; save it as plain SVG in UTF-8")]
    Undecodable {
        /// The file.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A name cannot be used.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The shape does not show a direction.
    #[error(
        "marker {name}: its elongation is {elongation:.3}, at least {ELONGATION_MIN} is needed to tell its heading; \
         make it longer along or across its axis"
    )]
    NoOrientation {
        /// The name.
        name: String,
        /// Absolute value of F(N-1) over that of F1.
        elongation: f32,
    },
    /// No figure is recognised in the drawing.
    #[error(
        "marker {name}: nothing is recognised on a plate of {plate_px} pixels; make the shape larger or thicker"
    )]
    Unseen {
        /// The name.
        name: String,
        /// Side of the plate.
        plate_px: f32,
    },
    /// The shape looks the same after half a turn.
    #[error(
        "marker {name}: turned by 180 degrees it is {distance:.4} away from itself, at least {SEPARATION_MIN} is \
         needed to tell front from back"
    )]
    HalfTurn {
        /// The name.
        name: String,
        /// Distance from itself after half a turn.
        distance: f32,
    },
    /// Two shapes look alike.
    #[error(
        "markers {first} and {second}: they are {distance:.4} apart, at least {SEPARATION_MIN} is needed to tell them apart; \
         take one away or change its shape"
    )]
    TooAlike {
        /// One name.
        first: String,
        /// The other.
        second: String,
        /// Distance between them.
        distance: f32,
    },
}

/// The markers to recognise.
#[derive(Debug, Clone)]
pub struct Family {
    pub(crate) markers: Vec<Marker>,
}

/// A marker and its appearance.
#[derive(Debug, Clone)]
pub(crate) struct Marker {
    pub(crate) name: String,
    /// For each of [`BLURS_PX`], the references for those [`PLATES_PX`] on which it can be read, in
    /// ascending order.
    references: Vec<Vec<Reference>>,
    template: Template,
}

impl Family {
    /// Learns the appearance of drawings.
    ///
    /// # Errors
    ///
    /// [`FamilyError`] if a drawing shows no direction, or two look alike.
    pub fn learn(drawings: &[Drawing]) -> Result<Self, FamilyError> {
        let markers = drawings
            .iter()
            .map(Marker::learn)
            .collect::<Result<Vec<_>, _>>()?;
        for (i, first) in markers.iter().enumerate() {
            let a = first.clearest();
            let [_, distance] = distances(a, a);
            if distance < SEPARATION_MIN {
                return Err(FamilyError::HalfTurn {
                    name: first.name.clone(),
                    distance,
                });
            }
            for second in &markers[..i] {
                let distance = compare(a, second.clearest()).distance;
                if distance < SEPARATION_MIN {
                    let (first, second) = (second.name.clone(), first.name.clone());
                    return Err(FamilyError::TooAlike {
                        first,
                        second,
                        distance,
                    });
                }
            }
        }
        Ok(Self { markers })
    }

    /// Reads drawings and learns them.
    ///
    /// # Errors
    ///
    /// [`FamilyError`] if a file is not a marker, or two markers cannot be distinguished.
    pub fn from_files(files: &[MarkerFile]) -> Result<Self, FamilyError> {
        let mut drawings = Vec::with_capacity(files.len());
        for (i, file) in files.iter().enumerate() {
            check_name(&file.name)?;
            check_unlike(&file.name, files[..i].iter().map(|file| file.name.as_str()))?;
            drawings.push(read_drawing(&file.name, &file.svg)?);
        }
        Self::learn(&drawings)
    }

    /// Names of the markers; [`Recognised::marker`] is an index into them.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.markers.iter().map(|marker| marker.name.as_str())
    }
}

/// On plates of at least this size every marker must be readable at every blur.
const CLEAR_PLATE_PX: f32 = 32.0;

impl Marker {
    pub(crate) fn learn(drawing: &Drawing) -> Result<Self, FamilyError> {
        let name = || drawing.name.clone();
        let mut references = Vec::with_capacity(BLURS_PX.len());
        for blur_px in BLURS_PX {
            let mut sizes = Vec::with_capacity(PLATES_PX.len());
            for plate_px in PLATES_PX {
                match Reference::learn(drawing, plate_px, blur_px) {
                    Ok(reference) => sizes.push(reference),
                    // On a small plate, blur may hide the orientation of a marker, or all of it.
                    Err(_) if plate_px < CLEAR_PLATE_PX => {}
                    Err(NoReference::Unseen) => {
                        return Err(FamilyError::Unseen {
                            name: name(),
                            plate_px,
                        });
                    }
                    Err(NoReference::Orientation(elongation)) => {
                        return Err(FamilyError::NoOrientation {
                            name: name(),
                            elongation,
                        });
                    }
                }
            }
            references.push(sizes);
        }
        let marker = Self {
            name: name(),
            references,
            template: Template::new(drawing),
        };
        let elongation = marker.clearest().elongation();
        if elongation < ELONGATION_MIN {
            return Err(FamilyError::NoOrientation {
                name: name(),
                elongation,
            });
        }
        Ok(marker)
    }

    /// The reference for a blur and a size of the figure, the square root of the product of its
    /// half axes.
    fn nearest_reference(&self, blur_px: f32, size_px: f32) -> Option<&Reference> {
        let blur = |i: &usize| (BLURS_PX[*i] / blur_px).ln().abs();
        let nearest = (0..BLURS_PX.len()).min_by(|a, b| blur(a).total_cmp(&blur(b)))?;
        let size = |r: &&Reference| (r.at_an_angle.size_px() / size_px).ln().abs();
        self.references[nearest]
            .iter()
            .min_by(|a, b| size(a).total_cmp(&size(b)))
    }

    /// The descriptor that is least affected by pixels and blur.
    pub(crate) fn clearest(&self) -> &Descriptor {
        match self.references.first().and_then(|sizes| sizes.last()) {
            Some(reference) => &reference.descriptor,
            None => unreachable!("a marker is learned with its large plates"),
        }
    }
}

/// The files of the built-in family.
#[must_use]
pub fn built_in_files() -> Vec<MarkerFile> {
    BUILT_IN
        .iter()
        .map(|&(name, svg)| MarkerFile {
            name: name.to_owned(),
            svg: svg.to_owned(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
    use crate::marker::optics::{Imaging, Optics};
    use crate::marker::perspective::ExpectedStretch;
    use crate::marker::reference::{Placement, render};
    use fourier::wrapped;
    use imgproc::Size;
    use random::SplitMix64;

    const SETTINGS: RecognitionSettings = RecognitionSettings {
        residual_ratio_max: 0.04,
        contrast_min: 25.0,
        plate_min_px: 8.0,
        plate_max_px: 200.0,
    };

    fn optics(noise: f32) -> Optics {
        let mut imaging = Imaging::new();
        imaging.noise = noise;
        Optics {
            imaging,
            stretch: ExpectedStretch::unknown(),
        }
    }

    fn marker(name: &str, path: &str) -> MarkerFile {
        let svg = format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><path d="{path}"/></svg>"#
        );
        MarkerFile {
            name: name.to_owned(),
            svg,
        }
    }

    fn refusal(files: &[MarkerFile]) -> String {
        Family::from_files(files)
            .expect_err("not a usable family")
            .to_string()
    }

    #[test]
    fn every_built_in_marker_is_read_at_every_turn() {
        let family = Family::from_files(&built_in_files()).expect("the built-in family is usable");
        for (index, (name, svg)) in BUILT_IN.iter().enumerate() {
            let drawing = read_drawing(name, svg).expect("a built-in marker");
            for step in 0..16 {
                let turn = std::f32::consts::TAU * step as f32 / 16.0 + 0.1;
                let size = Size {
                    width: 56,
                    height: 56,
                };
                let centre = [27.3 + 0.1 * step as f32, 28.8];
                let grey = render(
                    &drawing,
                    size,
                    Placement {
                        centre,
                        turn_rad: turn,
                        plate_px: 30.0,
                    },
                    0.7,
                );
                let cutout = Cutout {
                    size,
                    grey: &grey,
                    mask: &vec![1; size.area()],
                };
                let mut found = Vec::new();
                find_plates(
                    cutout,
                    &optics(0.0).imaging.tone(),
                    &mut CutoutScratch::new(size),
                    |plate| {
                        let read = family
                            .recognise(&plate, cutout, &optics(0.0), &SETTINGS)
                            .filter(|read| read.is_certain);
                        found.extend(read);
                        read.is_some()
                    },
                );
                let [pose] = found[..] else {
                    panic!("{name} at {turn}: {found:?}")
                };
                assert_eq!(
                    pose.marker, index,
                    "{name} at {turn} is taken for {}",
                    family.markers[pose.marker].name
                );
                let error = (pose.centre[0] - centre[0]).hypot(pose.centre[1] - centre[1]);
                assert!(error < 0.12, "{name} at {turn} is {error} px off");
                let heading_error =
                    wrapped(pose.heading_rad - turn + std::f32::consts::FRAC_PI_2).to_degrees();
                assert!(
                    heading_error.abs() < 1.5,
                    "{name} at {turn} is {heading_error} degrees off"
                );
                assert!(
                    (pose.plate_px - 30.0).abs() < 1.0,
                    "{name} at {turn} has a plate of {}",
                    pose.plate_px
                );
            }
        }
    }

    #[test]
    fn plates_from_24_px_are_read_sharp_or_blurred_in_noise() {
        let family = Family::from_files(&built_in_files()).expect("the built-in family is usable");
        let drawings: Vec<Drawing> = BUILT_IN
            .iter()
            .map(|(name, svg)| read_drawing(name, svg).expect("a built-in marker"))
            .collect();
        let mut random = SplitMix64(1);
        for (plate_px, blur_px) in [
            (24.0, 0.45),
            (24.0, 0.8),
            (30.0, 1.2),
            (40.0, 0.8),
            (60.0, 1.2),
            (100.0, 0.8),
        ] {
            let (mut shown, mut read) = (0, 0);
            for (index, drawing) in drawings.iter().enumerate() {
                for step in 0..12 {
                    let side = (plate_px * 1.5) as usize + 10;
                    let size = Size {
                        width: side,
                        height: side,
                    };
                    let centre = [
                        side as f32 / 2.0 + random.unit_f32(),
                        side as f32 / 2.0 + random.unit_f32(),
                    ];
                    let place = Placement {
                        centre,
                        turn_rad: 0.53 * step as f32,
                        plate_px,
                    };
                    let mut grey = render(drawing, size, place, blur_px);
                    for pixel in &mut grey {
                        // The sum of twelve uniform numbers is nearly normal, with standard
                        // deviation 1.
                        let noise: f32 = (0..12).map(|_| random.unit_f32() - 0.5).sum();
                        *pixel = (f32::from(*pixel) + 6.0 * noise).round().clamp(0.0, 255.0) as u8;
                    }
                    let cutout = Cutout {
                        size,
                        grey: &grey,
                        mask: &vec![1; size.area()],
                    };
                    shown += 1;
                    let optics = optics(6.0);
                    find_plates(
                        cutout,
                        &optics.imaging.tone(),
                        &mut CutoutScratch::new(size),
                        |plate| {
                            let seen = family.recognise(&plate, cutout, &optics, &SETTINGS);
                            let Some(pose) = seen.filter(|read| read.is_certain) else {
                                return false;
                            };
                            assert_eq!(
                                pose.marker, index,
                                "{} is taken for {}",
                                drawing.name, family.markers[pose.marker].name
                            );
                            read += 1;
                            true
                        },
                    );
                }
            }
            println!("plate {plate_px} px, blur {blur_px} px: {read} of {shown} read");
            assert!(
                f64::from(read) >= 0.98 * f64::from(shown),
                "plate {plate_px}, blur {blur_px}: {read} of {shown}"
            );
        }
    }

    #[test]
    fn a_square_is_refused_with_its_elongation() {
        let message = refusal(&[marker("square", "M25 25H75V75H25Z")]);
        assert!(
            message.starts_with("marker square: its elongation is 0.0"),
            "{message}"
        );
    }

    #[test]
    fn a_shape_that_looks_the_same_upside_down_is_refused() {
        let message = refusal(&[marker("bar", "M40 15H60V85H40Z")]);
        assert!(
            message.contains("turned by 180 degrees it is 0.0"),
            "{message}"
        );
    }

    #[test]
    fn two_shapes_that_look_alike_are_refused() {
        let message = refusal(&[
            marker("one", "M50 12L84 86H16Z"),
            marker("two", "M50 13L83 86H17Z"),
        ]);
        assert!(
            message.starts_with("markers one and two: they are 0.0"),
            "{message}"
        );
    }

    #[test]
    fn a_long_name_is_refused() {
        let message = refusal(&[marker(&"n".repeat(33), "M50 12L84 86H16Z")]);
        assert!(
            message.ends_with("the name has 33 bytes, at most 32 fit; rename the file"),
            "{message}"
        );
    }
}
