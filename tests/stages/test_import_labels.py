# SPDX-License-Identifier: MIT
"""Labels taken back from tools, compared with the truth."""

import hashlib
import json
import re

import numpy as np
import pytest
from edited_clouds import WRITERS, write_ply
from scans import files_below, write_sequence

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.errors import NoInputError
from salsanext_cli.formats.kitti import encode_labels
from salsanext_cli.labelling.label_records import first_guesses
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import find_scans
from salsanext_cli.stages.import_labels import import_labels

SPACE = label_space()
STEMS = ("000010", "000011", "000012")


class Labelled:
    """A data set as `pick` leaves it, and the truth that a person knows."""

    def __init__(self, folder):
        self.data, self.edited = folder / "data", folder / "edited"
        write_sequence(self.data / "sequences/08", STEMS)
        self.scans = find_scans(self.data)
        self.points = [read_scan(scan.path).points for scan in self.scans]
        self.truth = [read_labels(scan.label_path) for scan in self.scans]
        guess = encode_labels(np.full(1500, 40, np.uint32))
        for scan in self.scans:
            scan.label_path.unlink()
            OwnedFolder(self.data).write(scan.label_path, guess)
        guesses = {f"08/{stem}": hashlib.sha256(guess).hexdigest() for stem in STEMS}
        (self.data / "pick.json").write_text(json.dumps({"guesses": guesses}))

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


def only_failure(found):
    assert not found.scans
    (failure,) = found.failures
    return failure


@pytest.mark.parametrize("name", ["S.PLY", "s.laz"])
def test_shuffled_and_cut_clouds_give_the_truth_back(world, name):
    if name.endswith(("s", "z")):
        pytest.importorskip("laspy")
    random = np.random.default_rng(0)
    order = random.permutation(1500)[:1100]
    scalars = {"scalar_Label": world.truth[0][order].astype("f4")}
    file = f"000010 - Cloud.{name[2:]}"
    WRITERS[name](world.edited / file, world.points[0][order], scalars)
    found = world.run()
    expected = np.zeros(1500, np.uint32)
    expected[order] = world.truth[0][order]
    np.testing.assert_array_equal(world.labels(), expected)
    (row,) = found.scans
    counts = [
        getattr(row, key) for key in ("labelled", "unlabelled", "ambiguous", "missing", "unmatched")
    ]
    kept = SPACE.scored[SPACE.to_train(expected)].sum()
    assert counts == [kept, 1100 - kept, 0, 400, 0]
    assert (row.scan, row.points, row.scalar) == ("08/000010", 1500, "scalar_Label")
    assert (found.failures, found.kept, found.unedited) == ([], 2, [])
    assert found.first_guesses == ["08/000011", "08/000012"]
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


def test_files_of_one_scan_are_merged(world):
    truth = np.where(np.isin(world.truth[0], [0, 10]), 11, world.truth[0])
    objects = truth.copy()
    objects[:900], objects[900:1000] = 0, 10
    world.write("000010_rest.ply", truth, chosen=slice(1000))
    world.write("000010_objects.ply", objects, chosen=slice(500, 1400))
    write_labels(world.edited / "000010.label", np.where(np.arange(1500) < 1450, 0, truth))
    found = world.run()
    (row,) = found.scans
    # The points 900 to 999 are of two labels; 0 of the others is none.
    expected = np.r_[truth[:900], [0] * 100, truth[1000:1400], [0] * 50, truth[1450:]]
    np.testing.assert_array_equal(world.labels(), expected)
    names = ["000010.label", "000010_objects.ply", "000010_rest.ply"]
    assert row.files == tuple(str(world.edited / name) for name in names)
    assert (row.scalar, row.ambiguous, row.missing) == ("label, labels", 100, 0)
    assert row.labelled == SPACE.scored[SPACE.to_train(expected)].sum()
    assert row.labelled + row.unlabelled == 1400
    assert found.class_points.sum() == 1500
    # The same files, and more of them, may be imported again; a part of them is refused.
    world.write("000010_more.ply", truth, chosen=slice(1400, 1450))
    assert len(world.run().scans) == 1
    np.testing.assert_array_equal(world.labels()[1400:], truth[1400:])
    (world.edited / "000010_rest.ply").unlink()
    assert "imported from another file" in only_failure(world.run()).reason


def test_two_versions_of_a_scan_do_not_replace_what_was_imported(world, caplog):
    world.write()
    assert len(world.run().scans) == 1
    before = world.labels()
    corrected = np.where(np.arange(1500) < 300, 11, world.truth[0])
    differ = int((corrected != world.truth[0])[(world.truth[0] != 0)].sum())
    world.write("000010_v2.ply", corrected)
    failure = only_failure(world.run())
    assert "the files contradict each other" in failure.reason
    assert f"{differ} points left unlabelled, of different labels in" in caplog.text
    np.testing.assert_array_equal(world.labels(), before)
    (world.edited / "000010.ply").unlink()
    (world.edited / "000010_v2.ply").rename(world.edited / "000010.ply")
    assert len(world.run().scans) == 1
    np.testing.assert_array_equal(world.labels(), corrected)


