//! The people that the samples in hand need, each prepared once.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::caught;
use crate::pipeline::{Person, Pipeline, Work};

/// A person, or why there is none.
pub(super) type Prepared = Result<Arc<Person>, Arc<str>>;

/// Prepares people on demand and keeps them while they are needed.
///
/// A thread that needs someone whom another one is preparing prepares one of the next meanwhile, so that dear
/// registrations run side by side.
pub(super) struct People<'a> {
    pipeline: &'a Pipeline,
    /// How many visits may be prepared before they are needed.
    ahead: u64,
    /// First visit to a subject that no sample needs.
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

    /// Whom visit number `visit` is to: the subject of that number unless samples are drawn. `heard` is called with
    /// everyone who is prepared on the way.
    pub(super) fn get(&self, visit: u64, heard: impl Fn(u64, &Prepared)) -> Prepared {
        let mut slots = self.lock();
        loop {
            let next = match slots.get(&visit) {
                Some(Some(person)) => return person.clone(),
                None => Some(visit),
                Some(None) => (visit + 1..=visit + self.ahead)
                    .find(|s| *s < self.end && !slots.contains_key(s)),
            };
            let Some(next) = next else {
                let waited = self.changed.wait(slots);
                slots = waited.unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            slots.insert(next, None);
            drop(slots);
            let subject = self.pipeline.recipe().subject_of_visit(next);
            let clock = self.pipeline.clock();
            let person = caught(|| clock.time(Work::People, || self.pipeline.person(subject)))
                .map(Arc::new)
                .map_err(|e| Arc::from(e.to_string()));
            heard(subject, &person);
            slots = self.lock();
            slots.insert(next, Some(person));
            self.changed.notify_all();
        }
    }

    /// Forgets everyone before visit number `visit`.
    pub(super) fn forget_before(&self, visit: u64) {
        let mut slots = self.lock();
        *slots = slots.split_off(&visit);
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, Option<Prepared>>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
