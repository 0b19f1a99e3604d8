//! Facile.
