//! A marker's drawing: the SVG file that a user prints, reduced to one outline.
//!
//! The view box is the plate, a square; up is the heading; on white stands exactly one dark, closed, filled shape. Whatever a
//! drawing program makes of that (groups, transforms, curves, style sheets) is resolved by `usvg`; here it is checked
//! that the result is one marker, and said what is wrong where it is not.

use std::fmt;

use usvg::tiny_skia_path::{PathSegment, Point, Transform};

/// Straight pieces that replace one curve of a path.
const PIECES_PER_CURVE: usize = 24;

/// By how much numbers in files and their sums may be off, in units of the plate's side.
const ROUNDING: f32 = 1e-3;

/// A marker that comes nearer than this to the edge of its plate cannot be counted on to be surrounded by light.
const EDGE: f32 = 0.03;

/// The outline of a marker on its plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Name of the marker.
    pub name: String,
    /// Corners in units of the plate's side: (0, 0) is the plate's centre, x right, y down, heading up. Clockwise.
    pub outline: Vec<[f32; 2]>,
}

impl Drawing {
    /// Whether the marker reaches the edge of its plate.
    pub(crate) fn touches(&self) -> bool {
        self.outline.iter().flatten().any(|c| c.abs() > 0.5 - EDGE)
    }
}

/// Why an SVG file is no marker.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("marker {name}: {reason}")]
pub struct DrawingError {
    /// Name of the marker.
    pub name: String,
    /// What is wrong, and how it should be.
    pub reason: Reason,
}

/// What is wrong with a drawing.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// Not SVG at all.
    NotSvg(String),
    /// The view box is not a square.
    NotSquare {
        /// Width of the view box.
        width: f32,
        /// Height of the view box.
        height: f32,
    },
    /// There must be one dark shape.
    DarkShapes(usize),
    /// The dark shape consists of several outlines.
    Outlines(usize),
    /// The dark shape has a stroke, which the outline would not include.
    Stroke,
    /// Text, pictures or gradients.
    NotAPlainShape(&'static str),
    /// The shape reaches out of the view box.
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
            Self::Outlines(n) => {
                write!(
                    f,
                    "the dark shape has {n} outlines, but holes and islands are not allowed; unite them into one"
                )
            }
            Self::Stroke => write!(
                f,
                "the dark shape has a stroke; convert it into a filled path"
            ),
            Self::NotAPlainShape(what) => {
                write!(f, "it contains {what}; use one plain, filled path")
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
/// [`DrawingError`] when the file is not one dark, closed, filled shape on a square.
pub fn read_drawing(name: &str, svg: &str) -> Result<Drawing, DrawingError> {
    let outline = outline(svg).map_err(|reason| DrawingError {
        name: name.to_owned(),
        reason,
    })?;
    Ok(Drawing {
        name: name.to_owned(),
        outline,
    })
}

fn outline(svg: &str) -> Result<Vec<[f32; 2]>, Reason> {
    let tree = usvg::Tree::from_str(svg, &usvg::Options::default())
        .map_err(|e| Reason::NotSvg(e.to_string()))?;
    let (width, height) = (tree.size().width(), tree.size().height());
    if (width - height).abs() > 1e-3 * width {
        return Err(Reason::NotSquare { width, height });
    }
    let mut dark = Vec::new();
    dark_paths(tree.root(), &mut dark)?;
    let [path] = dark[..] else {
        return Err(Reason::DarkShapes(dark.len()));
    };
    if path.stroke().is_some() {
        return Err(Reason::Stroke);
    }
    let mut outline = flatten(path)?;
    for point in &mut outline {
        *point = [point[0] / width - 0.5, point[1] / height - 0.5];
    }
    if outline.iter().flatten().any(|c| c.abs() > 0.5 + ROUNDING) {
        return Err(Reason::ReachesOut);
    }
    if fourier::contour::region(&outline).area < 0.0 {
        outline.reverse();
    }
    Ok(outline)
}

/// Collects the visible paths that are darker than half-way to white.
fn dark_paths<'a>(group: &'a usvg::Group, dark: &mut Vec<&'a usvg::Path>) -> Result<(), Reason> {
    for node in group.children() {
        match node {
            usvg::Node::Group(group) => dark_paths(group, dark)?,
            usvg::Node::Path(path) if path.is_visible() => {
                let fill = path.fill().map(|fill| is_dark(fill.paint())).transpose()?;
                let stroke = path
                    .stroke()
                    .map(|stroke| is_dark(stroke.paint()))
                    .transpose()?;
                if fill == Some(true) || stroke == Some(true) {
                    dark.push(path);
                }
            }
            usvg::Node::Path(_) => {}
            usvg::Node::Image(_) => return Err(Reason::NotAPlainShape("a picture")),
            usvg::Node::Text(_) => return Err(Reason::NotAPlainShape("text")),
        }
    }
    Ok(())
}

fn is_dark(paint: &usvg::Paint) -> Result<bool, Reason> {
    match paint {
        usvg::Paint::Color(colour) => {
            let luma = 299 * u32::from(colour.red)
                + 587 * u32::from(colour.green)
                + 114 * u32::from(colour.blue);
            Ok(luma < 128_000)
        }
        _ => Err(Reason::NotAPlainShape("a gradient or a pattern")),
    }
}

/// The corners of a path's only outline, curves as straight pieces, in units of the tree.
fn flatten(path: &usvg::Path) -> Result<Vec<[f32; 2]>, Reason> {
    let transform: Transform = path.abs_transform();
    let mut points: Vec<Point> = Vec::new();
    let mut outlines = 0;
    for segment in path.data().segments() {
        let from = points.last().copied().unwrap_or_default();
        let mut curve = |at: &dyn Fn(f32) -> Point| {
            points.extend((1..=PIECES_PER_CURVE).map(|i| at(i as f32 / PIECES_PER_CURVE as f32)));
        };
        match segment {
            PathSegment::MoveTo(point) => {
                outlines += 1;
                points.push(point);
            }
            PathSegment::LineTo(point) => points.push(point),
            PathSegment::QuadTo(c, to) => curve(&|t| bezier(&[from, c, to], t)),
            PathSegment::CubicTo(c1, c2, to) => curve(&|t| bezier(&[from, c1, c2, to], t)),
            PathSegment::Close => {}
        }
    }
    if outlines != 1 {
        return Err(Reason::Outlines(outlines));
    }
    transform.map_points(&mut points);
    points.dedup_by(|a, b| (*a - *b).length() < 1e-4);
    Ok(points.into_iter().map(|p| [p.x, p.y]).collect())
}

/// A point of a Bézier curve, by de Casteljau's repeated interpolation.
fn bezier(controls: &[Point], t: f32) -> Point {
    match controls {
        [] => Point::zero(),
        [point] => *point,
        _ => {
            let next: Vec<Point> = controls
                .windows(2)
                .map(|pair| {
                    Point::from_xy(
                        pair[0].x + t * (pair[1].x - pair[0].x),
                        pair[0].y + t * (pair[1].y - pair[0].y),
                    )
                })
                .collect();
            bezier(&next, t)
        }
    }
}

/// The file of an outline, which is given in units of the plate's side from its centre.
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
        assert!(reason("0 0 40 40", &square.repeat(2)).contains("2 dark shapes"));
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
}
