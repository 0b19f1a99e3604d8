//! From a subject's number to a person: scans are registered (paper section 3), identities drawn.
//!
//! A registration is dear, so it is kept in the user's cache under the hash of the scan's content, the settings and the
//! code. Fresh or from the cache, a subject goes through the same bytes before it is used.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use facile_core::identity::IdentityModel;
use facile_core::io::{self, Scan};
use facile_core::{ReferenceHead, Subject, builtin};
use facile_flow::{Registrar, RegistrationParams, RegistrationReport, ScanLandmarks};
use facile_sim::{FaceModel, FaceRig};
use facile_trace::hair::Hair;

use super::Pipeline;
use super::cache::{Cache, Counts};
use super::{equilibria, hair};
use crate::Error;
use crate::recipe::SubjectSource;
use crate::threads;

/// Names the code that registers, so that what other code left in a cache is not taken.
const CODE: &str = env!("FACILE_REGISTRATION_CODE");
/// Files that a scan may name.
const COMPANIONS: [&str; 8] = ["mtl", "bin", "jpg", "jpeg", "png", "bmp", "webp", "tga"];
/// Where a scan names its companions: in its first bytes.
const HEADER_BYTES: usize = 1 << 18;

/// A subject with how it was made.
#[derive(Clone, Debug)]
pub struct Registered {
    /// Shape and colour.
    pub subject: Subject,
    /// How well the scan was registered; `None` for drawn identities and for files that hold a subject already.
    pub report: Option<RegistrationReport>,
    /// What the user should know of how the scan was read.
    pub notices: Vec<String>,
}

impl Registered {
    /// Identity `number` of the family `seed` of the identity model.
    ///
    /// # Errors
    /// [`Error::Core`] if a skin of the model is damaged.
    pub fn sampled(seed: u64, number: u64) -> Result<Self, Error> {
        Ok(Self {
            subject: IdentityModel::embedded().sample(ReferenceHead::embedded(), seed, number)?,
            report: None,
            notices: Vec::new(),
        })
    }
}

/// A subject, ready to be posed and rendered.
#[derive(Debug)]
pub struct Person {
    /// Shape and colour.
    pub subject: Subject,
    /// Hash of what the physics sees of the subject.
    pub(super) shape: blake3::Hash,
    /// `scan`, `builtin` or `sampled`.
    pub kind: &'static str,
    /// How well the scan was registered; `None` for drawn identities.
    pub registration: Option<RegistrationReport>,
    /// Hair beyond what the skin shows.
    pub hair: Option<Hair>,
    /// sRGB colour of the shirt, if there is one.
    pub clothes: Option<[u8; 3]>,
    /// What moves the face, made for the first equilibrium that is solved for.
    model: OnceLock<FaceModel>,
    /// What the user should know of how the scan was read.
    pub notices: Vec<String>,
}

impl Person {
    /// Prepares a subject that is there already.
    pub fn new(
        subject: Subject,
        kind: &'static str,
        registration: Option<RegistrationReport>,
        notices: Vec<String>,
    ) -> Self {
        Self {
            shape: equilibria::shape(&subject),
            subject,
            kind,
            registration,
            hair: None,
            clothes: None,
            model: OnceLock::new(),
            notices,
        }
    }

    /// What moves the face. A person whose equilibria are all in the cache needs none.
    ///
    /// # Errors
    /// [`Error::Sim`] for a face that cannot carry muscles.
    pub(super) fn model(
        &self,
        rig: &FaceRig,
        reference: &ReferenceHead,
    ) -> Result<&FaceModel, Error> {
        if let Some(model) = self.model.get() {
            return Ok(model);
        }
        let model = rig.model(reference, &self.subject)?;
        Ok(self.model.get_or_init(|| model))
    }
}

