//! The bounds of the floor, as far as they are known.

/// Lowest and highest coordinates at which anything was seen: nothing has gone beyond.
pub(crate) type Walls = [[f64; 2]; 2];

/// Nowhere yet.
pub(crate) const NO_WALLS: Walls = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];

/// The walls when something was seen here.
pub(crate) fn pushed_out(walls: &Walls, [x, y]: [f64; 2]) -> Walls {
    let [low, high] = walls;
    [
        [low[0].min(x), low[1].min(y)],
        [high[0].max(x), high[1].max(y)],
    ]
}

/// Where a thing comes to that would be `beyond` the walls without them.
pub(crate) fn thrown_back(beyond: [f64; 2], [low, high]: &Walls) -> [f64; 2] {
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
