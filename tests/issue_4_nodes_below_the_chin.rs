//! An open jaw carried nodes below the chin across the cylinder's axis, where the skull's height field means nothing: they
//! were held there by a contact that turned with every step, and the face found no rest. Seen on one person at 26 degrees.

use facile::pipeline::{PosedHead, Registrations, face_model};
use facile::sim::Pose;

#[test]
fn a_jaw_may_carry_nodes_across_the_axis() {
    let carmen = Registrations::new().builtin("carmen").expect("registers");
    let model = face_model(&carmen.subject).expect("carries muscles");
    let mut pose = Pose::default();
    pose.jaw.open_rad = 26f64.to_radians();
    let posed = PosedHead::solve(&model, &pose).expect("finds its equilibrium");
    assert!(posed.equilibrium.certificate.iterations < 1_000);
}
