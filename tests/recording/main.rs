//! Recordings as files: replaying, crashes, truncation, damage, a full disk, and other readers.

mod damage;
mod fixture;
mod full_disk;
mod other_programs;
mod refusals;
mod round_trip;
mod series;
