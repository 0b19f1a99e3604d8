//! Facile.
fn main() {}
