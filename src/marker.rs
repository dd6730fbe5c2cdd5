//! Marker families: what they look like to the camera, and which one a figure is (sections 2.2.2 and 2.2.3 of the paper).
//!
//! A reference is what the recogniser itself measures on a picture of the drawing. Each marker is rendered on its plate at
//! several sizes and turns, blurred as by a lens and rounded to 8 bits, and goes through the code that live frames go through;
//! the references of a size are the mean over the turns. What pixels and blur do to small markers, rounding off corners
//! above all, is thus part of the reference and not an error.
//!
//! A figure is a marker when three things agree: the descriptor's distance, the area of the plate for the area of the
//! figure, and the pattern of light and dark over the whole plate.

use std::path::Path;

use fourier::descriptor::{Descriptor, NoDescriptor, describe};
use fourier::matching::{compare, distances};
use fourier::{Complex32, N, contour::resample, wrapped};
use imgproc::Size;

use crate::cutout::{Cutout, CutoutScratch, Figure, find_figures};
use crate::drawing::{Drawing, DrawingError, read_drawing};
use crate::raster::{Vertex, blur, fill_polygon};

/// The built-in family: name and SVG text.
pub const BUILT_IN: [(&str, &str); 9] = [
    ("arrow", include_str!("../markers/arrow.svg")),
    ("chevron", include_str!("../markers/chevron.svg")),
    ("crescent", include_str!("../markers/crescent.svg")),
    ("cup", include_str!("../markers/cup.svg")),
    ("dee", include_str!("../markers/dee.svg")),
    ("drop", include_str!("../markers/drop.svg")),
    ("keyhole", include_str!("../markers/keyhole.svg")),
    ("tee", include_str!("../markers/tee.svg")),
    ("triangle", include_str!("../markers/triangle.svg")),
];

/// Sides of the rendered plates, in pixels. A figure is compared with the references of the nearest size.
const PLATES_PX: [f32; 7] = [12.0, 16.0, 24.0, 32.0, 48.0, 72.0, 108.0];

/// Turns at which a plate is rendered. Not a divisor of a quarter turn, so that no two see the pixel grid alike.
const TURNS: usize = 9;

/// Blur of a lens in focus, standard deviation in pixels.
const LENS_BLUR_PX: f32 = 0.6;

/// Least elongation of a marker: below, noise turns the orientation by degrees.
pub const ELONGATION_MIN: f32 = 0.1;

/// Least distance between two markers, and between a marker and its own half turn: mean square of the distance of their contours'
/// points, in units of the size.
pub const SEPARATION_MIN: f32 = 0.012;

/// Bytes of the longest name.
const NAME_MAX: usize = scene::NAME_BYTES;

/// Points across the plate at which the pattern of light and dark is compared.
const PATTERN: usize = 14;

/// A marker's file, as a recording keeps it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MarkerFile {
    /// Name of the marker: the file's name without `.svg`.
    pub name: String,
    /// The file's text.
    pub svg: String,
}

/// How sure a figure must be to count as a marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecognitionSettings {
    /// Greatest distance from the reference: mean square of the distance of the contours' points, in units of the size.
    pub distance_max: f32,
    /// Smallest plate, side in pixels.
    pub plate_min_px: f32,
    /// Largest plate, side in pixels.
    pub plate_max_px: f32,
    /// Least share of the plate's pattern that is light or dark as drawn, 0 to 1.
    pub pattern_min: f32,
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
    /// Distance of the descriptor from the reference.
    pub distance: f32,
    /// Standard deviation of the centre, pixels, either axis.
    pub centre_sigma_px: f32,
    /// Standard deviation of the heading.
    pub heading_sigma_rad: f32,
}

