"""Every format, read back by the reader that its users have."""

import json
import pickle

import numpy as np
import pytest

import facile

RECIPE = {
    "dataset": {"name": "formats", "seed": 5, "formats": ["folder", "webdataset", "parquet"], "images_per_shard": 3, "coco": True},
    "image": {"size": [48, 40], "samples": 1, "truth": ["landmarks", "segments", "depth"]},
    "subjects": {"sampled": 2},
    "expression": [{"name": "neutral"}],
    "view": [{"yaw_deg": [-20, 20]}],
    "light": [
        {"name": "a", "sources": [{"kind": "point", "position": [400, 200, 800]}]},
        {"name": "b", "sources": [{"kind": "ambient", "intensity": 0.8}]},
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("formats") / "out"
    summary = facile.generate(RECIPE, output=folder)
    assert summary["made"] == 8
    return folder


@pytest.fixture(scope="module")
def records(folder):
    return [json.loads(line) for line in (folder / "annotations.jsonl").read_text().splitlines()]


def test_webdataset_reads_images_records_and_maps(folder, records, needed):
    webdataset = needed("webdataset")
    urls = [str(path) for path in sorted((folder / "webdataset").iterdir())]
    assert len(urls) == 3
    samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode("rgb8"))
    assert [int(s["__key__"]) for s in samples] == list(range(8))
    memory = facile.Dataset(RECIPE)
    for i, sample in enumerate(samples):
        assert sample["json"] == records[i]
        assert np.array_equal(sample["png"], memory[i]["image"])
        # Decoders for images make three channels of one.
        assert np.array_equal(sample["segments.png"][..., 0], memory[i]["segments"])


def test_datasets_opens_parquet_with_typed_images_and_labels(folder, records, tmp_path, needed):
    datasets = needed("datasets")
    files = [str(path) for path in sorted((folder / "parquet").iterdir())]
    assert len(files) == 3
    table = datasets.load_dataset("parquet", data_files=files, split="train", cache_dir=str(tmp_path))
    features = table.features
    assert isinstance(features["image"], datasets.Image) and isinstance(features["segments"], datasets.Image)
    assert features["expression"].names == ["neutral"] and features["light"].names == ["a", "b"]
    memory = facile.Dataset(RECIPE)
    assert len(table) == 8
    for i, row in enumerate(table):
        assert np.array_equal(np.asarray(row["image"]), memory[i]["image"])
        assert np.array_equal(np.asarray(row["segments"]), memory[i]["segments"])
        assert json.loads(row["record"]) == records[i]
        assert features["light"].int2str(row["light"]) == records[i]["light"]["name"]
        landmarks = records[i]["landmarks"]["ibug68"]
        assert row["ibug68_px"] == landmarks["px"] and row["ibug68_mm"] == landmarks["mm"]
        names = features["ibug68_visibility"].feature.names
        assert [names[v] for v in row["ibug68_visibility"]] == landmarks["visibility"]
        assert row["face_box_px"] == records[i]["face_box_px"]


def test_arrow_reads_the_tables_as_they_are(folder, needed):
    parquet = needed("pyarrow.parquet")
    files = [parquet.ParquetFile(path) for path in sorted((folder / "parquet").iterdir())]
    assert [file.metadata.num_rows for file in files] == [3, 3, 2]
    assert [i for file in files for i in file.read(["index"])["index"].to_pylist()] == list(range(8))


def test_coco_tools_read_boxes_keypoints_and_masks(folder, records, needed):
    coco = needed("pycocotools.coco").COCO(str(folder / "coco.json"))
    memory = facile.Dataset(RECIPE)
    assert coco.getImgIds() == list(range(8))
    [category] = coco.loadCats(coco.getCatIds())
    assert category["name"] == "face" and len(category["keypoints"]) == 68
    for i in coco.getImgIds():
        [annotation] = coco.loadAnns(coco.getAnnIds(imgIds=[i]))
        mask = coco.annToMask(annotation)
        segments = memory[i]["segments"]
        assert mask.shape == segments.shape and mask.sum() == annotation["area"]
        # Nothing in the mask but head, and all of the nose.
        assert (segments[mask == 1] > 0).all() and (mask[segments == 7] == 1).all() and (segments == 7).any()
        px = np.array(records[i]["landmarks"]["ibug68"]["px"])
        keypoints = np.array(annotation["keypoints"]).reshape(68, 3)
        labelled = keypoints[:, 2] > 0
        assert np.allclose(keypoints[labelled, :2], px[labelled])
        assert annotation["num_keypoints"] == labelled.sum()


def test_parts_merge_and_verify(folder, tmp_path):
    parts = [tmp_path / "1", tmp_path / "2"]
    for i, part in enumerate(parts, 1):
        facile.generate(RECIPE, output=part, shard=f"{i}/2")
    manifest = facile.merge(parts, tmp_path / "whole")
    assert manifest["complete"] and manifest["written"] == 8
    assert (tmp_path / "whole" / "checksums.b3").read_text() == (folder / "checksums.b3").read_text()
    assert facile.verify(tmp_path / "whole")["bad"] == []
    image = tmp_path / "whole" / "images" / "000003.png"
    image.unlink()
    image.write_bytes(b"damaged")
    [bad] = facile.verify(tmp_path / "whole")["bad"]
    assert bad["path"] == str(image)
    with pytest.raises(ValueError, match="I/N"):
        facile.generate(RECIPE, output=tmp_path / "x", shard="3/2")


def test_a_dataset_pickles_as_its_recipe():
    dataset = facile.Dataset(RECIPE)
    again = pickle.loads(pickle.dumps(dataset))
    assert again.recipe_hash == dataset.recipe_hash
    assert np.array_equal(again[5]["image"], dataset[5]["image"])


def test_croissant_describes_the_records_to_its_own_reader(folder, records, needed):
    mlcroissant = needed("mlcroissant")
    dataset = mlcroissant.Dataset(jsonld=str(folder / "croissant.json"))
    assert dataset.metadata.name == "formats"
    names = {resource.name for resource in dataset.metadata.distribution}
    assert names == {"annotations.jsonl", "images", "webdataset", "parquet", "coco.json"}
    read = list(dataset.records("records"))
    assert len(read) == 8
    for row, record in zip(read, records):
        assert row["records/index"] == record["index"]
        assert row["records/image"].decode() == record["image"]
        assert row["records/subject"].decode() == record["subject"]["id"]
        assert row["records/light"].decode() == record["light"]["name"]
        assert row["records/yaw_deg"] == pytest.approx(record["head_pose"]["yaw_deg"])
        assert row["records/face_box_px"] == pytest.approx(record["face_box_px"])


def test_lossless_webp_and_jpeg_hold_the_image(tmp_path):
    from PIL import Image

    for encoding, most in (("webp", 0), ("jpeg", 40)):
        recipe = {**RECIPE, "image": {**RECIPE["image"], "encoding": encoding}}
        recipe["dataset"] = {"name": encoding, "seed": 5}
        facile.generate(recipe, output=tmp_path / encoding, limit=1)
        [file] = (tmp_path / encoding / "images").iterdir()
        read = np.asarray(Image.open(file)).astype(int)
        assert np.abs(read - facile.Dataset(recipe)[0]["image"].astype(int)).max() <= most


def test_a_contact_sheet_shows_every_image_of_a_small_dataset(folder):
    from PIL import Image

    sheet = np.asarray(Image.open(folder / "contact_sheet.png"))
    memory = facile.Dataset(RECIPE)
    assert sheet.shape == (2 * 48, 6 * 48, 3)
    for i in range(8):
        top, left = 48 * (i // 6) + 4, 48 * (i % 6)
        assert np.array_equal(sheet[top : top + 40, left : left + 48], memory[i]["image"])
    assert "contact_sheet.png" in (folder / "checksums.b3").read_text()
    assert "](contact_sheet.png)" in (folder / "dataset_card.md").read_text()
