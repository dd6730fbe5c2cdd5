//! The content of a drawing as resolved by `usvg`: the outlines of its dark fills, and everything
//! that may make the image differ from them.

use usvg::filter::{Filter, Kind};
use usvg::tiny_skia_path::{PathSegment, Point, Rect};
use usvg::{Group, Node, Paint, Path};

use crate::marker::drawing::{Reason, unread};

/// Number of line segments that approximate a curve.
const PIECES_PER_CURVE: usize = 24;

/// Outlines with a smaller area, in units of the plate, are ignored: a filled line, a move at the
/// end of a path.
const AREA_MIN: f32 = 1e-6;

/// A fill that darkens by less than this is invisible.
const FAINT: f32 = 0.02;

/// A stroke that changes the brightness by less than this is a guide line.
const FAINT_STROKE: f32 = 0.25;

/// Maximum number of shapes and groups, including those in masks, patterns and clip paths. A marker
/// has few, and each may cost a millisecond.
const NODES_MAX: usize = 2000;

/// Maximum nesting depth of groups that need an image of their own, for an opacity or a mask; other
/// groups are already resolved.
const DEPTH_MAX: usize = 24;

/// Maximum size of a group that needs an image of its own, in plates: pixels are counted in 32
/// bits.
const SIZE_MAX: f32 = 10_000.0;

/// An element other than a plain fill.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Feature {
    pub(super) what: &'static str,
    pub(super) id: String,
    pub(super) remedy: &'static str,
}

/// The content of the plate.
#[derive(Debug, Default)]
pub(super) struct Content {
    /// Visible dark fills, with curves as line segments, in units of the plate's side from its
    /// centre.
    pub(super) outlines: Vec<Vec<[f32; 2]>>,
    /// Whether one of them is drawn twice, which makes its borders darker.
    pub(super) is_drawn_again: bool,
    /// Visible content that is not supported: text, pictures.
    pub(super) unread: Option<Feature>,
    /// The first stroke that may change the shape.
    pub(super) stroke: Option<Feature>,
    /// The first filter.
    pub(super) filter: Option<Feature>,
    /// The first other element that may cause half-tones.
    pub(super) shading: Option<Feature>,
    /// Opacity of the darkest fill that is light only because of its opacity.
    pub(super) faint: Option<f32>,
    /// Whether something dark has been drawn so far.
    pub(super) has_dark: bool,
}

impl Content {
    pub(super) fn of(tree: &usvg::Tree) -> Self {
        let mut content = Self::default();
        let (width, height) = (tree.size().width(), tree.size().height());
        let walk = Walk { width, height };
        walk.group(tree.root(), 1.0, &mut content);
        content
    }
}

/// Rejects files that would take minutes or gigabytes to render.
pub(super) fn refuse_endless(tree: &usvg::Tree) -> Result<(), Reason> {
    let mut left = NODES_MAX;
    let largest = SIZE_MAX * tree.size().width().max(tree.size().height());
    refuse_endless_group(tree.root(), largest, 0, &mut left)?;
    // For these filters, one number determines the time per pixel.
    let is_slow = |filter: &&std::sync::Arc<Filter>| {
        filter.primitives().iter().any(|primitive| {
            matches!(
                primitive.kind(),
                Kind::ConvolveMatrix(_)
                    | Kind::DiffuseLighting(_)
                    | Kind::DisplacementMap(_)
                    | Kind::Morphology(_)
                    | Kind::SpecularLighting(_)
                    | Kind::Turbulence(_)
            )
        })
    };
    match tree.filters().iter().find(is_slow) {
        Some(filter) => Err(Reason::NotRead {
            what: "a filter".to_owned(),
            id: filter.id().to_owned(),
            remedy: "remove it",
        }),
        None => Ok(()),
    }
}

