# SPDX-License-Identifier: MIT
"""Labels imported from tools, compared with the truth."""

import hashlib
import json
import re

import numpy as np
import pytest
import yaml
from edited_clouds import WRITERS, write_ply
from las_files import write_las
from scans import files_below, make_scan, refused, write_sequence

from salsanext_cli import LabelSpace, label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages.import_labels import import_labels
from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.io.annotation_tools.registry import tool_named
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.io.formats.pcd_writing import encode_pcd
from salsanext_cli.io.frames import FRAMES, encode_frames
from salsanext_cli.runs.annotation.label_records import pre_labelled_scans
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_search import find_scans

SPACE = label_space()
STEMS = ("000010", "000011", "000012")


class Labelled:
    """A data set with pre-labels of `pick`, and its true labels."""

    def __init__(self, folder):
        self.data, self.edited = folder / "data", folder / "edited"
        write_sequence(self.data / "sequences/08", STEMS)
        self.scans = find_scans(self.data)
        self.points = [read_scan(scan.path).points for scan in self.scans]
        self.truth = [read_labels(scan.label_path) for scan in self.scans]
        pre_label = encode_labels(np.full(1500, 40, np.uint32))
        for scan in self.scans:
            scan.label_path.unlink()
            OwnedFolder(self.data).write(scan.label_path, pre_label)
        digests = {f"08/{stem}": hashlib.sha256(pre_label).hexdigest() for stem in STEMS}
        (self.data / "pick.json").write_text(json.dumps({"pre_labels": digests}))

    def labels(self, index=0):
        return read_labels(self.scans[index].label_path)

    def write(self, name="000010.ply", labels=None, index=0, chosen=slice(None)):
        labels = self.truth[index] if labels is None else labels
        scalars = {"label": np.asarray(labels)[chosen].astype("f4")}
        return write_ply(self.edited / name, self.points[index][chosen], scalars)

    def run(self, edited=None, **options):
        return import_labels(edited or self.edited, self.data, **options)


@pytest.fixture
def world(tmp_path):
    return Labelled(tmp_path)


@pytest.mark.parametrize("tool", ["las", "sse", "supervisely"])
def test_clouds_in_map_coordinates_are_those_of_scans_with_a_frame_beside_them(world, tool):
    """The scans were picked from a map; `export-las` writes their clouds in it again."""
    frame = (*UTM[:2], 47.5)
    world.scans[0].path.parent.with_name(FRAMES).write_bytes(encode_frames({STEMS[0]: frame}))
    points = world.points[0].astype(np.float64) + frame
    train_ids = SPACE.to_train(world.truth[0])
    labels = SPACE.to_raw(train_ids)
    if tool == "las":
        pytest.importorskip("laspy")
        write_las(world.edited / "000010.las", points, offsets=UTM, extra={"label": labels})
    else:
        scalar = {"label": train_ids} if tool == "sse" else {"labels": labels}
        files = tool_named(tool).common_files(SPACE)
        cloud = encode_pcd({**dict(zip("xyz", points.T, strict=True)), **scalar})
        world.edited.mkdir()
        for name, content in {**files, "08_000010.pcd": cloud}.items():
            (world.edited / name).write_bytes(content)
    assert world.run().failures == []
    np.testing.assert_array_equal(world.labels(), labels)


def test_files_of_labels_alone_need_no_frames(world):
    path = world.data / "pick.json"
    frames = {f"08/{STEMS[0]}": {"origin": UTM, "is_beside": True}}
    record = {**json.loads(path.read_text()), "stage": "pick", "frames": frames}
    path.write_text(json.dumps(record))
    world.edited.mkdir()
    write_labels(world.edited / f"{STEMS[0]}.label", world.truth[0])
    assert len(world.run().scans) == 1
    np.testing.assert_array_equal(world.labels(), world.truth[0])
    world.write()
    refused(FormatError, world.scans[0].path.parent.with_name(FRAMES), world.run)


def only_failure(found):
    assert not found.scans
    (failure,) = found.failures
    return failure


