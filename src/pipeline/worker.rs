//! Makes samples one after the other, keeping what the next one shares.
//!
//! A worker holds one person, one face, one scene and one traced view, or more of them where asked to. Asked for the
//! samples of a group in order it solves one equilibrium, refits one scene and traces each view once; asked at random it
//! makes the same bytes, and with [`Worker::keep_views`] as fast.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use facile_core::rng::RandomStream;
use facile_core::{Plane, Subject};
use facile_sim::{Pose, Solver};
use facile_trace::{HeadScene, Object, View as TracedView};
use serde_json::Value;

use super::maps::Maps;
use super::truth::ViewTruth;
use super::{Face, Person, Pipeline, Work};
use crate::Error;
use crate::plan::Grid;
use crate::recipe::file::Truth;
use crate::recipe::{Occluder, Recipe, View};
use crate::record::Record;
use crate::write::encode_jpeg;

/// Random streams of sensors: this number with that of the sample. Samples themselves use the streams below.
const SENSOR_STREAMS: u64 = 1 << 62;

/// Occluders of a face that are kept together with its views.
const KEPT_OCCLUDERS: usize = 8;

/// An image with everything that is known of it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The image, 8-bit sRGB, row 0 at the top.
    pub image: Plane<[u8; 3]>,
    /// What is known of it.
    pub record: Record,
    /// The maps that the recipe asks for; shared by the samples that differ in light alone.
    pub maps: Arc<Maps>,
    /// Whether the maps' files are named after this sample.
    pub owns_maps: bool,
    /// 255 times the share of directed light that arrives, if the recipe asks for it: the one map that depends on light.
    pub shadow: Option<Plane<u8>>,
}

/// What a worker knows of the current face.
struct Posed {
    pose: Pose,
    occluder: Option<Occluder>,
    face: Face,
    scene: HeadScene,
    /// What occluders put in front of this face, as far as they are kept.
    occluders: Vec<(Occluder, Vec<Object>)>,
}

/// What a worker knows of a view of the current face.
struct Traced {
    occluder: Occluder,
    view: View,
    traced: TracedView,
    truth: ViewTruth,
}

/// Makes samples.
pub struct Worker {
    pipeline: Arc<Pipeline>,
    grid: Grid,
    solver: Solver,
    person: Option<(u64, Arc<Person>)>,
    posed: Option<Posed>,
    /// Views of the current face, that of the last sample first.
    traced: Vec<Traced>,
    /// Memory for them, bytes; the one of the last sample is kept in any case.
    view_bytes: usize,
    /// The scene of the person before, whose trees the next one takes.
    last: Option<HeadScene>,
}

impl Worker {
    /// A worker that knows nobody yet.
    pub fn new(pipeline: Arc<Pipeline>) -> Self {
        Self {
            grid: Grid::of(pipeline.recipe()),
            pipeline,
            solver: Solver::new(),
            person: None,
            posed: None,
            traced: Vec::new(),
            view_bytes: 0,
            last: None,
        }
    }

    /// The same worker, which keeps as many views of a face, with its occluders, as fit into so many bytes: for samples
    /// that are asked for out of order.
    #[must_use]
    pub fn keep_views(mut self, bytes: usize) -> Self {
        self.view_bytes = bytes;
        self
    }

    /// Lets the oldest views go that do not fit into memory together with the next one.
    fn make_room(&mut self) {
        /// What a view and its maps hold for each pixel, bytes.
        const PIXEL: usize = 80;
        let image = &self.pipeline.recipe().image;
        let each = PIXEL * image.width as usize * image.height as usize;
        let mut bytes = each;
        let fits = self.traced.iter().take_while(|view| {
            bytes += each + view.traced.bytes_for_lights();
            bytes <= self.view_bytes
        });
        let count = fits.count();
        self.traced.truncate(count);
    }

    /// What the samples are made with.
    pub fn pipeline(&self) -> &Arc<Pipeline> {
        &self.pipeline
    }

    /// Gives the worker a person who is prepared already: subject number `subject` of the recipe.
    pub fn set_person(&mut self, subject: u64, person: Arc<Person>) {
        self.person = Some((subject, person));
        self.traced.clear();
        if let Some(posed) = self.posed.take() {
            self.last = Some(posed.scene);
        }
    }