/// `left` is the number of nodes still allowed, `largest` the maximum width and height of a group.
fn refuse_endless_group(
    group: &Group,
    largest: f32,
    depth: usize,
    left: &mut usize,
) -> Result<(), Reason> {
    let refused = |what: String| Reason::NotRead {
        what,
        id: group.id().to_owned(),
        remedy: "unite what is to be printed into one path",
    };
    let bounds = group.abs_layer_bounding_box();
    if group.should_isolate() && bounds.width().max(bounds.height()) > largest {
        return Err(refused(format!(
            "something more than {SIZE_MAX} times as large as the plate"
        )));
    }
    if depth > DEPTH_MAX {
        return Err(refused(format!("groups more than {DEPTH_MAX} deep")));
    }
    for node in group.children() {
        if *left == 0 {
            return Err(refused(format!("more than {NODES_MAX} shapes")));
        }
        *left -= 1;
        let mut result = match node {
            Node::Group(group) => refuse_endless_group(group, largest, depth + 1, left),
            _ => Ok(()),
        };
        node.subroots(|root| {
            if result.is_ok() {
                result = refuse_endless_group(root, largest, depth + 1, left);
            }
        });
        result?;
    }
    Ok(())
}

/// The plate to search for content, in units of the tree.
struct Walk {
    width: f32,
    height: f32,
}

impl Walk {
    fn is_on_plate(&self, bounds: Rect) -> bool {
        bounds.left() < self.width
            && bounds.top() < self.height
            && bounds.right() > 0.0
            && bounds.bottom() > 0.0
    }

    fn group(&self, group: &Group, opacity: f32, content: &mut Content) {
        let opacity = opacity * group.opacity().get();
        if opacity < FAINT {
            return;
        }
        let named = |what, remedy| Feature {
            what,
            id: group.id().to_owned(),
            remedy,
        };
        if !group.filters().is_empty() && content.filter.is_none() {
            content.filter = Some(named("a filter", "remove it"));
        }
        if group.mask().is_some() {
            let mask = named("a mask", "cut the shape itself");
            content.shading.get_or_insert(mask);
        }
        if group.blend_mode() != usvg::BlendMode::Normal {
            let blend = named("a blend mode", "use plain fills");
            content.shading.get_or_insert(blend);
        }
        if group.opacity().get() < 1.0 {
            let half = named("an opacity", "make it opaque or remove it");
            content.shading.get_or_insert(half);
        }
        for node in group.children() {
            match node {
                Node::Group(group) => self.group(group, opacity, content),
                Node::Path(path) if path.is_visible() => self.path(path, opacity, content),
                Node::Image(image) if image.is_visible() => self.image(image, group, content),
                // Text is not in the tree itself; it is found as a path.
                Node::Path(_) | Node::Image(_) | Node::Text(_) => {}
            }
        }
    }

    fn image(&self, image: &usvg::Image, group: &Group, content: &mut Content) {
        let [what, remedy] = if unread::is_foreign(image) {
            ["embedded HTML (foreignObject)", "draw it as a path"]
        } else if self.is_on_plate(image.abs_bounding_box()) {
            ["a picture", "trace it into a path, or remove it"]
        } else {
            return;
        };
        content.unread.get_or_insert(Feature {
            what,
            id: group.id().to_owned(),
            remedy,
        });
    }

    fn path(&self, path: &Path, opacity: f32, content: &mut Content) {
        let named = |what, remedy| Feature {
            what,
            id: path.id().to_owned(),
            remedy,
        };
        let fill = path.fill().filter(|f| f.opacity().get() * opacity >= FAINT);
        let stroke = path
            .stroke()
            .filter(|s| s.opacity().get() * opacity >= FAINT);
        if unread::is_text(path) {
            if fill.is_some() || stroke.is_some() {
                let text = named("text", unread::CONVERT_TEXT);
                content.unread.get_or_insert(text);
            }
            return;
        }
        if !self.is_on_plate(path.abs_stroke_bounding_box()) {
            return;
        }
        if let Some(fill) = fill {
            let opacity = opacity * fill.opacity().get();
            match paint_luma(fill.paint()) {
                Some(luma) if is_dark(darkened(luma, opacity)) => {
                    content.has_dark = true;
                    self.outlines(path, content);
                }
                Some(luma) if is_dark(luma) => {
                    content.faint = Some(content.faint.unwrap_or(0.0).max(opacity));
                    let half = named("an opacity", "make it opaque or remove it");
                    content.shading.get_or_insert(half);
                }
                Some(_) => {}
                None => {
                    content.has_dark = true;
                    let shaded = named(paint_name(fill.paint()), "use a plain fill");
                    content.shading.get_or_insert(shaded);
                }
            }
        }
        if let Some(stroke) = stroke {
            let opacity = opacity * stroke.opacity().get();
            let dark = paint_luma(stroke.paint()).is_none_or(|luma| luma < 1.0 - FAINT_STROKE);
            // A light stroke is invisible on white, but cuts into dark shapes below it.
            if opacity > FAINT_STROKE && (dark || content.has_dark) {
                let stroke = named("a stroke", "convert it into a filled path");
                content.stroke.get_or_insert(stroke);
            }
        }
    }

