//! The drawing of a marker: the SVG file that the user prints, reduced to one outline.
//!
//! The view box is the plate, a square; up is the heading. On white there is exactly one dark,
//! closed, filled shape. The rendered image decides, because that is what is printed: `usvg`
//! resolves what drawing programs write (groups, transforms, curves, style sheets), `resvg` renders
//! it (`canvas`), and files with content that neither supports are rejected (`unread`).
//!
//! If the image shows just the outline of the one dark fill, as for most files, the marker is that
//! outline, with the precision of the file. If other elements cut or join shapes (clip paths, white
//! shapes above dark ones), the outline is traced from the image, to less than a ten thousandth of
//! the plate. Strokes and filters that change the image are rejected, and so are half-tones: their
//! shape would depend on the distance of the camera.

mod canvas;
mod content;
mod unread;

use std::fmt;

use usvg::roxmltree;

use crate::marker::drawing::canvas::{COMPARED, Canvas, TRACED};
use crate::marker::drawing::content::{Content, refuse_endless};

/// Tolerance for numbers in files and their sums, in units of the plate's side.
const ROUNDING: f32 = 1e-3;

/// A marker closer than this to the edge of its plate may not be surrounded by light.
const EDGE: f32 = 0.03;

/// The outline of a marker on its plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Name of the marker.
    pub name: String,
    /// Corners in units of the plate's side, clockwise: (0, 0) is the plate's centre, x right, y
    /// down, heading up.
    pub outline: Vec<[f32; 2]>,
}

impl Drawing {
    /// Whether the marker reaches the edge of its plate.
    pub(crate) fn touches(&self) -> bool {
        self.outline.iter().flatten().any(|c| c.abs() > 0.5 - EDGE)
    }
}

/// Rejection of an SVG file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("marker {name}: {reason}")]
pub struct DrawingError {
    /// Name of the marker.
    pub name: String,
    /// What is wrong, and how to correct it.
    pub reason: Reason,
}

/// The fault of a drawing.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// Not an SVG file.
    NotSvg(String),
    /// The view box is not a square.
    NotSquare {
        /// Width of the view box.
        width: f32,
        /// Height of the view box.
        height: f32,
    },
    /// The number of dark shapes is not one.
    DarkShapes(usize),
    /// The only dark shape is too faint; its opacity.
    Faint(f32),
    /// The dark shape consists of several outlines.
    Outlines(usize),
    /// All of the plate's border is dark.
    DarkPlate,
    /// Part of the drawing is neither as dark as the shape nor as light as the plate, and the
    /// element that causes it is unknown.
    HalfTones,
    /// The drawing contains an unsupported element, or one that changes the shape.
    NotRead {
        /// The element.
        what: String,
        /// The `id` of the element, if it has one.
        id: String,
        /// How to correct it.
        remedy: &'static str,
    },
    /// The shape extends beyond the view box.
    ReachesOut,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotSvg(error) => write!(f, "not a readable SVG file: {error}"),
            Self::NotSquare { width, height } => {
                write!(
                    f,
                    "the view box is {width} x {height}, but the plate must be a square"
                )
            }
            Self::DarkShapes(0) => write!(f, "no dark shape; draw one dark, filled path on white"),
            Self::DarkShapes(n) => write!(f, "{n} dark shapes; unite them into one path"),
            Self::Faint(opacity) => write!(
                f,
                "no dark shape: the one that is there has an opacity of {:.0} %; make it opaque",
                100.0 * opacity
            ),
            Self::Outlines(n) => {
                write!(
                    f,
                    "the dark shape has {n} outlines, but holes and islands are not allowed; unite them into one"
                )
            }
            Self::DarkPlate => write!(
                f,
                "the border of the plate is dark; draw a dark shape on a white plate"
            ),
            Self::HalfTones => write!(
                f,
                "it has half-tones, neither as dark as the shape nor as light as the plate; make them white or black"
            ),
            Self::NotRead { what, id, remedy } if id.is_empty() => {
                write!(f, "it contains {what}; {remedy}")
            }
            Self::NotRead { what, id, remedy } => {
                write!(f, "it contains {what}, id {id:?}; {remedy}")
            }
            Self::ReachesOut => write!(
                f,
                "the dark shape reaches out of the view box, which is the plate; make it smaller"
            ),
        }
    }
}

