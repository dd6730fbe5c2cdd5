//! Tracks on hand-made scenes: what becomes of them from frame to frame, and of those that touch.

mod crossing;
mod fixture;
mod lifecycle;
mod merging;