    /// Adds the visible outlines of a path that are not yet included.
    fn outlines(&self, path: &Path, content: &mut Content) {
        for mut outline in flatten(path) {
            for point in &mut outline {
                *point = [point[0] / self.width - 0.5, point[1] / self.height - 0.5];
            }
            let area = fourier::contour::region(&outline).area;
            if outline.len() < 3 || area.abs() < AREA_MIN {
                continue;
            }
            if area < 0.0 {
                outline.reverse();
            }
            if content.outlines.contains(&outline) {
                content.is_drawn_again = true;
            } else {
                content.outlines.push(outline);
            }
        }
    }
}

/// Luma of a plain paint on white, 0 to 1.
fn paint_luma(paint: &Paint) -> Option<f32> {
    match paint {
        Paint::Color(colour) => Some(luma([colour.red, colour.green, colour.blue]) / 255.0),
        _ => None,
    }
}

fn paint_name(paint: &Paint) -> &'static str {
    match paint {
        Paint::Pattern(_) => "a pattern",
        _ => "a gradient",
    }
}

/// Luma of a colour, 0 to 255.
pub(super) fn luma([red, green, blue]: [u8; 3]) -> f32 {
    (299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue)) as f32 / 1000.0
}

/// Luma of a paint with an opacity on white paper.
fn darkened(luma: f32, opacity: f32) -> f32 {
    1.0 - opacity * (1.0 - luma)
}

/// Closer to black than to white.
fn is_dark(luma: f32) -> bool {
    luma < 128.0 / 255.0
}

/// The corners of a path's outlines, with curves as line segments, in units of the tree.
fn flatten(path: &Path) -> Vec<Vec<[f32; 2]>> {
    let mut outlines: Vec<Vec<Point>> = Vec::new();
    for segment in path.data().segments() {
        if let PathSegment::MoveTo(point) = segment {
            outlines.push(vec![point]);
            continue;
        }
        let Some(points) = outlines.last_mut() else {
            continue;
        };
        let from = points.last().copied().unwrap_or_default();
        let mut curve = |at: &dyn Fn(f32) -> Point| {
            points.extend((1..=PIECES_PER_CURVE).map(|i| at(i as f32 / PIECES_PER_CURVE as f32)));
        };
        match segment {
            PathSegment::MoveTo(_) | PathSegment::Close => {}
            PathSegment::LineTo(point) => points.push(point),
            PathSegment::QuadTo(c, to) => curve(&|t| bezier(&[from, c, to], t)),
            PathSegment::CubicTo(c1, c2, to) => curve(&|t| bezier(&[from, c1, c2, to], t)),
        }
    }
    let transform = path.abs_transform();
    for points in &mut outlines {
        transform.map_points(points);
        points.dedup_by(|a, b| (*a - *b).length() < 1e-4);
    }
    let plain = |points: Vec<Point>| points.into_iter().map(|p| [p.x, p.y]).collect();
    outlines.into_iter().map(plain).collect()
}

/// A point of a Bézier curve, by de Casteljau's algorithm.
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

impl From<Feature> for Reason {
    fn from(feature: Feature) -> Self {
        Self::NotRead {
            what: feature.what.to_owned(),
            id: feature.id,
            remedy: feature.remedy,
        }
    }
}