    /// Gives the worker a person unless it is who it works with already.
    pub(crate) fn meet(&mut self, subject: u64, person: &Arc<Person>) {
        let is_known = self
            .person
            .as_ref()
            .is_some_and(|(s, p)| *s == subject && Arc::ptr_eq(p, person));
        if !is_known {
            self.set_person(subject, person.clone());
        }
    }

    /// Lets the next sample be posed anew, so that this can be timed.
    pub(crate) fn forget_face(&mut self) {
        if let Some(posed) = &mut self.posed {
            // A pose that none equals.
            posed.pose.jaw.open_rad = f64::NAN;
        }
    }

    /// Lets the next sample be traced anew, so that this can be timed.
    pub(crate) fn forget_view(&mut self) {
        self.traced.clear();
    }

    /// Makes sample number `index`.
    ///
    /// # Errors
    /// [`Error::Index`] beyond the last sample; whatever a stage reports.
    pub fn sample(&mut self, index: u64) -> Result<Sample, Error> {
        let pipeline = self.pipeline.clone();
        let mut scene = pipeline.recipe().scene(index)?;
        let person = self.person(scene.subject)?;
        let hair = person.hair.as_ref().map(|h| h.color);
        scene.occluder = Cow::Owned(scene.occluder.into_owned().colored(hair));
        self.pose(&person, &scene.expression.pose)?;
        self.trace(&person, &scene.occluder, &scene.view)?;
        let behind = pipeline
            .gallery
            .draw(pipeline.recipe(), index, &scene.lighting)?;
        let (Some(posed), Some(traced)) = (&mut self.posed, self.traced.first()) else {
            unreachable!("both were set above");
        };
        posed.scene.scene.background = behind.color;
        posed.scene.scene.backdrop = behind.backdrop;
        let recipe = pipeline.recipe();
        let mut noise = RandomStream::new(recipe.seed, SENSOR_STREAMS | index);
        let (image, shadow) = pipeline.clock().time(Work::Shading, || {
            let shaded = traced
                .traced
                .shade(&posed.scene.scene, &scene.lighting.sources)?;
            let image = recipe.sensor.develop(&shaded.color, &mut noise);
            let image = match recipe.jpeg_quality {
                Some(quality) => through_jpeg(&image, quality)?,
                None => image,
            };
            let asked = shaded.shadow.filter(|_| recipe.image.wants(Truth::Shadow));
            let shadow = asked.map(|plane| plane.map(|share| (share * 255.0).round() as u8));
            Ok::<_, Error>((image, shadow))
        })?;
        let first = index - index % self.grid.lightings;
        let record = pipeline.record(
            index,
            first,
            &scene,
            &person,
            &posed.face,
            traced.traced.camera(),
            &traced.truth,
            behind.record,
        );
        Ok(Sample {
            image,
            record,
            maps: traced.truth.maps.clone(),
            owns_maps: first == index,
            shadow,
        })
    }

    fn person(&mut self, subject: u64) -> Result<Arc<Person>, Error> {
        if let Some((current, person)) = &self.person
            && *current == subject
        {
            return Ok(person.clone());
        }
        let clock = self.pipeline.clock();
        let person = clock.time(Work::People, || self.pipeline.person(subject))?;
        let person = Arc::new(person);
        self.set_person(subject, person.clone());
        Ok(person)
    }

    fn pose(&mut self, person: &Person, pose: &Pose) -> Result<(), Error> {
        let skips = *self.pipeline.skips();
        let is_known = self.posed.as_ref().is_some_and(|p| p.pose == *pose);
        if is_known && skips.shared_faces {
            return Ok(());
        }
        self.traced.clear();
        let pipeline = &self.pipeline;
        let clock = pipeline.clock();
        let face = clock.time(Work::Equilibria, || {
            pipeline.face(person, pose, &mut self.solver)
        })?;
        // The scene of another expression of this person is refitted, not built again.
        let posed = self.posed.take().filter(|_| skips.moved_scenes);
        let scene = clock.time(Work::Scenes, || {
            let mut scene = match posed {
                Some(posed) => posed.scene,
                None => pipeline.head_scene(person, self.last.take().as_ref())?,
            };
            scene.remove_added();
            pipeline.show_face(&mut scene, pose, &face)?;
            Ok::<_, Error>(scene)
        })?;
        self.posed = Some(Posed {
            pose: pose.clone(),
            occluder: None,
            face,
            scene,
            occluders: Vec::new(),
        });
        Ok(())
    }

