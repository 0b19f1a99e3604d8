//! Times of the physics on the mean head: building a model, cold solves from mild to extreme, a ladder of intensities.

#![allow(
    missing_docs,
    reason = "criterion's macros make public functions without them"
)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use facile_core::ReferenceHead;
use facile_sim::{
    ExpressionSet, FaceRig, MuscleSet, Pose, Solver, SolverKind, SolverParams, mean_subject,
};

fn pose(name: &str) -> Pose {
    let expression = ExpressionSet::embedded().get(name).expect("built in");
    expression.pose(MuscleSet::embedded()).expect("valid")
}

fn sim(criterion: &mut Criterion) {
    let reference = ReferenceHead::embedded();
    let rig = FaceRig::new(reference, MuscleSet::embedded()).expect("built in");
    let subject = mean_subject(reference);
    let model = rig.model(reference, &subject).expect("the mean head");
    let mut group = criterion.benchmark_group("sim");
    group.sample_size(10);
    group.bench_function("model/new_subject", |b| {
        b.iter(|| rig.model(reference, black_box(&subject)).expect("valid"));
    });
    let mut solver = Solver::new();
    let mild = pose("anger").scaled(0.3);
    for (name, pose) in [
        ("mild", mild),
        ("smile", pose("smile")),
        ("surprise", pose("surprise")),
    ] {
        for kind in SolverKind::ALL {
            let params = SolverParams::of(kind);
            group.bench_function(format!("{}/{name}", kind.name()), |b| {
                b.iter(|| solver.solve(&model, &pose, &params).expect("converges"));
            });
        }
    }
    let rungs: Vec<f64> = (1..=10).map(|k| f64::from(k) / 10.0).collect();
    let smile = pose("smile");
    group.bench_function("quasi_static/ladder_of_10", |b| {
        b.iter(|| solver.solve_ladder(&model, &smile, &rungs, &SolverParams::default()));
    });
    group.finish();
}

criterion_group!(benches, sim);
criterion_main!(benches);
