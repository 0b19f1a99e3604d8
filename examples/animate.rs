//! Contracts muscles by hand: `cargo run --release --example animate -- OUT_DIR`.
//!
//! Draws one person from the identity model and lifts one corner of the mouth in five steps. Every step is an
//! equilibrium of skin, fascia and skull; its certificate says how exact. Writes one GLB for each.

use std::error::Error;
use std::path::PathBuf;

use facile::core::ReferenceHead;
use facile::core::identity::IdentityModel;
use facile::pipeline::{PosedHead, face_model};
use facile::sim::{MuscleSet, Pose};

fn main() -> Result<(), Box<dyn Error>> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        return Err("usage: animate OUT_DIR".into());
    };
    std::fs::create_dir_all(&folder)?;
    let reference = ReferenceHead::embedded();
    let (seed, number) = (7, 0);
    let subject = IdentityModel::embedded().sample(reference, seed, number)?;
    let model = face_model(&subject)?;
    let muscles = MuscleSet::embedded();
    for step in 1..=5 {
        let contraction = f64::from(step) / 5.0;
        let mut pose = Pose::default();
        pose.set(muscles, "zygomatic_major.left", contraction)?;
        pose.set(muscles, "risorius.left", 0.3 * contraction)?;
        pose.jaw.open_rad = (4.0 * contraction).to_radians();
        let posed = PosedHead::solve(&model, &pose)?;
        let moved = posed
            .equilibrium
            .positions
            .iter()
            .zip(&subject.positions)
            .map(|(p, q)| (p - q).norm())
            .fold(0.0, f64::max);
        let certificate = &posed.equilibrium.certificate;
        eprintln!(
            "contraction {contraction:.1}: moves up to {moved:.1} mm, residual {:.0e}, penetration {:.3} mm",
            certificate.residual, certificate.max_penetration_mm,
        );
        posed.save(
            &folder.join(format!("smirk_{step}.glb")),
            &subject,
            reference,
        )?;
    }
    Ok(())
}
