//! Parts of a dataset, made by processes or machines of their own, put together: the bytes of one run.

use std::fs;
use std::path::{Component, Path, PathBuf};

use super::folder::{Folder, read_journal, unit_numbers};
use super::manifest::Manifest;
use crate::Error;

/// Puts parts together in the folder `output`, and finishes the dataset if all of it is there. Files are linked where
/// the file system can do that, else copied; the parts stay as they are. A merge that was interrupted goes on.
///
/// # Errors
/// [`Error::Dataset`] for a folder that holds no part, or one of another dataset; [`Error::Occupied`] and
/// [`Error::Locked`] for an output that cannot be used; [`Error::Io`] with the file.
pub fn merge(parts: &[PathBuf], output: &Path, overwrite: bool) -> Result<Manifest, Error> {
    let manifests = parts
        .iter()
        .map(|p| part_manifest(p))
        .collect::<Result<Vec<_>, _>>()?;
    let Some(first) = manifests.first() else {
        let reason = "no parts to merge".to_owned();
        let path = output.to_owned();
        return Err(Error::Dataset { path, reason });
    };
    for (path, manifest) in parts.iter().zip(&manifests) {
        if manifest.recipe_hash != first.recipe_hash || manifest.program != first.program {
            let reason = format!(
                "holds `{}` ({}) of {}, but {} holds `{}` ({}) of {}",
                manifest.recipe,
                manifest.recipe_hash,
                manifest.program,
                parts[0].display(),
                first.recipe,
                first.recipe_hash,
                first.program,
            );
            let path = path.clone();
            return Err(Error::Dataset { path, reason });
        }
    }
    if let Some((path, _)) = parts.iter().zip(&manifests).find(|(_, m)| m.part.is_none()) {
        return Err(Error::Dataset {
            path: path.clone(),
            reason: "is not a part, but a whole dataset".to_owned(),
        });
    }
    let whole = Manifest {
        part: None,
        written: 0,
        complete: false,
        failures: Vec::new(),
        ..first.clone()
    };
    let folder = Folder::open(output, whole, overwrite)?;
    for part in parts {
        take(&folder, part)?;
    }
    folder.finish()
}

fn part_manifest(path: &Path) -> Result<Manifest, Error> {
    Manifest::read(path)?.ok_or_else(|| Error::Dataset {
        path: path.to_owned(),
        reason: "holds no dataset (no manifest.json)".to_owned(),
    })
}

/// Takes the finished units of a part that are not there yet.
fn take(folder: &Folder, part: &Path) -> Result<(), Error> {
    let mut units = unit_numbers(part)?;
    units.sort_unstable();
    for unit in units {
        if read_journal(folder.root(), unit).is_some() {
            continue;
        }
        let Some(journal) = read_journal(part, unit) else {
            continue;
        };
        for file in &journal.files {
            let name = Path::new(&file.name);
            if !name.components().all(|c| matches!(c, Component::Normal(_))) {
                return Err(Error::Dataset {
                    path: part.to_owned(),
                    reason: format!("its journal names a file outside of it, `{}`", file.name),
                });
            }
            place(
                &part.join(&file.name),
                &folder.root().join(&file.name),
                file.bytes,
            )?;
        }
        folder.finish_unit(unit, &journal)?;
    }
    Ok(())
}

/// Links or copies a file.
fn place(from: &Path, to: &Path, bytes: u64) -> Result<(), Error> {
    let found = fs::metadata(from).map_err(|e| Error::io(from, e))?.len();
    if found != bytes {
        return Err(Error::Dataset {
            path: from.to_owned(),
            reason: format!("has {found} bytes, its journal says {bytes}; run its part again"),
        });
    }
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent).map_err(|e| Error::io(parent, e))?;
    }
    // What an interrupted merge left may be cut.
    match fs::remove_file(to) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(to, e)),
        _ => {}
    }
    fs::hard_link(from, to)
        .or_else(|_| fs::copy(from, to).map(|_| ()))
        .map_err(|e| Error::io(to, e))
}