@pytest.mark.parametrize("name", ["S.PLY", "s.pcd", "s.laz"])
def test_shuffled_and_cut_clouds_give_the_truth_back(world, name):
    random = np.random.default_rng(0)
    order = random.permutation(1500)[:1100]
    scalars = {"scalar_Label": world.truth[0][order].astype("f4")}
    file = f"000010 - Cloud.{name[2:]}"
    if name.endswith("z"):
        pytest.importorskip("laspy")
    WRITERS[name](world.edited / file, world.points[0][order], scalars)
    found = world.run()
    expected = np.zeros(1500, np.uint32)
    expected[order] = world.truth[0][order]
    np.testing.assert_array_equal(world.labels(), expected)
    (row,) = found.scans
    labelled = SPACE.scored[SPACE.to_train(expected)].sum()
    assert (row.labelled, row.unlabelled) == (labelled, 1100 - labelled)
    assert (row.ambiguous, row.missing, row.unmatched) == (0, 400, 0)
    assert (row.scan, row.points, row.scalar) == ("08/000010", 1500, "scalar_Label")
    assert (found.failures, found.unchanged, found.unedited) == ([], 2, [])
    assert found.pre_labelled == ["08/000011", "08/000012"]
    assert found.class_points.sum() == 1500
    assert sum(found.largest_classes().values()) < 1
    json.dumps(found.to_dict())


def test_doubled_points_of_several_labels_are_ambiguous(world):
    truth = np.where(world.truth[0] == 10, 11, world.truth[0])
    # A hundredth of other points is allowed.
    cloud = np.concatenate([world.points[0][np.r_[:1500, :300]], np.full((15, 3), 70, "f4")])
    labels = np.r_[truth, truth[:200], np.full(115, 10)].astype("u2")
    write_ply(world.edited / "000010.ply", cloud, {"label": labels})
    found = world.run()
    assert (found.scans[0].ambiguous, found.scans[0].unmatched) == (100, 15)
    np.testing.assert_array_equal(world.labels(), np.r_[truth[:200], [0] * 100, truth[300:]])


def test_several_edited_files_of_a_scan_are_one_failure(world):
    world.write("000010 b.ply", np.full(1500, 40))
    world.write()
    # The pre-label beside the corrected file is not an edited file.
    found = world.run()
    assert found.unedited == [str(world.edited / "000010 b.ply")]
    np.testing.assert_array_equal(world.labels(), world.truth[0])
    world.write("000010 b.ply", world.truth[0][::-1])
    world.write("000011.ply", index=1)
    found = world.run()
    assert [row.scan for row in found.scans] == ["08/000011"]
    (failure,) = found.failures
    assert len(failure.files) == 2
    assert failure.reason.startswith("scan 08/000010: ")
    np.testing.assert_array_equal(world.labels(), world.truth[0])


def test_another_file_replaces_imported_labels_only_by_overwriting(world):
    world.write()
    assert len(world.run().scans) == 1
    (world.edited / "000010.ply").unlink()
    world.write("000010_v2.ply", np.full(1500, 11))
    assert only_failure(world.run()).code == "output"
    np.testing.assert_array_equal(world.labels(), world.truth[0])
    assert len(world.run(overwrite=True).scans) == 1
    assert (world.labels() == 11).all()


def test_a_real_scan_saved_in_whole_millimetres_keeps_every_label(real_data, tmp_path):
    sequence = real_data / "data/semantickitti/sequences/08"
    scan = sequence / "velodyne/000000.bin"
    truth = read_labels(sequence / "labels/000000.label") & np.uint32(0xFFFF)
    (tmp_path / scan.name).write_bytes(scan.read_bytes())
    order = np.random.default_rng(0).permutation(len(truth))[::2]
    labels = {"Classification": truth[order].astype("u2")}
    points = read_scan(scan).points[order]
    assert (points.astype("f8").round(3) != points.astype("f8")).any()
    WRITERS["S.PLY"](tmp_path / "edited/000000.ply", points.astype("f8").round(3), labels)
    found = import_labels(tmp_path / "edited", tmp_path)
    assert found.failures == []
    (row,) = found.scans
    assert row.unmatched == 0
    assert row.ambiguous < 10
    imported = read_labels(tmp_path / "000000.label")
    kept = np.zeros(len(truth), bool)
    kept[order] = True
    assert (imported[kept] != truth[kept]).sum() <= row.ambiguous
    assert np.count_nonzero(imported[~kept]) < 10


@pytest.mark.parametrize("suffix", ["label", "npy"])
def test_files_of_labels_keep_their_instances(world, suffix):
    raw = world.truth[1] | np.uint32(7 << 16)
    path = world.edited / f"sequences/08/labels/000011.{suffix}"
    write_labels(path.with_suffix(".label"), raw)
    if suffix == "npy":
        path.with_suffix(".label").unlink()
        np.save(path, raw.astype(np.int64))
    assert world.run().scans[0].scan == "08/000011"
    np.testing.assert_array_equal(world.labels(1), raw)


