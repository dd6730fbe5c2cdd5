//! The bounds of the floor, as far as observations have shown them.

/// Minimum and maximum coordinates observed so far. Nothing is expected beyond them.
pub(crate) type Bounds = [[f64; 2]; 2];

/// The bounds before the first observation.
pub(crate) const NO_BOUNDS: Bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];

/// The bounds extended to include a position.
pub(crate) fn expanded(bounds: &Bounds, [x, y]: [f64; 2]) -> Bounds {
    let [low, high] = bounds;
    [
        [low[0].min(x), low[1].min(y)],
        [high[0].max(x), high[1].max(y)],
    ]
}

/// A position `beyond` the bounds, reflected back into them like a ball off a wall.
pub(crate) fn reflected(beyond: [f64; 2], [low, high]: &Bounds) -> [f64; 2] {
    [0, 1].map(|axis: usize| {
        let c = beyond[axis];
        if c > high[axis] {
            2.0 * high[axis] - c
        } else if c < low[axis] {
            2.0 * low[axis] - c
        } else {
            c
        }
    })
}
