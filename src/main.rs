//! overcam: the command line program.

fn main() {}