impl Pipeline {
    /// Prepares subject number `subject` of the recipe.
    ///
    /// # Errors
    /// [`Error::Core`] for a scan that cannot be read, [`Error::Flow`] for one that shows no face.
    pub fn person(&self, subject: u64) -> Result<Person, Error> {
        let source = self.recipe().subjects.get(subject);
        let (kind, registered) = match &source {
            SubjectSource::Scan { file } => ("scan", self.registrations.scan(file, None, None)?),
            SubjectSource::Builtin { name } => ("builtin", self.registrations.builtin(name)?),
            SubjectSource::Sampled { number } => {
                ("sampled", Registered::sampled(self.recipe().seed, *number)?)
            }
        };
        let mut subject_value = registered.subject;
        subject_value.id = self.subject_id(subject);
        let (report, notices) = (registered.report, registered.notices);
        let person = Person::new(subject_value, kind, report, notices);
        Ok(self.dressed(person, subject))
    }

    /// The person, subject number `number` of the recipe, with hair and clothes.
    pub(super) fn dressed(&self, person: Person, number: u64) -> Person {
        let (recipe, kind) = (self.recipe(), person.kind);
        Person {
            hair: hair::of_subject(&recipe.hair, recipe.seed, number, kind, &person.subject),
            clothes: hair::shirt(&recipe.clothes, recipe.seed, number, kind),
            ..person
        }
    }

    /// Makes what moves the face of `person` now, if faces of this recipe move, so that this can be timed.
    pub(crate) fn make_model(&self, person: &Person) -> Result<(), Error> {
        let rig = self.rig.as_ref();
        rig.map_or(Ok(()), |rig| person.model(rig, self.reference()).map(drop))
    }

    /// The name of a subject in records: of its file or its own, with a number if another has the same.
    pub fn subject_id(&self, subject: u64) -> String {
        let subjects = &self.recipe().subjects;
        let stem = |p: &Path| {
            p.file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        let name_of = |i: u64| match subjects.get(i) {
            SubjectSource::Scan { file } => stem(&file),
            SubjectSource::Builtin { name } => name,
            SubjectSource::Sampled { number } => format!("sampled_{number:06}"),
        };
        let name = name_of(subject);
        let named = (subjects.scans.len() + subjects.builtin.len()) as u64;
        let same = (0..subject.min(named))
            .filter(|i| name_of(*i) == name)
            .count();
        match same {
            0 => name,
            n => format!("{name}_{}", n + 1),
        }
    }
}

/// Registers scans, or takes what an earlier run left in the cache.
#[derive(Debug)]
pub struct Registrations {
    reference: &'static ReferenceHead,
    params: RegistrationParams,
    /// Made for the first scan that is not in the cache.
    registrar: OnceLock<Registrar<'static>>,
    cache: Cache,
    takes_cached: bool,
    counts: Counts,
}

impl Default for Registrations {
    fn default() -> Self {
        Self::new()
    }
}

impl Registrations {
    /// With default settings and the user's cache.
    pub fn new() -> Self {
        Self::with(RegistrationParams::default())
    }

    /// With the user's cache.
    pub fn with(params: RegistrationParams) -> Self {
        Self {
            reference: ReferenceHead::embedded(),
            params,
            registrar: OnceLock::new(),
            cache: Cache::of_user(),
            takes_cached: true,
            counts: Counts::default(),
        }
    }

    /// The same, taking what earlier runs left in the cache or registering anew.
    #[must_use]
    pub(super) fn taking_cached(mut self, takes_cached: bool) -> Self {
        self.takes_cached = takes_cached;
        self
    }

    /// To another reference head, which is kept as long as the process lives, with the user's cache.
    ///
    /// A subject on the shipped topology gets teeth and tongue from the shipped head, so that every command takes it.
    pub fn to(reference: ReferenceHead, params: RegistrationParams) -> Self {
        Self {
            reference: Box::leak(Box::new(reference)),
            ..Self::with(params)
        }
    }

    /// The head that scans are registered to.
    pub fn reference(&self) -> &'static ReferenceHead {
        self.reference
    }

