# SPDX-License-Identifier: MIT
import json

import pytest
from claiming import claim
from scans import files_below, write_sequence

from salsanext_cli import __version__
from salsanext_cli.classes import label_space
from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.sensors import sensor
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.point_files import write_array
from salsanext_cli.storage.sources import remembered_scans
from salsanext_cli.storage.stage_records import (
    origins,
    owner,
    recorded_label_space,
    recorded_sensor,
    stage_settings,
)

SETTINGS = {"weights": "abc", "knn": {"k": 5}}


def claim_predict(out, settings=SETTINGS, writes=("predictions",), scans=(), overwrite=False):
    claim(out, "predict", settings, writes, scans, overwrite=overwrite)


def test_what_is_recorded(tmp_path):
    claim_predict(tmp_path / "out")
    manifest = json.loads((tmp_path / "out/predict.json").read_text())
    assert manifest == {
        "stage": "predict",
        "version": __version__,
        "settings": SETTINGS,
        "writes": ["predictions"],
    }
    assert stage_settings(tmp_path / "out", "predict") == SETTINGS
    assert stage_settings(tmp_path / "out", "project") is None
    assert owner(tmp_path / "out", "predictions") == "predict"
    assert owner(tmp_path / "out", "range") is None


def test_the_same_settings_may_go_on_and_write_more(tmp_path):
    claim_predict(tmp_path)
    claim_predict(tmp_path, writes=("predictions", "pixel_labels"))
    claim_predict(tmp_path)
    assert owner(tmp_path, "pixel_labels") == "predict"


def test_other_settings_are_refused_and_named(tmp_path):
    claim_predict(tmp_path)
    before = files_below(tmp_path)
    with pytest.raises(OutputError, match=r"knn\.k was 5 and is 7") as caught:
        claim_predict(tmp_path, {"weights": "abc", "knn": {"k": 7}})
    assert "weights" not in caught.value.found
    assert "--overwrite" in caught.value.remedy
    assert files_below(tmp_path) == before


def test_settings_that_come_or_go_are_named_too(tmp_path):
    claim_predict(tmp_path)
    with pytest.raises(OutputError, match=r"knn\.k was 5 and is null, seed was null and is 3"):
        claim_predict(tmp_path, {"weights": "abc", "seed": 3})


def test_overwriting_removes_results_of_other_settings_and_nothing_else(tmp_path, world):
    claim_predict(world.out)
    world.predict_by_hand()
    mine = world.result("predictions").with_name("notes.txt")
    mine.write_text("mine")
    claim_predict(world.out, {"weights": "new"}, overwrite=True)
    kept = [name for name in files_below(world.out) if not name.endswith("predict.json")]
    assert kept == ["sequences/08/predictions/notes.txt"]


def test_overwriting_with_the_same_settings_removes_nothing(world):
    claim_predict(world.out)
    world.predict_by_hand()
    claim_predict(world.out, overwrite=True)
    assert world.result("predictions").exists()


def test_results_of_another_stage_are_refused(world):
    claim_predict(world.out)
    world.predict_by_hand()
    with pytest.raises(OutputError, match="predictions/ holds the results of `predict`"):
        claim(world.out, "knn-refine", {}, ["predictions"], overwrite=False)
    assert world.result("predictions").exists()
    claim(world.out, "knn-refine", {}, ["predictions"], overwrite=True)
    assert owner(world.out, "predictions") == "knn-refine"
    assert not world.result("predictions").exists()