/// Why a family cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FamilyError {
    /// The folder cannot be read.
    #[error("markers {folder}: {reason}; give a folder of SVG files")]
    Unreadable {
        /// The folder.
        folder: String,
        /// What the system said.
        reason: String,
    },
    /// The folder holds no drawings.
    #[error(
        "markers {folder}: no .svg file in it; copy one of the built-in markers there to start from"
    )]
    Empty {
        /// The folder.
        folder: String,
    },
    /// A drawing is no marker.
    #[error(transparent)]
    Drawing(#[from] DrawingError),
    /// The name does not fit into a scene.
    #[error("marker {name}: the name has {} bytes, at most {NAME_MAX} fit; rename the file", name.len())]
    NameTooLong {
        /// The name.
        name: String,
    },
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
    /// The recogniser sees no figure in the drawing.
    #[error(
        "marker {name}: nothing is recognised on a plate of {plate_px} pixels; make the shape larger or thicker"
    )]
    Unseen {
        /// The name.
        name: String,
        /// Side of the plate.
        plate_px: f32,
    },
    /// The shape looks like itself turned by half a turn.
    #[error(
        "marker {name}: turned by 180 degrees it is {distance:.4} away from itself, at least {SEPARATION_MIN} is \
         needed to tell front from back"
    )]
    HalfTurn {
        /// The name.
        name: String,
        /// Distance from the half turn.
        distance: f32,
    },
    /// Two shapes look alike.
    #[error(
        "markers {first} and {second}: they are {distance:.4} apart, at least {SEPARATION_MIN} is needed to tell them apart"
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

/// The markers that are looked for.
#[derive(Debug, Clone)]
pub struct Family {
    markers: Vec<Marker>,
}

/// One marker and what it looks like.
#[derive(Debug, Clone)]
struct Marker {
    name: String,
    /// One for each of [`PLATES_PX`]; the smallest plates may show nothing.
    references: Vec<Option<Reference>>,
    /// Points of the plate that are clearly light or clearly dark.
    pattern: Vec<PatternPoint>,
}

/// What a marker looks like on plates of one size, upright.
#[derive(Debug, Clone)]
struct Reference {
    descriptor: Descriptor,
    /// Side of the plate over the descriptor's size.
    plate_per_size: f32,
    /// From the figure's centre of area to the plate's centre, in units of the descriptor's size.
    centre_from_figure: [f32; 2],
    /// Area of the plate over the figure's.
    plate_area_per_figure: f32,
}

/// A point of the plate, in units of its side, from its centre.
#[derive(Debug, Clone, Copy)]
struct PatternPoint {
    at: [f32; 2],
    dark: bool,
}

impl Family {
    /// Learns what drawings look like.
    ///
    /// # Errors
    ///
    /// [`FamilyError`] when a drawing shows no direction, or two look alike.
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
    /// [`FamilyError`] when a file is no marker, or the family cannot be told apart.
    pub fn from_files(files: &[MarkerFile]) -> Result<Self, FamilyError> {
        let mut drawings = Vec::with_capacity(files.len());
        for file in files {
            if file.name.len() > NAME_MAX {
                return Err(FamilyError::NameTooLong {
                    name: file.name.clone(),
                });
            }
            drawings.push(read_drawing(&file.name, &file.svg)?);
        }
        Self::learn(&drawings)
    }

    /// Name of a marker.
    ///
    /// # Panics
    ///
    /// When the family has no such marker.
    #[must_use]
    pub fn name(&self, marker: usize) -> &str {
        &self.markers[marker].name
    }

    /// Which marker a figure is, and its pose; `None` when it is none.
    pub(crate) fn recognise(
        &self,
        figure: &Figure<'_>,
        cutout: Cutout<'_>,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        let descriptor = describe(&resample(figure.contour), ELONGATION_MIN / 2.0).ok()?;
        let (marker, reference, found) = self
            .markers
            .iter()
            .enumerate()
            .filter_map(|(index, marker)| {
                let reference = marker.reference(descriptor.size_px)?;
                Some((
                    index,
                    reference,
                    compare(&descriptor, &reference.descriptor),
                ))
            })
            .min_by(|(.., a), (.., b)| a.distance.total_cmp(&b.distance))?;
        let plate_px = descriptor.size_px * reference.plate_per_size;
        let plate_area =
            figure.plate_area_px2 as f32 / figure.region.area / reference.plate_area_per_figure;
        let size_fits = (settings.plate_min_px..=settings.plate_max_px).contains(&plate_px)
            && plate_area > PLATE_AREA_MIN;
        if found.distance > settings.distance_max || !size_fits {
            return None;
        }
        let (sin, cos) = found.turn_rad.sin_cos();
        let [dx, dy] = reference.centre_from_figure.map(|d| d * descriptor.size_px);
        let centre = [
            figure.region.centre[0] + cos * dx - sin * dy,
            figure.region.centre[1] + sin * dx + cos * dy,
        ];
        if self.markers[marker].agreement(figure, cutout, centre, (sin, cos), plate_px)
            < settings.pattern_min
        {
            return None;
        }
        // What the reference does not explain is noise of N points, by which the mean of the points errs in both axes and the turn by
        // the same amount over the size.
        let error_px =
            descriptor.size_px * (found.distance / (2.0 * N as f32)).sqrt() + SIGMA_FLOOR_PX;
        Some(Recognised {
            marker,
            centre,
            // The drawing points up, against the y axis.
            heading_rad: wrapped(found.turn_rad - std::f32::consts::FRAC_PI_2),
            plate_px,
            distance: found.distance,
            centre_sigma_px: error_px,
            heading_sigma_rad: error_px / descriptor.size_px,
        })
    }
}

