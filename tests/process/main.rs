//! The built program as users see it: what it prints, records and publishes, how it stops, and how
//! it reports mistakes.
//!
//! Each test uses its own folder and, if it publishes, its own service. The demo runs at its own
//! rate of 30 frames per second, so the tests take only a few frames from it.

mod arguments;
mod config;
mod damaged;
mod fixture;
mod floor;
mod markers;
mod output;
mod refusals;
mod replay;
mod service;
mod shells;
mod sources;
mod stopping;
mod subscribers;
mod terminal;
