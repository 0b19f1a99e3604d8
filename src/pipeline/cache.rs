//! Results that are dear to make, kept on disk between runs under the hash of everything they depend on.
//!
//! An entry is its payload followed by the payload's BLAKE3 hash: one that was cut or damaged is not taken, but made
//! anew. Entries appear at once, by renaming, so several processes may share a cache. A cache that cannot be used is
//! no error: the work is done again.

use std::fs;
use std::io::Write as _;
use std::path::PathBuf;

/// Where registrations are kept if this variable of the environment names a folder.
pub const CACHE_VARIABLE: &str = "FACILE_CACHE";
const HASH: usize = blake3::OUT_LEN;

/// A folder of results.
#[derive(Clone, Debug)]
pub(crate) struct Cache {
    dir: Option<PathBuf>,
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
        Self {
            dir: of(CACHE_VARIABLE).or_else(platform),
        }
    }

    /// The payload of an entry, if it is there and whole.
    pub(crate) fn get(&self, key: &blake3::Hash) -> Option<Vec<u8>> {
        let mut bytes = fs::read(self.path(key)?).ok()?;
        let hash = bytes.split_off(bytes.len().checked_sub(HASH)?);
        (blake3::hash(&bytes).as_bytes()[..] == hash).then_some(bytes)
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
        drop(stored);
    }

    fn path(&self, key: &blake3::Hash) -> Option<PathBuf> {
        let hex = key.to_hex();
        self.dir.as_ref().map(|d| d.join(&hex[..2]).join(&hex[2..]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_entries_come_back_and_damaged_ones_do_not() {
        let dir = tempfile::tempdir().expect("a folder");
        let cache = Cache {
            dir: Some(dir.path().to_owned()),
        };
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
}