/// A bare plate's area for that of its figure, against the reference: less means that the plate is not whole.
const PLATE_AREA_MIN: f32 = 0.75;

/// Errors that do not show in the distance: position of the pixel grid, unknown blur.
const SIGMA_FLOOR_PX: f32 = 0.02;

impl Marker {
    fn learn(drawing: &Drawing) -> Result<Self, FamilyError> {
        let name = drawing.name.clone();
        let references: Vec<_> = PLATES_PX
            .iter()
            .map(|&plate_px| match Reference::learn(drawing, plate_px) {
                Ok(reference) => Ok(Some(reference)),
                Err(NoReference::Orientation(elongation)) if plate_px >= CLEAR_PLATE_PX => {
                    Err(FamilyError::NoOrientation {
                        name: name.clone(),
                        elongation,
                    })
                }
                Err(NoReference::Unseen) if plate_px >= CLEAR_PLATE_PX => {
                    Err(FamilyError::Unseen {
                        name: name.clone(),
                        plate_px,
                    })
                }
                Err(_) => Ok(None),
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            name,
            references,
            pattern: pattern(drawing),
        })
    }

    /// The descriptor that neither pixels nor blur have changed much.
    fn clearest(&self) -> &Descriptor {
        let reference = self.references.iter().rev().flatten().next();
        &reference
            .unwrap_or_else(|| unreachable!("a marker is learned with its large plates"))
            .descriptor
    }