def test_a_tool_with_ids_of_its_own(world, tmp_path):
    (tmp_path / "ids.yaml").write_text("-1: 0\n0: car\n1: road\n")
    world.write(labels=np.arange(1500) % 3 - 1)
    world.run(ids=tmp_path / "ids.yaml")
    np.testing.assert_array_equal(world.labels(), np.tile([0, 10, 40], 500))


def test_points_without_a_label_get_the_raw_id_of_unlabelled(world):
    maps = {"learning_map": {0: 1}, "learning_map_inv": {0: 255, 1: 0}}
    classes = {"labels": {255: "void", 0: "thing"}, **maps}
    (world.data / "labels.yaml").write_text(json.dumps(classes))
    world.write(labels=np.zeros(1500), chosen=slice(600))
    (row,) = world.run().scans
    assert (row.labelled, row.missing) == (600, 900)
    np.testing.assert_array_equal(world.labels(), [0] * 600 + [255] * 900)
    world.run(world.scans[0].label_path)
    np.testing.assert_array_equal(world.labels(), [0] * 600 + [255] * 900)


def of_another_scan(world):
    write_ply(world.edited / "000010.ply", world.points[1], {"label": world.truth[1]})


def rounded(world):
    write_ply(world.edited / "000010.ply", world.points[0].round(2), {"label": world.truth[0]})


def of_fewer_points(world):
    write_labels(world.edited / "000010.label", world.truth[0][:-1])


def array_of_floats(world):
    world.edited.mkdir()
    np.save(world.edited / "000010.npy", world.truth[0].astype("f4"))


@pytest.mark.parametrize(
    ("spoil", "numbers", "hint"),
    [
        (of_another_scan, "1,500 points", "turned"),
        (rounded, "0.00", "rounded"),
        (lambda world: world.write(labels=np.full(1500, 99)), "all 1,500", "with scalar"),
        (lambda world: world.write(labels=np.full(1500, 2)), "2 (1,500 points)", "with ids"),
        (lambda world: world.write("x.ply"), "no scan", "rename"),
        (of_fewer_points, "1,499 labels (expected 1,500", "belong to this scan"),
        (array_of_floats, "<f4 (1500)", "uint32"),
    ],
)
def test_failures_leave_the_labels_as_they_were(world, spoil, numbers, hint):
    spoil(world)
    before = files_below(world.data)
    failure = only_failure(world.run())
    assert "\n" not in failure.reason
    assert numbers in failure.reason
    assert hint in failure.hint
    assert files_below(world.data) == before
    assert len(pre_labelled_scans(world.scans)) == 3


def test_foreign_labels_are_not_replaced_without_overwriting(world):
    world.write()
    theirs = np.full(1500, 70, np.uint32)
    write_labels(world.scans[0].label_path, theirs)
    failure = only_failure(world.run())
    assert failure.code == "output"
    np.testing.assert_array_equal(world.labels(), theirs)
    assert len(world.run(overwrite=True).scans) == 1


def test_unchanged_pre_labels_are_not_imported(world):
    world.write(labels=np.full(1500, 40))
    refused(NoInputError, world.edited, world.run)
    corrected = world.write("000011.ply", index=1)
    found = world.run()
    assert found.unedited == [str(world.edited / "000010.ply")]
    assert [row.files for row in found.scans] == [(str(corrected),)]
    assert found.pre_labelled == ["08/000010", "08/000012"]


def test_a_named_file_imports_unchanged_pre_labels(world, caplog):
    world.write(labels=np.full(1500, 40))
    found = world.run(world.edited / "000010.ply")
    assert "000010.ply: " in caplog.text
    assert found.pre_labelled == ["08/000011", "08/000012"]
    assert len(world.run(world.scans[1].label_path).scans) == 1
    assert len(pre_labelled_scans(world.scans)) == 1


def test_the_data_set_itself_may_contain_the_edited_files(world):
    refused(NoInputError, world.data, world.run, world.data)
    world.edited = world.data / "sequences/08/ply"
    world.write()
    assert len(world.run(world.data).scans) == 1
    np.testing.assert_array_equal(world.labels(), world.truth[0])


def test_a_plain_folder_of_scans_will_do(world, tmp_path):
    world.write("any.ply")
    scan = world.scans[0].path
    (tmp_path / "plain").mkdir()
    plain = tmp_path / "plain/000010.bin"
    plain.write_bytes(scan.read_bytes())
    for place in (plain, tmp_path / "plain"):
        import_labels(world.edited / "any.ply", place)
        np.testing.assert_array_equal(read_labels(plain.with_suffix(".label")), world.truth[0])


