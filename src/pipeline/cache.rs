//! Results that are dear to make, kept on disk between runs under the hash of everything they depend on.
//!
//! An entry is its payload followed by the payload's BLAKE3 hash: one that was cut or damaged is not taken, but made
//! anew. Entries appear at once, by renaming, and go at once, so several processes may share a cache. The cache is
//! bounded: when it has grown past its bound the entries go that were used longest ago. A cache that cannot be used is
//! no error: the work is done again.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

/// Where registrations and equilibria are kept if this variable of the environment names a folder.
pub const CACHE_VARIABLE: &str = "FACILE_CACHE";
/// The cache's bound in megabytes if this variable of the environment gives a number; 0 keeps nothing.
pub const CACHE_SIZE_VARIABLE: &str = "FACILE_CACHE_MB";
const DEFAULT_MB: u64 = 4096;
const HASH: usize = blake3::OUT_LEN;
/// Share of the bound that is left after old entries went, so that they need not go at every new one.
const KEPT: f64 = 0.8;

/// How often a result was made, and how often it was in the cache.
#[derive(Debug, Default)]
pub struct Counts {
    made: AtomicU64,
    hits: AtomicU64,
}

impl Counts {
    pub(super) fn hit(&self) {
        self.hits.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn made(&self) {
        self.made.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of results made, and of those taken from the cache.
    pub fn get(&self) -> [u64; 2] {
        [&self.made, &self.hits].map(|n| n.load(Ordering::Relaxed))
    }
}

/// A folder of results.
#[derive(Debug)]
pub(crate) struct Cache {
    dir: Option<PathBuf>,
    /// Bytes that it may hold.
    bound: u64,
    /// Bytes that it holds, as far as this process knows; `None` until it has looked.
    size: Mutex<Option<u64>>,
}

impl Cache {
    /// The user's cache: `$FACILE_CACHE`, else the platform's place for caches.
    pub(crate) fn of_user() -> Self {
        let of = |name: &str| {
            std::env::var_os(name)
                .filter(|v| !v.is_empty())
                .map(PathBuf::from)
        };
        let platform = || {
            if cfg!(windows) {
                return of("LOCALAPPDATA").map(|d| d.join("facile").join("cache"));
            }
            if cfg!(target_os = "macos") {
                return of("HOME").map(|d| d.join("Library/Caches/facile"));
            }
            let xdg = of("XDG_CACHE_HOME").filter(|d| d.is_absolute());
            xdg.or_else(|| of("HOME").map(|d| d.join(".cache")))
                .map(|d| d.join("facile"))
        };
        let megabytes = of(CACHE_SIZE_VARIABLE)
            .and_then(|v| v.to_str()?.trim().parse().ok())
            .unwrap_or(DEFAULT_MB);
        Self::within(of(CACHE_VARIABLE).or_else(platform), megabytes << 20)
    }

    fn within(dir: Option<PathBuf>, bound: u64) -> Self {
        Self {
            dir: dir.filter(|_| bound > 0),
            bound,
            size: Mutex::new(None),
        }
    }

    /// The payload of an entry, if it is there and whole.
    pub(crate) fn get(&self, key: &blake3::Hash) -> Option<Vec<u8>> {
        let path = self.path(key)?;
        let mut bytes = fs::read(&path).ok()?;
        let hash = bytes.split_off(bytes.len().checked_sub(HASH)?);
        let is_whole = blake3::hash(&bytes).as_bytes()[..] == hash;
        if is_whole {
            // Its time says when it was used last. One that cannot be told goes earlier, and that is all.
            let used = File::options().append(true).open(&path);
            drop(used.and_then(|f| f.set_modified(SystemTime::now())));
        }
        is_whole.then_some(bytes)
    }

    /// Whether an entry is there, whole or not.
    pub(crate) fn has(&self, key: &blake3::Hash) -> bool {
        self.path(key).is_some_and(|p| p.is_file())
    }

    /// Stores an entry; a cache that cannot be written is left alone.
    pub(crate) fn put(&self, key: &blake3::Hash, payload: &[u8]) {
        let Some(path) = self.path(key) else { return };
        let Some(dir) = path.parent() else { return };
        let stored = fs::create_dir_all(dir).and_then(|()| {
            let mut file = tempfile::NamedTempFile::new_in(dir)?;
            file.write_all(payload)?;
            file.write_all(blake3::hash(payload).as_bytes())?;
            file.persist(&path)?;
            Ok(())
        });
        // Without the entry the next run takes longer, and that is all.
        if stored.is_ok() {
            self.keep_within_bound((payload.len() + HASH) as u64);
        }
    }

    /// Counts what was added, and lets the entries go that were used longest ago if that is too much.
    fn keep_within_bound(&self, added: u64) {
        let Some(dir) = &self.dir else { return };
        let mut size = self.size.lock().unwrap_or_else(PoisonError::into_inner);
        let known = match *size {
            Some(known) => known + added,
            None => entries(dir).iter().map(|e| e.bytes).sum(),
        };
        *size = Some(known);
        if known <= self.bound {
            return;
        }
        // Other processes add and remove as well: only a look tells.
        let mut entries = entries(dir);
        entries.sort_by(|a, b| (a.used, &a.path).cmp(&(b.used, &b.path)));
        let mut left: u64 = entries.iter().map(|e| e.bytes).sum();
        if left > self.bound {
            let kept = (self.bound as f64 * KEPT) as u64;
            for entry in entries {
                if left <= kept {
                    break;
                }
                // What another process removed first is gone all the same.
                drop(fs::remove_file(&entry.path));
                left -= entry.bytes;
            }
        }
        *size = Some(left);
    }

    fn path(&self, key: &blake3::Hash) -> Option<PathBuf> {
        let hex = key.to_hex();
        self.dir.as_ref().map(|d| d.join(&hex[..2]).join(&hex[2..]))
    }
}

/// A file of the cache.
struct Entry {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

/// Every file of the cache, what interrupted processes left half-written included.
fn entries(dir: &Path) -> Vec<Entry> {
    let mut found = Vec::new();
    for folder in fs::read_dir(dir).into_iter().flatten().flatten() {
        for file in fs::read_dir(folder.path()).into_iter().flatten().flatten() {
            if let Ok(metadata) = file.metadata()
                && metadata.is_file()
            {
                found.push(Entry {
                    path: file.path(),
                    bytes: metadata.len(),
                    used: metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH),
                });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn whole_entries_come_back_and_damaged_ones_do_not() {
        let dir = tempfile::tempdir().expect("a folder");
        let cache = Cache::within(Some(dir.path().to_owned()), 1 << 20);
        let key = blake3::hash(b"key");
        assert_eq!(cache.get(&key), None);
        cache.put(&key, b"payload");
        assert_eq!(cache.get(&key).as_deref(), Some(&b"payload"[..]));
        let path = cache.path(&key).expect("a path");
        let mut bytes = fs::read(&path).expect("there");
        bytes[0] ^= 1;
        fs::write(&path, &bytes).expect("writes");
        assert_eq!(cache.get(&key), None);
        fs::write(&path, &bytes[..5]).expect("writes");
        assert_eq!(cache.get(&key), None);
    }

    #[test]
    fn what_was_used_longest_ago_goes_first_and_the_bound_holds() {
        let dir = tempfile::tempdir().expect("a folder");
        let cache = Cache::within(Some(dir.path().to_owned()), 10_000);
        let key = |i: u32| blake3::hash(&i.to_le_bytes());
        let long_ago = SystemTime::now() - Duration::from_secs(1_000);
        for i in 0..9 {
            cache.put(&key(i), &[i as u8; 1000]);
            let file = File::options()
                .append(true)
                .open(cache.path(&key(i)).expect("a path"));
            let used = long_ago + Duration::from_secs(u64::from(i));
            file.and_then(|f| f.set_modified(used))
                .expect("sets its time");
        }
        assert!(cache.get(&key(0)).is_some(), "used again");
        cache.put(&key(9), &[9; 1000]);
        let left: Vec<u32> = (0..10).filter(|i| cache.has(&key(*i))).collect();
        // 1,032 bytes each: seven are left of ten, and the first was used again.
        assert_eq!(left, [0, 4, 5, 6, 7, 8, 9]);
        let nothing = Cache::within(Some(dir.path().to_owned()), 0);
        nothing.put(&key(20), b"x");
        assert!(nothing.get(&key(20)).is_none() && !cache.has(&key(20)));
    }

    #[test]
    fn several_users_of_one_cache_do_not_disturb_each_other() {
        let dir = tempfile::tempdir().expect("a folder");
        let key = |i: u32| blake3::hash(&i.to_le_bytes());
        std::thread::scope(|scope| {
            for user in 0..4 {
                let cache = Cache::within(Some(dir.path().to_owned()), 20_000);
                scope.spawn(move || {
                    for i in 0..200 {
                        let i = (i * 7 + user) % 50;
                        match cache.get(&key(i)) {
                            Some(found) => assert_eq!(found, [i as u8; 900]),
                            None => cache.put(&key(i), &[i as u8; 900]),
                        }
                    }
                });
            }
        });
        let size: u64 = entries(dir.path()).iter().map(|e| e.bytes).sum();
        // Each user counts for itself and looks when it has added a bound's worth.
        assert!(size <= 4 * 20_000, "{size} bytes");
    }
}