    /// The subject of a scan file, or of a file that holds a subject already. `texture` replaces what the file names;
    /// `landmarks` is a file of points in the scan's coordinates, see [`ScanLandmarks::parse`].
    ///
    /// # Errors
    /// [`Error::Core`] for a file that cannot be read, [`Error::Flow`] for a scan that shows no face.
    pub fn scan(
        &self,
        file: &Path,
        texture: Option<&Path>,
        landmarks: Option<&Path>,
    ) -> Result<Registered, Error> {
        let bytes = io::read_file(file)?;
        if io::is_subject(&bytes) {
            return Ok(Registered {
                subject: Subject::from_glb(&bytes, file, self.reference)?,
                report: None,
                notices: Vec::new(),
            });
        }
        let scan = io::load_scan(file, texture)?;
        let landmarks = match landmarks {
            Some(path) => {
                let text = String::from_utf8_lossy(&io::read_file(path)?).into_owned();
                let parsed = ScanLandmarks::parse(&text).map_err(|e| Error::Dataset {
                    path: path.to_owned(),
                    reason: e.to_string(),
                })?;
                Some(parsed)
            }
            None => None,
        };
        let mut registered = self.register(&scan, landmarks.as_ref())?;
        registered.notices.extend(
            scan.notices
                .iter()
                .map(|n| format!("{}: {n}", file.display())),
        );
        Ok(registered)
    }

    /// A subject that ships with the program.
    ///
    /// # Errors
    /// [`Error::Core`] for an unknown name.
    pub fn builtin(&self, name: &str) -> Result<Registered, Error> {
        let (scan, attributes) = builtin::load(name)?;
        let mut registered = self.register(&scan, None)?;
        if let Some(color) = &attributes.eye_color
            && self.reference.eye_textures.contains_key(color)
        {
            registered.subject.eye_color.clone_from(color);
        }
        registered.subject.attributes = attributes;
        Ok(registered)
    }

    /// The subject of a word on the command line: `builtin:NAME` or a file.
    ///
    /// # Errors
    /// As [`Self::scan`] and [`Self::builtin`].
    pub fn named(&self, word: &str) -> Result<Registered, Error> {
        match word.strip_prefix("builtin:") {
            Some(name) => self.builtin(name),
            None => self.scan(Path::new(word), None, None),
        }
    }

    /// Whether the registration of a scan of a recipe is in the cache; `false` for scans that cannot be read.
    pub(crate) fn is_cached(&self, source: &SubjectSource) -> bool {
        let scan = match source {
            SubjectSource::Scan { file } => io::load_scan(file, None).ok(),
            SubjectSource::Builtin { name } => builtin::load(name).ok().map(|(scan, _)| scan),
            SubjectSource::Sampled { .. } => None,
        };
        scan.is_some_and(|scan| self.cache.has(&self.key(&scan, None)))
    }

    fn register(
        &self,
        scan: &Scan,
        landmarks: Option<&ScanLandmarks>,
    ) -> Result<Registered, Error> {
        let key = self.key(scan, landmarks);
        let stored = self.takes_cached.then(|| self.cache.get(&key)).flatten();
        if let Some(registered) = stored.and_then(|bytes| self.read(&bytes, &scan.path)) {
            self.counts.hit();
            return Ok(registered);
        }
        self.counts.made();
        let mut result = threads::with(|| {
            let registrar = match self.registrar.get() {
                Some(registrar) => registrar,
                None => {
                    let made = Registrar::new(self.reference, self.params.clone())?;
                    self.registrar.get_or_init(|| made)
                }
            };
            registrar.register_with(scan, landmarks)
        })?;
        result.subject.id.clone_from(&scan.name);
        if !self.is_shipped() {
            facile_flow::seat_skull(&mut result.subject, ReferenceHead::embedded());
        }
        let mut bytes = serde_json::to_vec(&result.report).expect("numbers are plain JSON");
        bytes.push(b'\n');
        bytes.extend(result.subject.to_glb(&scan.path, self.reference)?);
        self.cache.put(&key, &bytes);
        self.read(&bytes, &scan.path).ok_or_else(|| Error::Dataset {
            path: scan.path.clone(),
            reason: "the registered subject does not read back".to_owned(),
        })
    }

    fn is_shipped(&self) -> bool {
        std::ptr::eq(self.reference, ReferenceHead::embedded())
    }