/// Reads a drawing from the text of an SVG file.
///
/// # Errors
///
/// [`DrawingError`] if the file is not one dark, closed, filled shape on a square.
pub fn read_drawing(name: &str, svg: &str) -> Result<Drawing, DrawingError> {
    let outline = outline_with_room(svg).map_err(|reason| DrawingError {
        name: name.to_owned(),
        reason,
    })?;
    Ok(Drawing {
        name: name.to_owned(),
        outline,
    })
}

/// Stack size in bytes: parser and renderer recurse for each nesting level, of which there may be a
/// thousand.
const STACK_BYTES: usize = 64 << 20;

/// Reads the outline in a thread with a large stack.
fn outline_with_room(svg: &str) -> Result<Vec<[f32; 2]>, Reason> {
    if unread::is_too_deep(svg) {
        let error = "its elements are nested too deep";
        return Err(Reason::NotSvg(error.to_owned()));
    }
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK_BYTES);
        match thread
            .spawn_scoped(scope, || outline(svg))
            .map(|t| t.join())
        {
            Ok(Ok(outline)) => outline,
            // A panic of the renderer is reported as a fault of the drawing, which the user can
            // change.
            Ok(Err(_)) => Err(Reason::NotSvg("it cannot be drawn".to_owned())),
            Err(error) => Err(Reason::NotSvg(error.to_string())),
        }
    })
}

fn outline(svg: &str) -> Result<Vec<[f32; 2]>, Reason> {
    let tree = tree(svg)?;
    let (width, height) = (tree.size().width(), tree.size().height());
    if (width - height).abs() > 1e-3 * width {
        return Err(Reason::NotSquare { width, height });
    }
    let content = Content::of(&tree);
    if let Some(unread) = content.unread {
        return Err(unread.into());
    }
    refuse_endless(&tree)?;
    let canvas = Canvas::draw(&tree, COMPARED);
    if let (Some(canvas), [outline]) = (&canvas, &content.outlines[..])
        && outline.iter().flatten().all(|c| c.abs() <= 0.5 + ROUNDING)
        && canvas.shows(outline, content.is_drawn_again)
    {
        return Ok(outline.clone());
    }
    // A stroke or a filter causes the difference.
    if let Some(feature) = content.stroke.or(content.filter) {
        return Err(feature.into());
    }
    let Some(canvas) = canvas else {
        return Err(match (content.faint, content.shading) {
            (Some(opacity), _) => Reason::Faint(opacity),
            // For example a mask without light pixels.
            (None, Some(shading)) if content.has_dark => shading.into(),
            _ => Reason::DarkShapes(0),
        });
    };
    let figures = canvas.figures();
    if figures.fills_plate {
        return Err(Reason::DarkPlate);
    }
    if canvas.has_half_tones() {
        return Err(content.shading.map_or(Reason::HalfTones, Reason::from));
    }
    match (figures.regions, figures.holes) {
        (1, 0) => {}
        (1, holes) => return Err(Reason::Outlines(1 + holes)),
        (regions, _) => return Err(Reason::DarkShapes(regions)),
    }
    if figures.reaches_out {
        return Err(Reason::ReachesOut);
    }
    let fine = Canvas::draw(&tree, TRACED).ok_or(Reason::DarkShapes(0))?;
    fine.outline(&fine.figures()).ok_or(Reason::ReachesOut)
}

/// The tree to draw, with stand-ins for elements that cannot be drawn.
fn tree(svg: &str) -> Result<usvg::Tree, Reason> {
    let options = roxmltree::ParsingOptions {
        allow_dtd: true,
        ..Default::default()
    };
    let not_svg = |error: String| Reason::NotSvg(error);
    let document = roxmltree::Document::parse_with_options(svg, options)
        .map_err(|e| not_svg(e.to_string()))?;
    unread::refuse(&document)?;
    let options = usvg::Options {
        image_href_resolver: unread::image_resolver(),
        ..usvg::Options::default()
    };
    let tree = match unread::with_stand_ins(svg, &document)? {
        Some(svg) => usvg::Tree::from_str(&svg, &options),
        None => usvg::Tree::from_xmltree(&document, &options),
    };
    tree.map_err(|e| not_svg(e.to_string()))
}

