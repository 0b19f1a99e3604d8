//! Threads for inner loops outside a run.
//!
//! Rayon's global threads do not survive a fork: in a forked worker of a Python data loader whoever waits for them waits
//! for ever. Here the threads belong to a process by its number, so a forked one makes its own.

use std::sync::{Arc, Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// The threads, and the process that they run in.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Does some work with its inner loops on this process's threads, as many as there are processors; on those of the caller if
/// it is one of a run's.
pub(crate) fn with<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    if rayon::current_thread_index().is_some() {
        return work();
    }
    match pool() {
        Some(pool) => pool.install(work),
        // Without threads, inner loops take turns on this one
        None => work(),
    }
}

/// The threads of this process; `None` if the system gives none.
fn pool() -> Option<Arc<ThreadPool>> {
    let process = std::process::id();
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((owner, threads)) = &*pool
        && *owner == process
    {
        return Some(threads.clone());
    }
    let made = Arc::new(ThreadPoolBuilder::new().build().ok()?);
    // The parent's threads cannot be told to end
    std::mem::forget(pool.replace((process, made.clone())));
    Some(made)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_done_on_threads_of_this_process_or_of_the_caller() {
        let own = with(|| (rayon::current_thread_index(), rayon::current_num_threads()));
        assert!(own.0.is_some());
        let again = with(|| with(rayon::current_num_threads));
        assert_eq!(again, own.1);
        let single = ThreadPoolBuilder::new().num_threads(1).build();
        let inside = single
            .expect("threads")
            .install(|| with(rayon::current_num_threads));
        assert_eq!(inside, 1);
    }
}
