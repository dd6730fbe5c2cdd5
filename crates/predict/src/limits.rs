//! Capacities, and the range of a forecast.

/// Maximum number of tracks alive at once.
pub const MAX_TRACKS: usize = 64;
/// Maximum number of observations used per frame. The rest are counted in
/// [`Update::overflow`](crate::Update::overflow).
pub const MAX_OBSERVATIONS: usize = 2 * MAX_TRACKS;
/// Number of points in a forecast.
pub const MAX_FORECAST: usize = 20;
/// Range of a forecast in seconds.
pub const FORECAST_RANGE_S: f64 = 2.0;
/// Seconds between two points of a forecast.
pub const FORECAST_SPACING_S: f64 = FORECAST_RANGE_S / MAX_FORECAST as f64;
