//! Buffers that outlive a call: one set for each thread, so that the same work asks the system for memory once.

use std::cell::Cell;
use std::thread::LocalKey;

/// Where a thread keeps its buffers between calls.
pub(crate) type Shelf<T> = LocalKey<Cell<Option<Box<T>>>>;

/// Does work with the thread's buffers, or with new ones if they are in use; they may hold anything.
pub(crate) fn with<T: Default, R>(shelf: &'static Shelf<T>, work: impl FnOnce(&mut T) -> R) -> R {
    let mut own = shelf.take().unwrap_or_default();
    let result = work(&mut own);
    shelf.set(Some(own));
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Buffers {
        bytes: Vec<u8>,
    }

    thread_local! {
        static SHELF: Cell<Option<Box<Buffers>>> = const { Cell::new(None) };
    }

    #[test]
    fn buffers_stay_and_calls_may_nest() {
        with(&SHELF, |outer: &mut Buffers| {
            outer.bytes.push(1);
            with(&SHELF, |inner: &mut Buffers| {
                assert!(inner.bytes.is_empty());
            });
        });
        with(&SHELF, |again: &mut Buffers| assert_eq!(again.bytes, [1]));
    }
}
