//! One unit in the making: its chunks come from several threads, its samples are stored in order.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::Error;
use crate::write::{EncodedSample, Failure, UnitWriter};

/// A unit in the making.
pub(super) struct Assembly<'a> {
    state: Mutex<State<'a>>,
    changed: Condvar,
    /// Bytes of samples that may wait for those before them; a thread that is further ahead waits itself.
    most_waiting: usize,
}

struct State<'a> {
    /// `None` once the unit is finished or its folder could not be written.
    writer: Option<UnitWriter<'a>>,
    /// The chunk whose samples are stored as they come.
    next: usize,
    chunks: usize,
    /// Of later chunks.
    waiting: BTreeMap<usize, Waiting>,
    waiting_bytes: usize,
}

#[derive(Default)]
struct Waiting {
    samples: Vec<EncodedSample>,
    is_closed: bool,
}

impl<'a> Assembly<'a> {
    /// A unit of `chunks` chunks.
    pub(super) fn new(writer: UnitWriter<'a>, chunks: usize, most_waiting: usize) -> Self {
        Self {
            state: Mutex::new(State {
                writer: Some(writer),
                next: 0,
                chunks,
                waiting: BTreeMap::new(),
                waiting_bytes: 0,
            }),
            changed: Condvar::new(),
            most_waiting,
        }
    }

    /// Takes the next sample of a chunk. Waits while too many samples wait for those of an earlier chunk.
    pub(super) fn push(&self, chunk: usize, sample: EncodedSample) -> Result<(), Error> {
        let mut state = self.lock();
        while state.writer.is_some()
            && chunk != state.next
            && state.waiting_bytes > self.most_waiting
        {
            let waited = self.changed.wait(state);
            state = waited.unwrap_or_else(PoisonError::into_inner);
        }
        if chunk == state.next {
            let written = state.append(sample);
            return self.checked(&mut state, written);
        }
        state.waiting_bytes += sample.len();
        state.waiting.entry(chunk).or_default().samples.push(sample);
        Ok(())
    }

    /// Notes what could not be made.
    pub(super) fn fail(&self, failure: Failure) {
        if let Some(writer) = &mut self.lock().writer {
            writer.fail(failure);
        }
    }

    /// Ends a chunk; the last one ends the unit.
    pub(super) fn close(&self, chunk: usize) -> Result<(), Error> {
        let mut state = self.lock();
        if chunk == state.next {
            let moved = state.advance();
            self.checked(&mut state, moved)?;
        } else {
            state.waiting.entry(chunk).or_default().is_closed = true;
        }
        self.changed.notify_all();
        Ok(())
    }

    /// After an error nobody waits for this unit any more.
    fn checked(&self, state: &mut State<'a>, result: Result<(), Error>) -> Result<(), Error> {
        if result.is_err() {
            state.writer = None;
            self.changed.notify_all();
        }
        result
    }

    fn lock(&self) -> MutexGuard<'_, State<'a>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State<'_> {
    fn append(&mut self, sample: EncodedSample) -> Result<(), Error> {
        match &mut self.writer {
            Some(writer) => writer.append(sample),
            None => Ok(()),
        }
    }

    /// Goes on to the next chunk and stores what waits of it; finishes the unit after the last.
    fn advance(&mut self) -> Result<(), Error> {
        loop {
            self.next += 1;
            if self.next == self.chunks {
                return self.writer.take().map_or(Ok(()), UnitWriter::finish);
            }
            let Waiting { samples, is_closed } =
                self.waiting.remove(&self.next).unwrap_or_default();
            for sample in samples {
                self.waiting_bytes -= sample.len();
                self.append(sample)?;
            }
            if !is_closed {
                return Ok(());
            }
        }
    }
}