/// The SVG file of an outline given in units of the plate's side from its centre.
pub(crate) fn svg_of(outline: &[[f32; 2]]) -> String {
    let corner = |[x, y]: &[f32; 2]| format!("{:.2} {:.2}", 50.0 + 100.0 * x, 50.0 + 100.0 * y);
    let corners: Vec<String> = outline.iter().map(corner).collect();
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"80mm\" height=\"80mm\" viewBox=\"0 0 100 100\">\n  \
         <rect width=\"100\" height=\"100\" fill=\"#fff\"/>\n  <path fill=\"#000\" d=\"M{}Z\"/>\n</svg>\n",
        corners.join("L")
    )
}

#[cfg(test)]
mod kinds;

#[cfg(test)]
mod tests {
    use super::*;

    fn svg(view_box: &str, content: &str) -> String {
        format!(r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view_box}">{content}</svg>"#)
    }

    fn reason(view_box: &str, content: &str) -> String {
        read_drawing("test", &svg(view_box, content))
            .expect_err("it is no marker")
            .to_string()
    }

    #[test]
    fn groups_transforms_and_direction_are_resolved() {
        let content = r##"<rect width="40" height="40" fill="#ffffff"/>
            <g transform="translate(20 20)"><path style="fill:navy" d="M-10 10 L10 10 L0 -10 Z"/></g>"##;
        let drawing = read_drawing("triangle", &svg("0 0 40 40", content)).expect("it is a marker");
        assert_eq!(drawing.name, "triangle");
        assert_eq!(drawing.outline.len(), 3);
        assert!(fourier::contour::region(&drawing.outline).area > 0.0);
        assert!(drawing.outline.contains(&[0.0, -0.25]));
    }

    #[test]
    fn curves_are_followed() {
        let drawing = read_drawing(
            "disc",
            &svg("0 0 100 100", r#"<circle cx="50" cy="50" r="30"/>"#),
        )
        .expect("a disc");
        let area = fourier::contour::region(&drawing.outline).area;
        assert!((area - std::f32::consts::PI * 0.09).abs() < 2e-3, "{area}");
    }

    #[test]
    fn what_is_no_marker_is_refused_with_the_reason() {
        let square = r#"<rect x="10" y="10" width="20" height="20"/>"#;
        assert_eq!(
            reason("0 0 40 30", square),
            "marker test: the view box is 40 x 30, but the plate must be a square"
        );
        assert!(reason("0 0 40 40", "").contains("no dark shape"));
        let two = format!("{square}{}", square.replace("10", "3").replace("20", "5"));
        assert!(reason("0 0 40 40", &two).contains("2 dark shapes"));
        assert!(reason("0 0 19 19", square).contains("reaches out of the view box"));
        let holed = r#"<path fill-rule="evenodd" d="M5 5H35V35H5Z M10 10H30V30H10Z"/>"#;
        assert!(reason("0 0 40 40", holed).contains("2 outlines"));
        let line = r##"<path d="M5 5 L30 30" stroke="#000" fill="none"/>"##;
        assert!(reason("0 0 40 40", line).contains("stroke"));
        assert!(
            read_drawing("test", "hello")
                .expect_err("no SVG")
                .to_string()
                .contains("not a readable SVG")
        );
    }

    /// The outlines of the built-in markers, bit by bit; recordings depend on them.
    #[test]
    fn built_in_outlines_never_change() {
        let mut sum = 0xcbf2_9ce4_8422_2325_u64;
        for (name, svg) in crate::marker::BUILT_IN {
            let outline = read_drawing(name, svg).expect("a marker").outline;
            for byte in outline.iter().flatten().flat_map(|c| c.to_le_bytes()) {
                sum = (sum ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
            }
        }
        assert_eq!(sum, 0xae40_87a2_8801_bc70, "{sum:#x}");
    }
}
