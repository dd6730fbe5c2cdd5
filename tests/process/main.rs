//! The built program as its users meet it: what it prints, records and publishes, how it stops, and what it says to mistakes.
//!
//! Each test works in a folder of its own and, where it publishes, on a service of its own. The demo keeps its own pace of 30
//! frames a second, so the tests take few frames from it.

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