    /// The reference of the nearest size.
    fn reference(&self, size_px: f32) -> Option<&Reference> {
        let distance = |r: &&Reference| (r.descriptor.size_px / size_px).ln().abs();
        self.references
            .iter()
            .flatten()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Share of the pattern's points that are light or dark in the picture as they are in the drawing.
    fn agreement(
        &self,
        figure: &Figure<'_>,
        cutout: Cutout<'_>,
        centre: [f32; 2],
        (sin, cos): (f32, f32),
        plate_px: f32,
    ) -> f32 {
        let agrees = |point: &&PatternPoint| {
            let [u, v] = point.at.map(|c| c * plate_px);
            let x = (centre[0] + cos * u - sin * v).round();
            let y = (centre[1] + sin * u + cos * v).round();
            let (width, height) = (cutout.size.width as f32, cutout.size.height as f32);
            x >= 0.0 && y >= 0.0 && x < width && y < height && {
                let grey = cutout.grey[y as usize * cutout.size.width + x as usize];
                (f32::from(grey) < figure.split.threshold) == point.dark
            }
        };
        self.pattern.iter().filter(agrees).count() as f32 / self.pattern.len().max(1) as f32
    }
}

/// From this plate on every marker must be readable.
const CLEAR_PLATE_PX: f32 = 32.0;

/// Why a rendered plate gives no reference.
enum NoReference {
    Unseen,
    Orientation(f32),
}

impl Reference {
    /// Mean over all turns of what is measured on a rendered plate.
    fn learn(drawing: &Drawing, plate_px: f32) -> Result<Self, NoReference> {
        let upright = measure(drawing, plate_px, 0.0)?;
        let mut coefficients = [Complex32::default(); N];
        let (mut size_px, mut orientation, mut area, mut plate_area) = (0.0, 0.0, 0.0, 0.0);
        let mut centre = [0.0; 2];
        for i in 0..TURNS {
            let turn = std::f32::consts::TAU * i as f32 / TURNS as f32;
            let seen = measure(drawing, plate_px, turn)?;
            let [same, half_turn] = distances(&seen.descriptor, &upright.descriptor);
            let sign = if half_turn < same { -1.0 } else { 1.0 };
            for (k, (mean, c)) in coefficients
                .iter_mut()
                .zip(seen.descriptor.coefficients)
                .enumerate()
            {
                *mean += c * if k % 2 == 0 { sign } else { 1.0 };
            }
            // Relative to the first one, and up to half turns, so that the mean is one of neighbouring angles.
            let relative =
                seen.descriptor.orientation_rad - turn - upright.descriptor.orientation_rad;
            orientation += nearest_half_turn(relative);
            size_px += seen.descriptor.size_px;
            area += seen.figure_area;
            plate_area += seen.plate_area;
            let (sin, cos) = turn.sin_cos();
            let [x, y] = seen.centre_from_figure;
            centre[0] += cos * x + sin * y;
            centre[1] += cos * y - sin * x;
        }
        let n = TURNS as f32;
        let size = size_px / n;
        let descriptor = Descriptor {
            coefficients: coefficients.map(|c| c / n),
            size_px: size,
            orientation_rad: upright.descriptor.orientation_rad + orientation / n,
            ..upright.descriptor
        };
        if descriptor.elongation() < ELONGATION_MIN {
            return Err(NoReference::Orientation(descriptor.elongation()));
        }
        Ok(Self {
            descriptor,
            plate_per_size: plate_px / size,
            centre_from_figure: centre.map(|c| c / n / size),
            plate_area_per_figure: plate_area / area,
        })
    }
}

/// An angle brought to within a quarter turn of zero by adding half turns.
fn nearest_half_turn(angle_rad: f32) -> f32 {
    wrapped(2.0 * angle_rad) / 2.0
}

/// What is measured on one rendered plate.
struct Measured {
    descriptor: Descriptor,
    figure_area: f32,
    plate_area: f32,
    centre_from_figure: [f32; 2],
}

/// Renders a plate and measures it as a live frame is measured.
fn measure(drawing: &Drawing, plate_px: f32, turn_rad: f32) -> Result<Measured, NoReference> {
    let side = (plate_px * 1.5) as usize + 8;
    let size = Size {
        width: side,
        height: side,
    };
    // Off the middle of a pixel by a different amount for each turn.
    let centre = [
        side as f32 / 2.0 + 0.3 * turn_rad.cos(),
        side as f32 / 2.0 + 0.3 * turn_rad.sin(),
    ];
    let grey = render(drawing, size, centre, turn_rad, plate_px);
    let cutout = Cutout {
        size,
        grey: &grey,
        mask: &vec![1; size.area()],
    };
    let mut measured = Err(NoReference::Unseen);
    find_figures(cutout, &mut CutoutScratch::new(size), |figure| {
        measured = match describe(&resample(figure.contour), ELONGATION_MIN / 2.0) {
            Ok(descriptor) => Ok(Measured {
                descriptor,
                figure_area: figure.region.area,
                plate_area: figure.plate_area_px2 as f32,
                centre_from_figure: [
                    centre[0] - figure.region.centre[0],
                    centre[1] - figure.region.centre[1],
                ],
            }),
            Err(NoDescriptor::NoOrientation { elongation }) => {
                Err(NoReference::Orientation(elongation))
            }
            Err(NoDescriptor::NoExtent) => Err(NoReference::Unseen),
        };
    });
    measured
}

/// Draws a plate with its marker on grey.
fn render(
    drawing: &Drawing,
    size: Size,
    centre: [f32; 2],
    turn_rad: f32,
    plate_px: f32,
) -> Vec<u8> {
    const FLOOR: f32 = 110.0;
    const PAPER: f32 = 225.0;
    const INK: f32 = 35.0;
    let mut plane = vec![FLOOR; size.area()];
    let mut scratch = vec![0.0; size.area()];
    for (outline, level) in [(&PLATE[..], PAPER), (&drawing.outline[..], INK)] {
        let polygon = placed(outline, centre, turn_rad, plate_px);
        fill_polygon(&polygon, size, &mut scratch);
        for (pixel, share) in plane.iter_mut().zip(&scratch) {
            *pixel += share * (level - *pixel);
        }
    }
    blur(&mut plane, size, LENS_BLUR_PX, &mut scratch);
    plane.iter().map(|v| v.round() as u8).collect()
}

/// The plate's outline, in units of its side.
pub(crate) const PLATE: [Vertex; 4] = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];

