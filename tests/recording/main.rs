//! Recordings as files: what a replay gets back, what survives a crash, a cut, damage and a full disk, and what others read.

mod damage;
mod fixture;
mod full_disk;
mod other_programs;
mod refusals;
mod round_trip;
mod series;