def test_a_part_with_an_unknown_id_keeps_its_scan_as_it_was(world):
    world.write(chosen=slice(700))
    world.write("000010 rest.ply", np.full(1500, 2), chosen=slice(700, None))
    world.write("000011.ply", index=1)
    found = world.run()
    assert [row.scan for row in found.scans] == ["08/000011"]
    (failure,) = found.failures
    assert len(failure.files) == 2
    assert "000010 rest.ply: unknown label ids 2 (800 points) (expected 0" in failure.reason
    assert len(first_guesses(world.scans)) == 2


def test_a_first_guess_that_was_only_cut_in_parts_is_not_imported(world):
    guess = np.full(1500, 40)
    world.write("000010 a.ply", guess, chosen=slice(700))
    world.write("000010 b.ply", guess, chosen=slice(700, None))
    with pytest.raises(NoInputError, match="holds the first guess of `pick`, which nobody"):
        world.run()
    # The whole guess beside a part that was corrected counts as no label either.
    world.write("000010 b.ply", chosen=slice(700, None))
    world.write("000010 guess.ply", guess)
    found = world.run()
    assert found.unedited == [str(world.edited / "000010 guess.ply")]
    np.testing.assert_array_equal(world.labels(), np.r_[guess[:700], world.truth[0][700:]])


def test_a_real_scan_saved_in_whole_millimetres_keeps_every_label(real_data, tmp_path):
    pytest.importorskip("laspy")
    sequence = real_data / "data/semantickitti/sequences/08"
    scan = sequence / "velodyne/000000.bin"
    truth = read_labels(sequence / "labels/000000.label") & np.uint32(0xFFFF)
    (tmp_path / scan.name).write_bytes(scan.read_bytes())
    order = np.random.default_rng(0).permutation(len(truth))[::2]
    labels = {"Classification": truth[order].astype("u2")}
    points = read_scan(scan).points[order]
    assert (points.astype("f8").round(3) != points.astype("f8")).any()
    WRITERS["s.laz"](tmp_path / "edited/000000.laz", points, labels)
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


def test_points_without_a_label_get_the_raw_id_that_stands_for_them(world):
    own = {
        "labels": {255: "void", 0: "thing"},
        "learning_map": {0: 1},
        "learning_map_inv": {0: 255, 1: 0},
    }
    (world.data / "labels.yaml").write_text(json.dumps(own))
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
    ("spoil", "found"),
    [
        (of_another_scan, "are none of the scan's, but .* it is of another scan, or"),
        (rounded, r"but 0\.00.* its coordinates were rounded"),
        (lambda world: world.write(labels=np.full(1500, 99)), "none of the 1,500 points has a cla"),
        (lambda world: world.write("x.ply"), "belongs to no scan"),
        (of_fewer_points, "1,499 labels (expected 1,500"),
        (array_of_floats, r"<f4 \(1500\) \(expected a .npy file of integers"),
    ],
)
def test_what_cannot_be_imported_leaves_the_labels_as_they_were(world, spoil, found):
    spoil(world)
    before = files_below(world.data)
    failure = only_failure(world.run())
    assert failure.reason.count("\n") == 0
    assert re.search(found, failure.reason), failure.reason
    assert files_below(world.data) == before
    assert len(first_guesses(world.scans)) == 3


def test_labels_of_others_are_kept_unless_overwriting(world):
    world.write()
    theirs = np.full(1500, 70, np.uint32)
    write_labels(world.scans[0].label_path, theirs)
    failure = only_failure(world.run())
    assert "000010.label: kept: changed" in failure.reason
    np.testing.assert_array_equal(world.labels(), theirs)
    assert len(world.run(overwrite=True).scans) == 1


def test_a_first_guess_that_nobody_corrected_is_not_imported(world):
    world.write(labels=np.full(1500, 40))
    with pytest.raises(NoInputError, match="holds the first guess of `pick`, which nobody"):
        world.run()
    corrected = world.write("000011.ply", index=1)
    found = world.run()
    assert found.unedited == [str(world.edited / "000010.ply")]
    assert [row.files for row in found.scans] == [(str(corrected),)]
    assert found.first_guesses == ["08/000010", "08/000012"]


def test_a_file_that_is_named_takes_the_first_guess_as_it_is(world, caplog):
    world.write(labels=np.full(1500, 40))
    found = world.run(world.edited / "000010.ply")
    assert "holds the first guess, all of it" in caplog.text
    assert found.first_guesses == ["08/000011", "08/000012"]
    assert len(world.run(world.scans[1].label_path).scans) == 1
    assert len(first_guesses(world.scans)) == 1


def test_the_data_set_itself_may_hold_the_edited_files(world):
    with pytest.raises(NoInputError, match="no labels but those of the data set itself"):
        world.run(world.data)
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
