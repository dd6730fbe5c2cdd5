//! Tracks on synthetic scenes: their life cycle, crossings, and touching objects.

mod crossing;
mod fixture;
mod lifecycle;
mod merging;