CODES = {40: 11, 48: 2, 50: 6, 70: 5, 81: 145}
"""Codes of the ASPRS of some raw ids of SemanticKITTI."""
UTM = (500_123.4, 5_400_456.7, 312.0)


def classified(folder, names, codes):
    """Write LAS scans in map coordinates with a classification, (N,) each."""
    pytest.importorskip("laspy")
    for seed, (name, values) in enumerate(zip(names, codes, strict=True)):
        points = make_scan(300, seed).points + np.array(UTM)
        write_las(folder / name, points, offsets=UTM, classification=values.astype(np.uint8))
    return folder


def test_the_classification_of_las_scans_becomes_their_labels_by_the_label_space(tmp_path):
    raw = np.random.default_rng(0).choice([50, 70, 81], 300)
    codes = np.array([CODES[i] for i in raw.tolist()])
    codes[:9] = [0, 1, 7, 18, 3, 4, 5, 6, 145]
    expected = raw.copy()
    expected[:9] = [0, 0, 0, 0, 70, 70, 70, 50, 81]
    folder = classified(tmp_path / "scans", ["a.las", "b.laz"], [codes, codes[::-1]])
    found = import_labels(folder, folder)
    assert found.failures == []
    for stem, order in (("a", 1), ("b", -1)):
        (scan,) = [file for file in find_scans(folder) if file.stem == stem]
        np.testing.assert_array_equal(read_labels(scan.label_path), expected[::order])


def test_codes_of_several_classes_need_a_map_which_the_hint_has(tmp_path):
    codes = np.where(np.arange(300) % 2, 2, 6)
    folder = classified(tmp_path / "scans", ["a.las"], [codes])
    (failure,) = import_labels(folder, folder).failures
    assert "2 (150 points)" in failure.reason
    (entries,) = re.findall(r"such as (\{.*\})", failure.hint)
    mapped = tmp_path / "map.yaml"
    mapped.write_text(entries)
    assert set(yaml.safe_load(entries)) == {2, 6}
    assert import_labels(folder, folder, ids=mapped).failures == []
    (scan,) = find_scans(folder)
    first = SPACE.labels.keys() & {48, 49, 72}
    labels = read_labels(scan.label_path)
    np.testing.assert_array_equal(labels[codes == 6], 50)
    assert set(labels[codes == 2].tolist()) < first


def test_a_label_space_may_state_that_its_raw_ids_are_the_codes(tmp_path):
    codes = np.random.default_rng(0).choice([1, 2, 5, 6, 17], 300)
    folder = classified(tmp_path / "scans", ["a.las"], [codes])
    names = {1: "unassigned", 2: "ground", 5: "tree", 6: "building", 17: "bridge"}
    data = {
        "labels": names,
        "learning_map": {1: 0, 2: 1, 5: 2, 6: 3, 17: 3},
        "learning_map_inv": {0: 1, 1: 2, 2: 5, 3: 6},
    }
    (failure,) = import_labels(folder, folder, space=LabelSpace.from_dict(data)).failures
    assert "no class" in failure.reason
    space = LabelSpace.from_dict({**data, "asprs": {code: code for code in names}})
    assert import_labels(folder, folder, space=space).failures == []
    (scan,) = find_scans(folder)
    # The bridge is a building in this label space.
    np.testing.assert_array_equal(read_labels(scan.label_path), np.where(codes == 17, 6, codes))


def test_an_unclassified_las_scan_has_no_labels(tmp_path):
    folder = classified(tmp_path / "scans", ["a.las"], [np.zeros(300)])
    (failure,) = import_labels(folder, folder).failures
    assert "no labelled points" in failure.reason


def test_what_export_las_wrote_is_imported_by_its_label(tmp_path):
    pytest.importorskip("laspy")
    raw = np.random.default_rng(0).choice([10, 40, 48, 72], 300).astype(np.uint16)
    points = make_scan(300).points + np.array(UTM)
    write_las(tmp_path / "scans/a.las", points, offsets=UTM)
    codes = np.where(raw == 10, 74, np.where(raw == 40, 11, 2)).astype(np.uint8)
    edited = tmp_path / "edited/a.las"
    write_las(edited, points, offsets=UTM, extra={"label": raw}, classification=codes)
    (failure,) = import_labels(edited, tmp_path / "scans").failures
    assert 'scalar="label"' in failure.hint
    assert import_labels(edited, tmp_path / "scans", scalar="label").failures == []
    (scan,) = find_scans(tmp_path / "scans")
    np.testing.assert_array_equal(read_labels(scan.label_path), raw)
