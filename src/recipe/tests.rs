use std::path::Path;

use super::*;

fn parse(body: &str) -> Result<Recipe, Error> {
    let text = format!("[dataset]\nname = \"t\"\n{body}");
    Recipe::parse(&text, Path::new("t.toml"), Path::new(""))
}

/// The error of a recipe whose text after the first two lines is `body`.
fn error(body: &str) -> RecipeError {
    match parse(body) {
        Err(Error::Recipe(e)) => *e,
        Err(e) => panic!("not an error of the recipe: {e}"),
        Ok(_) => panic!("the recipe was accepted: {body}"),
    }
}

const ONE: &str = "[subjects]\nsampled = 1\n";

#[test]
fn a_minimal_recipe_has_one_frontal_neutral_image() {
    let recipe = parse(ONE).expect("valid");
    assert_eq!(crate::plan::Grid::of(&recipe).len(), 1);
    assert_eq!(recipe.expressions[0].name, "neutral");
    assert!(recipe.expressions[0].pose.is_neutral());
    assert_eq!(recipe.occluders, [Occluder::None]);
}

#[test]
fn unknown_keys_are_refused_with_the_probable_one() {
    let e = error("[image]\nsise = [64, 64]\n[subjects]\nsampled = 1\n");
    assert_eq!((e.line, e.column), (4, 1));
    assert_eq!(e.message, "unknown key `sise`");
    assert!(e.help.expect("help").starts_with("did you mean `size`?"));
}

#[test]
fn unknown_muscles_are_refused_with_the_probable_one() {
    let e = error(&format!(
        "{ONE}[[expression]]\nname = \"x\"\nmuscles = {{ zygomatic_mayor = 0.5 }}\n"
    ));
    assert_eq!(e.line, 7);
    assert_eq!(e.message, "unknown muscle `zygomatic_mayor`");
    assert!(
        e.help
            .expect("help")
            .starts_with("did you mean `zygomatic_major`?")
    );
}

#[test]
fn a_side_may_follow_the_muscle() {
    let body = format!(
        "{ONE}[[expression]]\nname = \"x\"\nmuscles = {{ \"risorius.left\" = 0.5 }}\nintensities = [0.5, 1]\n"
    );
    let recipe = parse(&body).expect("valid");
    assert_eq!(recipe.expressions.len(), 2);
    let sides = recipe.expressions[0].pose.contractions["risorius"];
    assert_eq!((sides.left, sides.right), (0.25, 0.0));
}

#[test]
fn values_out_of_range_are_refused_where_they_stand() {
    let cases = [
        (
            "[image]\nsize = [64, -64]\n[subjects]\nsampled = 1\n",
            4,
            13,
        ),
        ("[image]\nsamples = 0\n[subjects]\nsampled = 1\n", 4, 11),
        (
            "[image]\nsamples = \"many\"\n[subjects]\nsampled = 1\n",
            4,
            11,
        ),
        (
            "[image]\nbackground = [0, 0, 256]\n[subjects]\nsampled = 1\n",
            4,
            21,
        ),
        (
            "[image]\nlandmarks = [\"ibug\"]\n[subjects]\nsampled = 1\n",
            4,
            14,
        ),
        ("[subjects]\nsampled = -1\n", 4, 11),
        ("[subjects]\nbuiltin = [\"adda\"]\n", 4, 12),
        ("[subjects]\nscans = [\"no/such/*.obj\"]\n", 4, 10),
    ];
    for (body, line, column) in cases {
        let e = error(body);
        assert_eq!((e.line, e.column), (line, column), "{e}");
    }
    let scene = [
        ("[[expression]]\nname = \"smirk\"\n", 6, 8),
        (
            "[[expression]]\nname = \"smile\"\nintensities = [0.5, 1.5]\n",
            7,
            21,
        ),
        ("[[expression]]\nname = \"smile\"\njaw_deg = 90\n", 7, 11),
        (
            "[[expression]]\nname = \"x\"\naction_units = { AU3 = 1 }\n",
            7,
            24,
        ),
        ("[[view]]\nyaw_deg = [nan]\n", 6, 12),
        ("[[view]]\nfov_y_deg = 0\n", 6, 13),
        ("[[occluder]]\nkind = \"none\"\nsize = 1.0\n", 7, 8),
        ("[[occluder]]\nkind = \"glasses\"\nsize = 2.0\n", 7, 8),
        ("[[light]]\nname = \"a\"\nsources = []\n", 7, 11),
        (
            "[[light]]\nname = \"a\"\nsources = [{ kind = \"point\" }]\n",
            7,
            12,
        ),
        (
            "[[light]]\nname = \"a\"\nsources = [{ kind = \"ambient\", position = [0, 0, 1] }]\n",
            7,
            43,
        ),
        (
            "[[light]]\nname = \"a\"\nsources = [{ kind = \"directional\", direction = [0, 0, 0] }]\n",
            7,
            48,
        ),
        (
            "[[light]]\nname = \"a\"\nsources = [{ kind = \"area\", position = [0, 0, 9], target = [0, 0, 0] }]\n",
            7,
            12,
        ),
        (
            "[[light]]\nname = \"a\"\nsources = [{ kind = \"hemisphere\", position = [0, 0, 1] }]\n",
            7,
            46,
        ),
        ("[sensor]\nblur_px = 99\n", 6, 11),
    ];
    for (body, line, column) in scene {
        let e = error(&format!("{ONE}{body}"));
        assert_eq!((e.line, e.column), (line, column), "{e}");
    }
}

