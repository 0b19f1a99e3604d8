//! The command line: exit codes, and errors that say where and what.

use std::path::Path;
use std::process::{Command, Output};

fn facile(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facile"))
        .args(arguments)
        .current_dir(dir)
        .output()
        .expect("starts")
}

/// Exit code and errors of `gen` on a recipe.
fn refused(recipe: &str) -> (Option<i32>, String) {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("dataset.toml"), recipe).expect("writes");
    let output = facile(dir.path(), &["gen", "dataset.toml"]);
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

const HEAD: &str = "[dataset]\nname = \"x\"\noutput = \"out\"\n[subjects]\nsampled = 1\n";

#[test]
fn a_bad_recipe_ends_with_code_two_and_its_line() {
    let cases = [
        ("[[expression]]\nname = \"a\"\nmuscle = {}\n", "muscle"),
        (
            "[[expression]]\nname = \"a\"\nmuscles = { zygomatic_mayor = 0.5 }\n",
            "zygomatic_major",
        ),
        ("[image]\nsize = [-4, 32]\n", "-4"),
        ("[[view]]\nyaw_deg = [\"left\"]\n", "yaw_deg"),
    ];
    for (addition, wanted) in cases {
        let (code, errors) = refused(&format!("{HEAD}{addition}"));
        assert_eq!(code, Some(2), "{addition}: {errors}");
        assert!(errors.contains(wanted), "{addition}: {errors}");
        assert!(errors.contains("dataset.toml"), "{addition}: {errors}");
    }
}

#[test]
fn a_missing_recipe_is_named() {
    let dir = tempfile::tempdir().expect("makes");
    let output = facile(dir.path(), &["gen", "nowhere.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere.toml"));
}

#[test]
fn a_scan_without_a_face_is_refused_with_the_measure() {
    let dir = tempfile::tempdir().expect("makes");
    let cube = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n\
        f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    std::fs::write(dir.path().join("cube.obj"), cube).expect("writes");
    let output = facile(dir.path(), &["register", "cube.obj", "-o", "out.glb"]);
    assert_eq!(output.status.code(), Some(1));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("cube"), "{errors}");
    assert!(!dir.path().join("out.glb").exists());
}

#[test]
fn the_schema_and_the_plan_are_json() {
    let dir = tempfile::tempdir().expect("makes");
    let schema = facile(dir.path(), &["schema"]);
    let schema: serde_json::Value = serde_json::from_slice(&schema.stdout).expect("JSON");
    assert!(schema["properties"]["dataset"].is_object());
    std::fs::write(dir.path().join("dataset.toml"), HEAD).expect("writes");
    let plan = facile(dir.path(), &["plan", "dataset.toml", "--json"]);
    assert!(
        plan.status.success(),
        "{}",
        String::from_utf8_lossy(&plan.stderr)
    );
    let plan: serde_json::Value = serde_json::from_slice(&plan.stdout).expect("JSON");
    assert!(plan.is_object(), "{plan}");
}

#[test]
fn a_damaged_scan_is_refused_with_file_and_place() {
    let triangle = "v 0 0 0\nv 9 0 0\nv 0 9 0\nvt 0 0\nvt 1 0\nvt 0 1\n";
    let cases = [
        ("empty.obj", String::new(), "empty.obj"),
        ("nan.obj", "v 0 0 nan\n".to_owned(), "nan.obj, line 1"),
        ("far.obj", format!("{triangle}f 1 2 9\n"), "far.obj, line 7"),
        (
            "bare.obj",
            format!("mtllib bare.mtl\n{triangle}usemtl skin\nf 1/1 2/2 3/3\n"),
            "bare.mtl, line 2: the texture `skin.png`",
        ),
    ];
    let dir = tempfile::tempdir().expect("makes");
    let material = "newmtl skin\nmap_Kd skin.png\n";
    std::fs::write(dir.path().join("bare.mtl"), material).expect("writes");
    for (name, content, wanted) in cases {
        std::fs::write(dir.path().join(name), content).expect("writes");
        let output = facile(dir.path(), &["register", name, "-o", "out.glb"]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{name}: {errors}");
        assert!(errors.contains(wanted), "{name}: {errors}");
        assert!(!errors.contains("panicked"), "{name}: {errors}");
    }
}

#[test]
fn an_output_that_cannot_be_written_is_named() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("dataset.toml"), HEAD).expect("writes");
    std::fs::write(dir.path().join("file"), "not a folder").expect("writes");
    let output = facile(dir.path(), &["gen", "dataset.toml", "--output", "file/out"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("file/out"), "{errors}");
    assert!(!errors.contains("panicked"), "{errors}");
}

#[test]
fn a_population_that_is_too_small_is_refused_with_the_numbers() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::create_dir(dir.path().join("faces")).expect("makes");
    std::fs::write(dir.path().join("faces/one.obj"), "v 0 0 0\n").expect("writes");
    let arguments = ["reference", "build", "--population", "faces", "-o", "head"];
    let output = facile(dir.path(), &arguments);
    assert_eq!(output.status.code(), Some(2));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        errors.contains("1 scans") && errors.contains("100"),
        "{errors}"
    );
    assert!(!dir.path().join("head").exists());
}

#[test]
fn a_pose_takes_degrees_and_says_what_is_allowed() {
    let dir = tempfile::tempdir().expect("makes");
    let base = ["pose", "builtin:emi", "-o", "emi.glb"];
    let run = |more: &[&str]| facile(dir.path(), &[&base, more].concat());
    let output = run(&["--gaze", "-12,5", "--report", "emi.json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = std::fs::read(dir.path().join("emi.json")).expect("written");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
    let yaw = report["gaze"]["yaw_rad"].as_f64().expect("a number");
    assert!((yaw.to_degrees() + 12.0).abs() < 1e-9, "{yaw}");
    for (more, wanted) in [
        (["--jaw", "90"], "from 0 to 40"),
        (["--gaze", "50,0"], "from -40 to 40"),
        (["--gaze", "5"], "YAW,PITCH"),
        (["--intensity", "2"], "from 0 to 1"),
    ] {
        let output = run(&more);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(wanted), "{errors}");
    }
}
