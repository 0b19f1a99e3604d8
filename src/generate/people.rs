//! The people that the samples in hand need, each prepared once.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::caught;
use crate::pipeline::{Person, Pipeline};

/// A person, or why there is none.
pub(super) type Prepared = Result<Arc<Person>, Arc<str>>;

/// Prepares people on demand and keeps them while they are needed.
///
/// A thread that needs someone whom another one is preparing prepares one of the next meanwhile, so that dear
/// registrations run side by side.
pub(super) struct People<'a> {
    pipeline: &'a Pipeline,
    /// How many subjects may be prepared before they are needed.
    ahead: u64,
    /// First subject that no sample needs.
    end: u64,
    slots: Mutex<BTreeMap<u64, Option<Prepared>>>,
    changed: Condvar,
}

impl<'a> People<'a> {
    pub(super) fn new(pipeline: &'a Pipeline, ahead: u64, end: u64) -> Self {
        Self {
            pipeline,
            ahead,
            end,
            slots: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Subject number `subject`. `heard` is called with everyone who is prepared on the way.
    pub(super) fn get(&self, subject: u64, heard: impl Fn(u64, &Prepared)) -> Prepared {
        let mut slots = self.lock();
        loop {
            let next = match slots.get(&subject) {
                Some(Some(person)) => return person.clone(),
                None => Some(subject),
                Some(None) => (subject + 1..=subject + self.ahead)
                    .find(|s| *s < self.end && !slots.contains_key(s)),
            };
            let Some(next) = next else {
                let waited = self.changed.wait(slots);
                slots = waited.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            slots.insert(next, None);
            drop(slots);
            let person = caught(|| self.pipeline.person(next))
                .map(Arc::new)
                .map_err(|e| Arc::from(e.to_string()));
            heard(next, &person);
            slots = self.lock();
            slots.insert(next, Some(person));
            self.changed.notify_all();
        }
    }

    /// Forgets everyone before `subject`.
    pub(super) fn forget_before(&self, subject: u64) {
        let mut slots = self.lock();
        *slots = slots.split_off(&subject);
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, Option<Prepared>>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