def test_an_infinite_setting_is_recorded_as_json_can(tmp_path):
    for _ in range(2):
        claim_predict(tmp_path, {"cutoff": float("inf")})
    text = (tmp_path / "predict.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["settings"] == {"cutoff": "Infinity"}


@pytest.mark.parametrize(
    "content",
    [
        *(b"{", b"[]", b"\xff\xfe", b"null", b"{}", b'{"settings": {}}', b'{"writes": []}'),
        b'{"settings": {}, "writes": ["elsewhere"]}',
        b'{"settings": {}, "writes": [[]]}',
    ],
)
def test_damaged_records_are_named(tmp_path, content):
    (tmp_path / "predict.json").write_bytes(content)
    with pytest.raises(OutputError, match=r"predict\.json"):
        claim_predict(tmp_path)
    with pytest.raises(OutputError, match=r"predict\.json"):
        owner(tmp_path, "predictions")


def test_an_output_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        claim_predict(tmp_path / "file" / "out")
    with pytest.raises(OutputError, match="cannot be"):
        claim_predict(tmp_path / "file")


def test_origins_tell_settings_apart(tmp_path):
    claim_predict(tmp_path)
    first = origins(tmp_path, ["predict", "uncertainty"])
    assert list(first) == ["predict"]
    claim_predict(tmp_path, {"weights": "new"}, overwrite=True)
    assert origins(tmp_path, ["predict"]) != first


def test_where_scans_came_from_is_remembered(world):
    scans = find_scans(world.data)
    claim_predict(world.out, scans=scans)
    assert (world.out / "sequences/08/source.json").exists()
    world.predict_by_hand()
    assert remembered_scans(world.out) == scans


def test_another_source_of_the_same_name_is_refused_before_anything_is_removed(world, tmp_path):
    claim_predict(world.out, scans=find_scans(world.data))
    world.predict_by_hand()
    before = files_below(world.out)
    other = find_scans(write_sequence(tmp_path / "other/08", ["000000"]))
    with pytest.raises(
        OutputError, match=r"sequence 08 came from .*Daten für 1.* not from .*other"
    ):
        claim_predict(world.out, {"weights": "new"}, scans=other, overwrite=True)
    assert files_below(world.out) == before


def test_two_folders_of_one_name_in_one_run_are_refused(world, tmp_path):
    scans = [ScanFile("08", "a", tmp_path / "x/a.bin"), ScanFile("08", "b", tmp_path / "y/b.bin")]
    with pytest.raises(OutputError, match="sequence 08 came from"):
        claim_predict(world.out, scans=scans)
    assert not world.out.exists()


def test_scans_that_have_moved_are_found_where_one_says(world):
    claim_predict(world.out, scans=find_scans(world.data))
    world.predict_by_hand()
    moved = world.data.rename(world.data.with_name("moved"))
    with pytest.raises(NoInputError, match=r"not in .*Daten für 1.*--dataset"):
        remembered_scans(world.out)
    assert remembered_scans(world.out, moved) == find_scans(moved)
    with pytest.raises(NoInputError, match="nowhere"):
        remembered_scans(world.out, world.out.with_name("nowhere"))


def test_results_of_unknown_origin_are_looked_for_here(world, monkeypatch):
    world.predict_by_hand()
    with pytest.raises(NoInputError, match="--dataset"):
        remembered_scans(world.out)
    monkeypatch.chdir(world.data)
    assert remembered_scans(world.out) == find_scans(world.data)


def test_an_output_folder_without_results(tmp_path):
    with pytest.raises(NoInputError, match=r"no such folder.*run `salsanext predict"):
        remembered_scans(tmp_path / "none")
    with pytest.raises(NoInputError, match="holds no results"):
        remembered_scans(tmp_path)


def test_names_that_are_no_text_are_remembered(tmp_path):
    folder = write_sequence(tmp_path / "Stra\udcdfe", ["a"])
    scans = find_scans(folder)
    claim_predict(tmp_path / "out", scans=scans)
    write_array(tmp_path / "out/sequences/Stra\udcdfe/pixel_labels/a.npy", scans_image())
    assert remembered_scans(tmp_path / "out") == scans


def scans_image():
    import numpy as np

    return np.zeros((2, 2), np.uint8)


def test_label_space_and_sensor_are_those_of_the_stage_that_wrote(tmp_path):
    assert recorded_label_space(tmp_path) is None
    assert recorded_sensor(tmp_path) == sensor("hdl64")
    settings = {"label_space": label_space().to_dict(), "sensor": sensor("hdl32").to_dict()}
    claim_predict(tmp_path, settings)
    assert recorded_label_space(tmp_path).to_dict() == label_space().to_dict()
    assert recorded_sensor(tmp_path) == sensor("hdl32")
