//! Times in nanoseconds, differences in seconds.

/// Nanoseconds in a second.
pub(crate) const NS_PER_S: f64 = 1e9;

/// Seconds from one moment to a later one; 0 if it is not later.
pub(crate) fn seconds_between(earlier_ns: u64, later_ns: u64) -> f64 {
    later_ns.saturating_sub(earlier_ns) as f64 / NS_PER_S
}
