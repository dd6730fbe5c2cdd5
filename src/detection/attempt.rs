//! The ways in which a shape is searched for markers.

/// One way to search for markers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Attempt {
    pub(super) part: Part,
    pub(super) channel: Channel,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    /// Only the shape.
    Shape,
    /// The shape and its surroundings: if the plate has the colour of the floor, only the marker
    /// differs from it.
    Around,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Channel {
    Intensity,
    Colour,
}

impl Attempt {
    /// In the order of the attempts.
    pub(super) const ALL: [Self; 4] = [
        Self::new(Part::Shape, Channel::Intensity),
        Self::new(Part::Shape, Channel::Colour),
        Self::new(Part::Around, Channel::Intensity),
        Self::new(Part::Around, Channel::Colour),
    ];

    const fn new(part: Part, channel: Channel) -> Self {
        Self { part, channel }
    }
}
