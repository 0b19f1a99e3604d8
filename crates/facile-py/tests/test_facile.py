"""The Python package against its documentation."""

import numpy as np
import pytest

import facile

RECIPE = {
    "dataset": {"name": "small", "seed": 3},
    "image": {"size": [40, 32], "samples": 1, "truth": ["landmarks", "segments", "depth", "normals"]},
    "subjects": {"sampled": 1},
    "expression": [{"name": "neutral"}],
    "view": [{"yaw_deg": [0, 30]}],
}


@pytest.fixture(scope="module")
def subject():
    return facile.Subject.sample(0, seed=7)


def test_a_dataset_makes_samples_on_demand():
    dataset = facile.Dataset(RECIPE)
    assert len(dataset) == 2
    sample = dataset[1]
    assert sample["image"].shape == (32, 40, 3)
    assert sample["image"].dtype == np.uint8
    assert sample["segments"].shape == (32, 40)
    assert sample["normals"].shape == (32, 40, 3)
    depth = sample["depth_mm"]
    hit = sample["segments"] > 0
    assert hit.any() and np.isfinite(depth[hit]).all() and not np.isfinite(depth[~hit]).any()
    assert len(sample["record"]["landmarks"]["ibug68"]["px"]) == 68
    assert np.array_equal(dataset[-1]["image"], sample["image"])
    with pytest.raises(IndexError):
        dataset[2]


def test_files_hold_what_the_dataset_gives(tmp_path):
    calls = []
    summary = facile.generate(RECIPE, output=tmp_path / "out", progress=lambda done, total: calls.append((done, total)))
    assert summary["made"] == 2 and summary["failures"] == []
    assert (tmp_path / "out" / "images" / "000001.png").exists()
    again = facile.generate(RECIPE, output=tmp_path / "out")
    assert (again["kept"], again["made"]) == (2, 0)


def test_muscles_move_the_face(subject):
    rest = subject.vertices
    face = subject.pose(muscles={"zygomatic_major": 0.6}, jaw_deg=2)
    assert face.vertices.shape == rest.shape
    assert face.faces.max() == len(rest) - 1
    moved = np.linalg.norm(face.vertices - rest, axis=1)
    assert 1 < moved.max() < 40
    assert face.certificate["residual"] < 1e-2
    mouth = face.landmarks("ibug68")[[48, 54]]
    assert mouth.shape == (2, 3) and mouth[0, 0] < 0 < mouth[1, 0]


def test_a_subject_reads_back(subject, tmp_path):
    subject.save(tmp_path / "head.glb")
    again = facile.Subject.load(tmp_path / "head.glb")
    assert np.array_equal(again.vertices, subject.vertices)
    assert np.array_equal(again.texture, subject.texture)


def test_a_subject_is_rendered(subject):
    sample = facile.render(subject, view={"yaw_deg": [20]}, image={"size": [48, 48], "samples": 1})
    assert sample["image"].shape == (48, 48, 3)
    assert sample["image"].std() > 10


def test_a_render_wears_what_it_is_told(subject):
    size = {"size": [64, 64], "samples": 1, "truth": ["segments", "albedo", "reference", "shadow", "instances"]}
    bare = facile.render(subject, image=size)
    worn = facile.render(
        subject,
        image=size,
        hair={"styles": ["bob01"], "colors": [[150, 60, 30]]},
        clothes={"colors": [[20, 90, 200]]},
        background={"kind": "color", "color": [1, 2, 3]},
        occluder={"kind": "glasses"},
        view={"projection": "orthographic"},
    )
    hair, clothes = 23, 24
    assert not np.isin(bare["segments"], [hair, clothes]).any()
    assert (worn["segments"] == hair).sum() > 100 and (worn["segments"] == clothes).any()
    # The shirt's own colour, whatever the light
    linear = ((np.array([20, 90, 200]) / 255 + 0.055) / 1.055) ** 2.4
    assert np.allclose(worn["albedo"][worn["segments"] == clothes], linear, atol=1e-3)
    assert worn["record"]["subject"]["hair"] == {"style": "bob01", "color": [150, 60, 30]}
    assert worn["record"]["camera"]["projection"] == "orthographic"
    assert (worn["image"][worn["segments"] == 0] == [1, 2, 3]).all()
    assert worn["albedo"].shape == (64, 64, 3) and worn["albedo"].dtype == np.float32
    assert worn["reference"].shape == (64, 64, 2)
    skin = np.isfinite(worn["reference"][..., 0])
    assert skin[worn["segments"] == 7].all() and not skin[worn["segments"] == 0].any()
    assert set(np.unique(worn["instances"])) == {0, 1, 2}
    assert worn["shadow"].shape == (64, 64) and worn["shadow"].dtype == np.uint8
    darker = facile.render(subject, image=size, sensor={"exposure_stops": -2})
    assert darker["image"].mean() < 0.8 * bare["image"].mean()
    lens = facile.render(subject, image={"size": [64, 64], "samples": 4}, view={"aperture_mm": 30})
    assert lens["record"]["camera"]["aperture_mm"] == 30
    with pytest.raises(facile.RecipeError, match="mohawk"):
        facile.render(subject, hair={"styles": ["mohawk"]})


def test_errors_say_what_is_wrong(subject):
    with pytest.raises(facile.SimError, match="zygomatic_mayor"):
        subject.pose(muscles={"zygomatic_mayor": 0.5})
    with pytest.raises(facile.RecipeError, match="sizes"):
        facile.Dataset({**RECIPE, "image": {"sizes": [3, 3]}})
    with pytest.raises(facile.FacileError, match="nowhere.obj"):
        facile.Subject.load("nowhere.obj")
    assert issubclass(facile.CoreError, facile.FacileError)


def test_names_and_schema():
    assert len(facile.Subject.builtin_names()) == 12
    assert "dataset" in facile.schema()["properties"]
