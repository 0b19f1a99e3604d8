//! The folder a scan lies in: where the files it names are looked for, and nowhere else unless allowed.

use std::path::{Component, Path, PathBuf};

use crate::CoreError;

/// Endings of image files that may stand in for a texture that is not named, in order of preference.
const IMAGE_EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "webp", "bmp"];

/// A scan's folder.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    dir: PathBuf,
    outside_allowed: bool,
}

/// A file that a scan names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Lookup {
    /// It is there. `notice` says so if not exactly under the name that was given.
    Found {
        path: PathBuf,
        notice: Option<String>,
    },
    /// It is not there.
    Missing,
    /// It lies outside the folder, and that is not allowed.
    Outside,
}

impl Folder {
    /// The folder of a scan file.
    pub(crate) fn of(scan: &Path, outside_allowed: bool) -> Self {
        let dir = match scan.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        Self {
            dir,
            outside_allowed,
        }
    }

    /// Finds the file that is named `reference` in a scan or its material library.
    ///
    /// Tried in turn: the name as written (back slashes as slashes), the last part of it in the scan's folder (paths of
    /// the machine where the scan was made), the same without regard to case.
    pub(crate) fn find(&self, reference: &str) -> Lookup {
        let reference = reference.trim().replace('\\', "/");
        let relative = Path::new(&reference);
        let inside = is_inside(&reference);
        if inside || self.outside_allowed {
            let path = self.dir.join(relative);
            if path.is_file() {
                return Lookup::Found { path, notice: None };
            }
        }
        let base = reference.rsplit('/').next().unwrap_or_default();
        if let Some(path) = self.file_named(base) {
            let found = path.file_name().unwrap_or_default().to_string_lossy();
            let notice = Some(format!("`{reference}` was taken from `{found}` beside it"));
            return Lookup::Found { path, notice };
        }
        if inside || self.outside_allowed {
            Lookup::Missing
        } else {
            Lookup::Outside
        }
    }

    /// As [`Self::find`]; `None` if it is missing, an error if it lies outside the folder.
    pub(crate) fn require_inside(
        &self,
        reference: &str,
        file: &Path,
        place: Option<String>,
        notices: &mut Vec<String>,
    ) -> Result<Option<PathBuf>, CoreError> {
        match self.find(reference) {
            Lookup::Found { path, notice } => {
                notices.extend(notice);
                Ok(Some(path))
            }
            Lookup::Missing => Ok(None),
            Lookup::Outside => Err(CoreError::format(
                file,
                place,
                format!(
                    "`{}` lies outside the scan's folder and is not read",
                    shown(reference)
                ),
            )),
        }
    }

    /// An image with the stem of `scan`, the usual place of a texture that no library names.
    pub(crate) fn image_beside(&self, scan: &Path) -> Option<PathBuf> {
        let stem = scan.file_stem()?.to_string_lossy();
        IMAGE_EXTENSIONS
            .iter()
            .find_map(|extension| self.file_named(&format!("{stem}.{extension}")))
    }

    /// The file of that name directly in the folder, letter case disregarded if there is none of the exact name.
    fn file_named(&self, name: &str) -> Option<PathBuf> {
        if name.is_empty() || name == "." || name == ".." {
            return None;
        }
        let exact = self.dir.join(name);
        if exact.is_file() {
            return Some(exact);
        }
        let mut alike: Vec<PathBuf> = std::fs::read_dir(&self.dir)
            .ok()?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|p| {
                p.file_name()
                    .is_some_and(|n| n.to_string_lossy().eq_ignore_ascii_case(name))
            })
            .filter(|p| p.is_file())
            .collect();
        alike.sort();
        alike.into_iter().next()
    }
}

/// Whether a relative path cannot leave the folder it is joined to. Decided by its text alone.
fn is_inside(reference: &str) -> bool {
    let bytes = reference.as_bytes();
    let has_drive = bytes.len() >= 2 && bytes[0].is_ascii_alphabetic() && bytes[1] == b':';
    !has_drive
        && Path::new(reference)
            .components()
            .all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
}

/// A name from a file, cut to what fits a message.
pub(crate) fn shown(text: &str) -> String {
    const LIMIT: usize = 120;
    if text.chars().count() <= LIMIT {
        text.to_owned()
    } else {
        text.chars().take(LIMIT).chain("...".chars()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_with(names: &[&str], outside_allowed: bool) -> (tempfile::TempDir, Folder) {
        let dir = tempfile::tempdir().expect("folder");
        std::fs::create_dir(dir.path().join("scan")).expect("folder");
        for name in names {
            std::fs::write(dir.path().join(name), b"x").expect("file");
        }
        let folder = Folder::of(&dir.path().join("scan/a.obj"), outside_allowed);
        (dir, folder)
    }

    #[test]
    fn names_that_leave_the_folder_are_refused_unless_allowed() {
        let (_keep, folder) = folder_with(&["secret.png", "scan/b.png"], false);
        assert_eq!(folder.find("../secret.png"), Lookup::Outside);
        assert_eq!(folder.find("/etc/hostname"), Lookup::Outside);
        assert_eq!(folder.find("none.png"), Lookup::Missing);
        assert!(matches!(
            folder.find("./b.png"),
            Lookup::Found { notice: None, .. }
        ));
        let (_keep, folder) = folder_with(&["secret.png"], true);
        assert!(matches!(
            folder.find("../secret.png"),
            Lookup::Found { notice: None, .. }
        ));
    }

    #[test]
    fn a_path_of_another_machine_is_found_beside_the_scan() {
        let (_keep, folder) = folder_with(&["scan/Skin.PNG"], false);
        let Lookup::Found { path, notice } = folder.find(r"C:\Users\me\skin.png") else {
            panic!("not found");
        };
        assert!(path.ends_with("Skin.PNG"));
        assert!(notice.expect("notice").contains("`Skin.PNG` beside it"));
    }

    #[test]
    fn the_image_of_the_same_stem_is_found() {
        let (_keep, folder) = folder_with(&["scan/a.jpg", "scan/b.png"], false);
        let image = folder.image_beside(Path::new("a.obj")).expect("found");
        assert!(image.ends_with("a.jpg"));
    }
}
