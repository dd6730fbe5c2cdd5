//! Things that stand on the floor: a shape, its colours, a place.

use crate::random::at_point;

/// Distance from the origin; `hypot` guards against overflow, at ten times the price.
fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

/// Turns points of the picture into those of a shape with this centre and heading.
pub(crate) fn to_local(at: [f32; 2], heading_rad: f32) -> impl Fn([f32; 2]) -> [f32; 2] {
    let (sin, cos) = heading_rad.sin_cos();
    move |[x, y]| {
        let (dx, dy) = (x - at[0], y - at[1]);
        [cos * dx + sin * dy, cos * dy - sin * dx]
    }
}

/// A shape about its own centre. Lengths are pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// Radius.
    Disc(f32),
    /// Width and height.
    Box(f32, f32),
    /// Two arms of the first length and the second width.
    L(f32, f32),
    /// Outer and inner radius: something with a hole.
    Ring(f32, f32),
}

impl Shape {
    /// Distance from the edge, negative inside.
    pub(crate) fn distance(self, [x, y]: [f32; 2]) -> f32 {
        let rectangle = |cx: f32, cy: f32, w: f32, h: f32| {
            let (dx, dy) = ((x - cx).abs() - w / 2.0, (y - cy).abs() - h / 2.0);
            length([dx.max(0.0), dy.max(0.0)]) + dx.max(dy).min(0.0)
        };
        match self {
            Self::Disc(radius) => length([x, y]) - radius,
            Self::Box(w, h) => rectangle(0.0, 0.0, w, h),
            Self::L(arm, width) => {
                let shift = (arm - width) / 2.0;
                rectangle(-shift, 0.0, width, arm).min(rectangle(0.0, shift, arm, width))
            }
            Self::Ring(outer, inner) => (length([x, y]) - outer).max(inner - length([x, y])),
        }
    }

    /// As [`Shape::distance`], from the outer edge: a hole belongs to the object.
    pub(crate) fn outer_distance(self, point: [f32; 2]) -> f32 {
        match self {
            Self::Ring(outer, _) => Self::Disc(outer).distance(point),
            _ => self.distance(point),
        }
    }

    /// Greatest distance of a point of the shape from its centre.
    pub(crate) fn reach(self) -> f32 {
        match self {
            Self::Disc(radius) | Self::Ring(radius, _) => radius,
            Self::Box(w, h) => w.hypot(h) / 2.0,
            Self::L(arm, _) => arm * std::f32::consts::FRAC_1_SQRT_2,
        }
    }
}

/// Grey values of red, green and blue under full light.
pub(crate) type Colour = [f32; 3];

pub(crate) const WHITE: Colour = [232.0, 232.0, 228.0];
pub(crate) const BLACK: Colour = [16.0, 16.0, 17.0];
pub(crate) const RED: Colour = [205.0, 40.0, 38.0];
pub(crate) const GREEN: Colour = [44.0, 150.0, 58.0];
pub(crate) const BLUE: Colour = [40.0, 72.0, 185.0];
pub(crate) const BROWN: Colour = [84.0, 60.0, 52.0];
pub(crate) const YELLOW: Colour = [214.0, 190.0, 40.0];

/// How a body is coloured.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Paint {
    Plain(Colour),
    /// Left and right half.
    Halves(Colour, Colour),
    /// A stripe of the second colour and the given width across the middle.
    Striped(Colour, Colour, f32),
    /// A plate with a dark rectangle of a third of its reach in the middle.
    Plate(f32),
    /// Patches of 3 px, a quarter darker to a quarter brighter.
    Patches(Colour),
}

impl Paint {
    fn colour(self, [x, y]: [f32; 2]) -> Colour {
        match self {
            Self::Plain(colour) => colour,
            Self::Halves(left, right) => {
                if x < 0.0 {
                    left
                } else {
                    right
                }
            }
            Self::Striped(colour, stripe, width) => {
                if x.abs() < width / 2.0 {
                    stripe
                } else {
                    colour
                }
            }
            Self::Plate(side) => {
                if x.abs() < 0.16 * side && y.abs() < 0.28 * side {
                    BLACK
                } else {
                    WHITE
                }
            }
            Self::Patches(colour) => {
                let patch = at_point(77, (x / 3.0).floor() as i64, (y / 3.0).floor() as i64);
                colour.map(|c| c * (1.0 + 0.25 * patch))
            }
        }
    }
}

/// A thing in its place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    pub(crate) shape: Shape,
    pub(crate) paint: Paint,
    /// Centre, pixels.
    pub(crate) at: [f32; 2],
    pub(crate) heading_rad: f32,
}

impl Body {
    /// The body's colour at points of the picture, where it is.
    pub(crate) fn colours(self) -> impl Fn([f32; 2]) -> Option<Colour> {
        let local = to_local(self.at, self.heading_rad);
        move |point| {
            let point = local(point);
            (self.shape.distance(point) <= 0.0).then(|| self.paint.colour(point))
        }
    }

    /// Distance of points of the picture from its outer edge, negative inside: a hole belongs to
    /// the object.
    pub(crate) fn distances(self) -> impl Fn([f32; 2]) -> f32 {
        let local = to_local(self.at, self.heading_rad);
        move |point| self.shape.outer_distance(local(point))
    }

    /// Whether a point of the picture belongs to it, holes included.
    pub(crate) fn contains(self, point: [f32; 2]) -> bool {
        self.distances()(point) <= 0.0
    }

    /// The same thing elsewhere.
    pub(crate) fn moved_to(self, at: [f32; 2]) -> Self {
        Self { at, ..self }
    }
}