    /// How many registrations were made, and how many taken from the cache.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    fn read(&self, bytes: &[u8], path: &Path) -> Option<Registered> {
        let end = bytes.iter().position(|b| *b == b'\n')?;
        Some(Registered {
            report: serde_json::from_slice(&bytes[..end]).ok()?,
            subject: Subject::from_glb(&bytes[end + 1..], path, self.reference).ok()?,
            notices: Vec::new(),
        })
    }

    /// The hash of everything a registration depends on.
    fn key(&self, scan: &Scan, landmarks: Option<&ScanLandmarks>) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        let params = serde_json::to_vec(&self.params).expect("numbers are plain JSON");
        hasher
            .update(CODE.as_bytes())
            .update(&params)
            .update(scan.name.as_bytes());
        let mesh = &scan.mesh;
        let mut add = |bytes: &mut dyn Iterator<Item = [u8; 4]>| {
            let block: Vec<u8> = bytes.flatten().collect();
            hasher
                .update(&(block.len() as u64).to_le_bytes())
                .update(&block);
        };
        let halves = |v: f64| {
            let bits = v.to_bits();
            [bits as u32, (bits >> 32) as u32]
        };
        let positions = mesh.positions.iter().flat_map(|p| [p.x, p.y, p.z]);
        add(&mut positions.flat_map(halves).map(u32::to_le_bytes));
        let points = landmarks.into_iter().flat_map(ScanLandmarks::points);
        let coordinates = points.flat_map(|p| [p.x, p.y, p.z]);
        add(&mut coordinates.flat_map(halves).map(u32::to_le_bytes));
        add(&mut mesh
            .triangles
            .as_flattened()
            .iter()
            .map(|v| v.to_le_bytes()));
        add(&mut mesh
            .texcoords
            .as_flattened()
            .iter()
            .map(|v| v.to_le_bytes()));
        add(&mut mesh
            .texcoord_triangles
            .as_flattened()
            .iter()
            .map(|v| v.to_le_bytes()));
        add(&mut mesh.colors.as_flattened().iter().map(|v| v.to_le_bytes()));
        if !self.is_shipped() {
            let places = self.reference.mesh.positions.iter();
            let coordinates = places.flat_map(|p| [p.x, p.y, p.z]);
            add(&mut coordinates.flat_map(halves).map(u32::to_le_bytes));
            add(&mut (self.reference.texture.texels().as_flattened().iter()).map(|b| [*b, 0, 0, 0]));
        }
        if let Some(texture) = &scan.texture {
            let size = [texture.width() as u32, texture.height() as u32];
            add(&mut size.iter().map(|v| v.to_le_bytes()));
            hasher.update(texture.texels().as_flattened());
        }
        hasher.finalize()
    }
}

/// Adds the bytes of a scan and of the files it names to a hash. Files that cannot be read add nothing: what is wrong
/// with them is found when the scan is registered.
pub(super) fn hash_scan_files(path: &Path, hasher: &mut blake3::Hasher) {
    let mut files = BTreeSet::from([path.to_owned()]);
    collect_companions(path, &mut files);
    for file in files {
        if let Ok(bytes) = std::fs::read(&file) {
            hasher.update(blake3::hash(&bytes).as_bytes());
        }
    }
}

/// Files beside `path` that it names, or that share its stem.
fn collect_companions(path: &Path, files: &mut BTreeSet<PathBuf>) {
    use std::io::Read as _;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut header = Vec::new();
    if let Ok(file) = std::fs::File::open(path) {
        // An unreadable file names nothing.
        let _ = file.take(HEADER_BYTES as u64).read_to_end(&mut header);
    }
    let text = String::from_utf8_lossy(&header);
    let words = text
        .split(|c: char| c.is_whitespace() || c == '"')
        .map(PathBuf::from);
    let stems = COMPANIONS.iter().map(|e| path.with_extension(e));
    let named = words
        .filter(|w| has_companion_extension(w))
        .map(|w| folder.join(w));
    for file in named
        .chain(stems)
        .filter(|f| f.is_file())
        .collect::<Vec<_>>()
    {
        let is_library = file
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("mtl"));
        if files.insert(file.clone()) && is_library {
            collect_companions(&file, files);
        }
    }
}

fn has_companion_extension(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str());
    extension.is_some_and(|e| COMPANIONS.iter().any(|c| c.eq_ignore_ascii_case(e)))
}