#[test]
fn a_recipe_without_subjects_says_what_it_lacks() {
    let e = error("[subjects]\n");
    assert_eq!(e.message, "the recipe names no subjects");
    let e = error("");
    assert_eq!(e.message, "the key `subjects` is missing");
}

#[test]
fn grids_of_billions_are_checked_without_being_built() {
    let recipe = parse(&format!(
        "[subjects]\nsampled = 1000000000\n[[view]]\nyaw_deg = [{}]\n",
        vec!["0"; 100].join(", ")
    ))
    .expect("valid");
    assert_eq!(crate::plan::Grid::of(&recipe).len(), 100_000_000_000);
    let views = "[[view]]\nyaw_deg = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]\n\
        pitch_deg = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]\nroll_deg = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n";
    let e = error(&format!("[subjects]\nsampled = 1000000000\n{views}"));
    assert!(e.message.contains("more than"), "{e}");
}

#[test]
fn a_recipe_cannot_write_outside_the_current_folder() {
    for output in ["/etc/x", "../x", "a/../../x"] {
        let text = format!("[dataset]\nname = \"t\"\noutput = \"{output}\"\n{ONE}");
        let error = Recipe::parse(&text, Path::new("t.toml"), Path::new("")).expect_err(output);
        assert!(error.to_string().starts_with("t.toml:3:10: "), "{error}");
    }
}

#[test]
fn combinations_are_counted_before_they_are_made() {
    let angles = vec!["0"; 20_000].join(", ");
    let list = |key: &str| format!("{key} = [{angles}]\n");
    let views = ["yaw_deg", "pitch_deg", "roll_deg"].map(list).concat();
    let e = error(&format!("{ONE}[[view]]\n{views}"));
    assert!(e.message.contains("more than 1000000 combinations"), "{e}");
}

#[test]
fn all_subjects_come_once_and_in_order() {
    let known = facile_core::builtin::names();
    let last = known[known.len() - 1];
    let body = format!("[subjects]\nbuiltin = [\"{last}\", \"all\"]\nsampled = 2\n");
    let recipe = parse(&body).expect("valid");
    assert_eq!(recipe.subjects.builtin.len(), known.len());
    assert_eq!(recipe.subjects.builtin[..2], [last, known[0]]);
    let last = SubjectSource::Sampled { number: 1 };
    assert_eq!(recipe.subjects.get(recipe.subjects.len() - 1), last);
}

#[test]
fn the_schema_names_every_table() {
    let schema = schema();
    let properties = schema["properties"].as_object().expect("an object");
    for table in [
        "dataset",
        "image",
        "subjects",
        "expression",
        "light",
        "view",
        "occluder",
        "sampling",
    ] {
        assert!(properties.contains_key(table), "{table}");
    }
}