    fn trace(&mut self, person: &Person, occluder: &Occluder, view: &View) -> Result<(), Error> {
        self.occlude(occluder)?;
        let Some(posed) = &mut self.posed else {
            unreachable!("a face is posed before it is traced");
        };
        posed.scene.set_closeness(self.pipeline.mm_per_px(view))?;
        let known = self
            .traced
            .iter()
            .position(|t| t.view == *view && t.occluder == *occluder);
        if let Some(known) = known.filter(|_| self.pipeline.skips().shared_views) {
            self.traced[..=known].rotate_right(1);
            return Ok(());
        }
        self.make_room();
        let (pipeline, Some(posed)) = (&self.pipeline, &self.posed) else {
            unreachable!("a face is posed before it is traced");
        };
        let clock = pipeline.clock();
        let traced = clock.time(Work::Tracing, || pipeline.trace(&posed.scene, view))?;
        let truth = clock.time(Work::Truth, || {
            pipeline.truth(&person.subject, &posed.scene, &posed.face, &traced)
        });
        let traced = Traced {
            occluder: occluder.clone(),
            view: *view,
            traced,
            truth,
        };
        self.traced.insert(0, traced);
        Ok(())
    }

    /// Puts an occluder in front of the current face, unless it is there.
    fn occlude(&mut self, occluder: &Occluder) -> Result<(), Error> {
        let pipeline = &self.pipeline;
        let Some(posed) = self.posed.as_mut() else {
            unreachable!("a face is posed before something is put in front of it");
        };
        if posed.occluder.as_ref() == Some(occluder) {
            return Ok(());
        }
        posed.scene.remove_added();
        posed.occluder = None;
        let known = posed.occluders.iter().find(|(o, _)| o == occluder);
        let objects = match known {
            Some((_, objects)) => objects.clone(),
            None => {
                let make = || pipeline.occluder_objects(&posed.scene, occluder);
                let objects = pipeline.clock().time(Work::Scenes, make)?;
                if self.view_bytes > 0 {
                    posed.occluders.truncate(KEPT_OCCLUDERS - 1);
                    posed
                        .occluders
                        .insert(0, (occluder.clone(), objects.clone()));
                }
                objects
            }
        };
        for object in objects {
            let index = posed.scene.scene.add(object);
            if occluder.presses_hair() {
                posed.scene.press_hair(index)?;
            }
        }
        posed.occluder = Some(occluder.clone());
        Ok(())
    }
}

/// An image as it comes out of a JPEG.
fn through_jpeg(image: &Plane<[u8; 3]>, quality: u8) -> Result<Plane<[u8; 3]>, Error> {
    let bytes = encode_jpeg(image, quality)?;
    let decoded = facile_core::io::decode_texture(&bytes, Path::new("image.jpg"))?;
    let (width, height) = (decoded.width(), decoded.height());
    Ok(Plane::from_fn(width, height, |x, y| decoded.texel(x, y)))
}

/// Renders one image of a subject that is there already. `tables` holds the recipe's tables `image`, `sensor`,
/// `hair`, `clothes`, `expression`, `light`, `view`, `background` and `occluder`, each at most once and without the list
/// around it. The subject counts as a scan, which wears hair and clothes if there are tables of them.
///
/// # Errors
/// [`Error::Recipe`] for tables that are wrong; whatever a stage reports.
pub fn render_subject(subject: &Subject, tables: &BTreeMap<&str, Value>) -> Result<Sample, Error> {
    let mut recipe = serde_json::json!({
        "dataset": { "name": "render" },
        "subjects": { "sampled": 1 },
    });
    for (name, table) in tables {
        recipe[*name] = match *name {
            "image" | "sensor" | "hair" | "clothes" => table.clone(),
            _ => Value::Array(vec![table.clone()]),
        };
    }
    // Who is given hair or clothes wears them, wherever the subject comes from
    for name in ["hair", "clothes"] {
        if let Some(table) = recipe.get_mut(name).and_then(Value::as_object_mut) {
            table
                .entry("on")
                .or_insert_with(|| serde_json::json!(["scan"]));
        }
    }
    let pipeline = Arc::new(Pipeline::new(Recipe::from_json(&recipe, Path::new(""))?)?);
    let person = Person::new(subject.clone(), "given", None, Vec::new());
    let person = pipeline.dressed(person, 0);
    let mut worker = Worker::new(pipeline);
    worker.set_person(0, Arc::new(person));
    worker.sample(0)
}