/// A drawing's outline turned, scaled and moved into a picture.
pub(crate) fn placed(
    outline: &[Vertex],
    centre: [f32; 2],
    turn_rad: f32,
    scale: f32,
) -> Vec<Vertex> {
    let (sin, cos) = turn_rad.sin_cos();
    let place = |&[x, y]: &Vertex| {
        [
            centre[0] + scale * (cos * x - sin * y),
            centre[1] + scale * (sin * x + cos * y),
        ]
    };
    outline.iter().map(place).collect()
}

/// Points of the plate whose neighbourhood is all light or all dark.
fn pattern(drawing: &Drawing) -> Vec<PatternPoint> {
    // A picture of the plate in which a point's neighbourhood is 5 x 5 pixels.
    const PIXELS: usize = PATTERN * 5;
    let size = Size {
        width: PIXELS,
        height: PIXELS,
    };
    let middle = (PIXELS as f32 - 1.0) / 2.0;
    let polygon = placed(&drawing.outline, [middle, middle], 0.0, PIXELS as f32);
    let mut coverage = vec![0.0; size.area()];
    fill_polygon(&polygon, size, &mut coverage);
    let mut points = Vec::new();
    // The outermost points lie where the plate ends and blur mixes in what is outside.
    for row in 1..PATTERN - 1 {
        for column in 1..PATTERN - 1 {
            let cell = |i: usize| coverage[(row * 5 + i / 5) * PIXELS + column * 5 + i % 5];
            let covered: f32 = (0..25).map(cell).sum::<f32>() / 25.0;
            if covered < 0.01 || covered > 0.99 {
                let at = [column, row].map(|i| ((i * 5 + 2) as f32 - middle) / PIXELS as f32);
                points.push(PatternPoint {
                    at,
                    dark: covered > 0.5,
                });
            }
        }
    }
    points
}

/// The built-in family's files.
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

/// Reads the SVG files of a folder, in the order of their names.
///
/// # Errors
///
/// [`FamilyError::Unreadable`] and [`FamilyError::Empty`].
pub fn read_folder(folder: &Path) -> Result<Vec<MarkerFile>, FamilyError> {
    let unreadable = |path: &Path, error: std::io::Error| FamilyError::Unreadable {
        folder: path.display().to_string(),
        reason: error.to_string(),
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| unreadable(folder, e))? {
        let path = entry.map_err(|e| unreadable(folder, e))?.path();
        let is_svg = path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("svg"));
        if let Some(name) = path.file_stem().filter(|_| is_svg) {
            let svg = std::fs::read_to_string(&path).map_err(|e| unreadable(&path, e))?;
            files.push(MarkerFile {
                name: name.to_string_lossy().into_owned(),
                svg,
            });
        }
    }
    if files.is_empty() {
        return Err(FamilyError::Empty {
            folder: folder.display().to_string(),
        });
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: RecognitionSettings = RecognitionSettings {
        distance_max: 0.01,
        plate_min_px: 8.0,
        plate_max_px: 200.0,
        pattern_min: 0.9,
    };

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
    #[ignore = "prints a table"]
    fn table() {
        let drawings: Vec<_> = BUILT_IN
            .iter()
            .map(|(n, s)| read_drawing(n, s).expect("drawing"))
            .collect();
        let markers: Vec<_> = drawings
            .iter()
            .map(|d| Marker::learn(d).map_err(|e| e.to_string()).expect("m"))
            .collect();
        for a in &markers {
            print!(
                "{:9} e {:.3} half {:.4} |",
                a.name,
                a.clearest().elongation(),
                distances(a.clearest(), a.clearest())[1]
            );
            for b in &markers {
                print!(" {:.4}", compare(a.clearest(), b.clearest()).distance);
            }
            println!();
        }
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
                let grey = render(&drawing, size, centre, turn, 30.0);
                let cutout = Cutout {
                    size,
                    grey: &grey,
                    mask: &vec![1; size.area()],
                };
                let mut found = Vec::new();
                find_figures(cutout, &mut CutoutScratch::new(size), |figure| {
                    found.extend(family.recognise(&figure, cutout, &SETTINGS));
                });
                let [pose] = found[..] else {
                    panic!("{name} at {turn}: {found:?}")
                };
                assert_eq!(
                    pose.marker,
                    index,
                    "{name} at {turn} is taken for {}",
                    family.name(pose.marker)
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