#[test]
fn hair_and_clothes_are_checked() {
    let recipe = parse(ONE).expect("valid");
    assert!(recipe.hair.lashes && recipe.hair.styles.is_empty());
    let e = error(&format!("[hair]\nstyles = [\"bob03\"]\n{ONE}"));
    assert_eq!(
        (e.line, e.message.as_str()),
        (4, "unknown hair style `bob03`")
    );
    assert!(e.help.expect("help").starts_with("did you mean `bob0"));
    let bare = parse(&format!("[hair]\non = []\n[clothes]\non = []\n{ONE}")).expect("valid");
    assert!(bare.hair.on.is_empty() && bare.clothes.on.is_empty());
}

#[test]
fn backgrounds_are_checked() {
    let e = error(&format!(
        "{ONE}[[background]]\nkind = \"gradient\"\ncolor = [1, 2, 3]\n"
    ));
    assert!(e.message.contains("needs the key `bottom`"), "{e}");
    let e = error(&format!(
        "{ONE}[[background]]\nkind = \"room\"\nblur = 0.5\n"
    ));
    assert_eq!(
        (e.line, e.message.as_str()),
        (7, "blur must be from 0 to 0.2, found 0.5")
    );
    let e = error(&format!(
        "{ONE}[[background]]\nkind = \"room\"\ncolor = [1, 2, 3]\n"
    ));
    assert_eq!(e.line, 7);
    let e = error(&format!(
        "{ONE}[[background]]\nkind = \"images\"\nfiles = [\"none/*.jpg\"]\n"
    ));
    assert!(e.message.contains("no file matches"), "{e}");
    let e = error(&format!(
        "{ONE}[[background]]\nkind = \"room\"\nweight = 0\n"
    ));
    assert!(e.message.contains("weight over 0"), "{e}");
}

#[test]
fn surroundings_are_read_and_checked() {
    let light =
        "[[light]]\nname = \"sky\"\nsources = [{ kind = \"environment\", file = \"no.hdr\" }]\n";
    let e = error(&format!("{ONE}{light}"));
    assert!(e.line == 7 && e.message.contains("no.hdr"), "{e}");
    let short = "[[light]]\nname = \"x\"\nsources = [{ kind = \"spherical_harmonic\", coefficients = [[1, 1, 1]] }]\n";
    let e = error(&format!("{ONE}{short}"));
    assert!(e.message.starts_with("nine coefficients"), "{e}");
}

#[test]
fn occluders_take_the_keys_of_their_kind() {
    let hand = "[[occluder]]\nkind = \"hand\"\nx_mm = 20\nturn_deg = 15\nsize = 1.1\n";
    let recipe = parse(&format!("{ONE}{hand}")).expect("valid");
    let Occluder::Prop(prop) = &recipe.occluders[0] else {
        panic!("a hand is a prop: {:?}", recipe.occluders);
    };
    assert_eq!((prop.x_mm, prop.turn_deg, prop.size), (20.0, 15.0, 1.1));
    assert_eq!(recipe.occluders[0].kind(), "hand");
    let e = error(&format!("{ONE}[[occluder]]\nkind = \"hat\"\nx_mm = 20\n"));
    assert_eq!(e.line, 7);
    let e = error(&format!(
        "{ONE}[[occluder]]\nkind = \"bar\"\nturn_deg = 200\n"
    ));
    assert_eq!(e.message, "turn_deg must be from -180 to 180, found 200");
    let e = error(&format!("{ONE}[[occluder]]\nkind = \"model\"\n"));
    assert!(e.message.contains("needs the key `file`"), "{e}");
    let e = error(&format!(
        "{ONE}[[occluder]]\nkind = \"model\"\nfile = \"none.glb\"\n"
    ));
    assert!(e.line == 7 && e.message.contains("none.glb"), "{e}");
}

#[test]
fn views_shift_and_sensors_compress_within_bounds() {
    let e = error(&format!("{ONE}[[view]]\nshift = [0.1, 3]\n"));
    assert_eq!(e.message, "shift must be from -1 to 1, found 3");
    let e = error(&format!("[sensor]\njpeg_quality = 101\n{ONE}"));
    assert_eq!(e.message, "jpeg_quality must be from 0 to 100, found 101");
}
