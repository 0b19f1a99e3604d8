"""The report of a run opens in a browser and has its parts."""

import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import pytest

import facile

RECIPE = {
    "dataset": {"name": "report <&>", "seed": 5},
    "image": {"size": [32, 32], "samples": 1},
    "subjects": {"sampled": 1},
    "expression": [{"name": "neutral"}, {"name": "smile"}],
    "view": [{"yaw_deg": [-20, 20]}],
}
SECTIONS = ["summary", "stages", "caches", "skips", "failures", "factors", "certificates", "images"]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    summary = facile.generate(RECIPE, output=folder / "out", report=folder / "report.html", max_failures=0)
    assert summary["made"] == 4 and not summary["gave_up"]
    assert sum(summary["effort"]["equilibria"]) == 1
    return folder / "report.html"


def check(root):
    assert [section.get("id") for section in root.iter("section")] == SECTIONS
    text = "".join(root.itertext())
    assert "report <&>" in text and "relative residual" in text and "neutral" in text
    sources = [element.get("src") for element in root.iter("img")]
    assert sources and all(source.startswith("data:image/png;base64,") for source in sources)


def test_the_report_is_one_well_formed_file(report):
    text = report.read_text()
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
    page = text.replace("<!DOCTYPE html>", "").replace(' xmlns="http://www.w3.org/2000/svg"', "")
    check(ElementTree.fromstring(page))


def browser_of(_):
    names = ["chromium", "chromium-browser", "google-chrome", "chrome"]
    return next((found for name in names if (found := shutil.which(name))), None)


def test_a_browser_shows_all_parts(report, tmp_path, needed):
    browser = needed("a browser (chromium)", browser_of)
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}"]
    shown = subprocess.run([*command, "--dump-dom", report.as_uri()], capture_output=True, text=True, timeout=120)
    for section in SECTIONS:
        assert f'<section id="{section}">' in shown.stdout
    picture = tmp_path / "report.png"
    subprocess.run([*command, f"--screenshot={picture}", report.as_uri()], capture_output=True, timeout=120)
    assert picture.stat().st_size > 10_000
