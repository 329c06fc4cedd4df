# SPDX-License-Identifier: MIT
"""A module has a test file of its name, at its place in the tree, or a row here states another."""

import ast
from functools import cache
from pathlib import Path

from package_trees import MODULES, imports_of, nodes_of, tree_of

from tools.mirrored_tests import PACKAGE, TESTS, mirror_of, without_mirror

WHOLE_STREETS = "tests of whole streets compare what a sensor sees, not how it is built"
COMMAND_LINE = "declarations of options; tests type the commands"
WHOLE_PAGE = "the numbers of the page, which one test reads together"
FILES_OF_FORMAT = "read through the format that its content belongs to"
THROUGH_STAGE = "a step of a stage, which has no meaning without its files"
PART_OF_ONE_RESULT = "one of several modules whose result is compared with one oracle"
RECORD = "a record of few lines"
GPU_OR_LIBRARY = "an adapter of another library, compared with the other ones"
WHOLE_RUN_ON_CLUSTER = "a process or a cluster, which only a whole run has"

ELSEWHERE: dict[str, dict[str, str]] = {
    WHOLE_STREETS: {
        "synthesis/presets.py": "synthesis/test_surfaces.py",
        "synthesis/street/": "synthesis/test_drive.py",
        "synthesis/things/": "synthesis/test_things.py",
        "synthesis/things/riders.py": "synthesis/test_drive.py",
    },
    COMMAND_LINE: {"commands/line/": "commands/line/test_app.py"},
    WHOLE_PAGE: {
        "report/canvas.py": "report/test_scan_pictures.py",
        "report/page/": "commands/stages/test_report.py",
        "report/picked.py": "report/test_tables.py",
    },
    FILES_OF_FORMAT: {
        "core/classes/label_tables.py": "core/classes/test_label_space.py",
        "io/formats/columns.py": "io/formats/test_kitti.py",
        "io/formats/evidence/": "io/formats/evidence/test_column_evidence.py",
        "io/formats/kitti_labels.py": "io/formats/test_kitti.py",
        "io/formats/recordings.py": "io/formats/survey/test_e57.py",
        "io/formats/tables/text_layout.py": "io/formats/tables/test_text.py",
    },
    THROUGH_STAGE: {
        "commands/evaluation.py": "commands/stages/test_evaluate.py",
        "runs/copies/bag_sources.py": "runs/copies/test_bag_run.py",
        "runs/copies/filled_folder.py": "commands/stages/test_filter.py",
        "commands/jobs/epoch_files.py": "commands/stages/test_train_pictures.py",
        "training/tensorboard_files.py": "commands/stages/test_train_pictures.py",
        "commands/jobs/risk_picture.py": "commands/stages/test_tune_risk.py",
        "commands/jobs/fuse_task.py": "commands/stages/test_fuse.py",
        "commands/jobs/image_job.py": "commands/stages/test_predict.py",
        "commands/jobs/submission_checks.py": "commands/stages/test_submit.py",
        "commands/jobs/picture_task.py": "commands/stages/test_picture.py",
        "commands/jobs/pick_job.py": "commands/stages/test_pick.py",
        "commands/jobs/point_filter.py": "commands/stages/test_filter.py",
        "commands/jobs/predict_job.py": "commands/stages/test_predict.py",
        "commands/jobs/plans/prediction_plan.py": "commands/stages/test_predict.py",
        "commands/jobs/plans/prepared_run.py": "commands/stages/test_predict.py",
        "commands/jobs/plans/prepared_pick.py": "commands/stages/test_pick.py",
        "commands/jobs/plans/pick_plan.py": "commands/stages/test_pick.py",
        "commands/stages/new_training.py": "commands/stages/test_samples_of_device.py",
        "commands/jobs/uncertainty_job.py": "commands/stages/test_uncertainty.py",
        "report/readable_scans.py": "commands/stages/test_report.py",
        "report/run_server.py": "commands/stages/test_report.py",
        "runs/drives/drive_of_run.py": "commands/stages/test_fuse.py",
        "runs/drives/fusible_results.py": "commands/stages/test_fuse.py",
        "runs/summary/guarantee_of_run.py": "commands/stages/test_tune_risk.py",
        "runs/summary/recorded_summary.py": "runs/summary/test_scan_summary.py",
        "commands/stages/import_weights.py": "io/weights/test_published.py",
        "commands/stages/training_scenes.py": "commands/stages/test_train_on_few_scans.py",
        "runs/results/scan_results.py": "runs/results/test_result_folder.py",
        "training/cross_validated_training.py": "commands/stages/test_train_on_few_scans.py",
        "training/initial_network.py": "commands/stages/test_train.py",
        "training/int8_ranges.py": "commands/stages/test_train.py",
        "training/tuning/judged_scans.py": "commands/stages/test_tune_risk.py",
        "training/tuning/risk_report.py": "commands/stages/test_tune_risk.py",
        "commands/stages/models.py": "commands/stages/test_weights_version.py",
        "commands/stages/project.py": "commands/stages/test_knn_refine.py",
        "core/fitting/network_fit.py": "runs/fit/test_sensor_fit.py",
        "core/measures/survey.py": "commands/stages/test_inspect.py",
        "core/fitting/sensor_texts.py": "commands/line/output/test_summary.py",
        "io/weights/card_file.py": "io/weights/test_weights.py",
        "io/weights/loading.py": "core/engines/test_network.py",
        "io/weights/onnx_export.py": "commands/stages/test_export_onnx.py",
        "runs/fit/range_images.py": "commands/stages/test_knn_refine.py",
        "runs/fit/scan_reading.py": "commands/stages/test_predict.py",
        "runs/fit/scan_sample.py": "core/fitting/test_field_of_view.py",
        "runs/annotation/tool_files.py": "commands/stages/test_pick.py",
        "runs/loop/": "runs/loop/test_processes.py",
        "runs/network_announcement.py": "commands/line/output/test_summary.py",
        "runs/network_settings.py": "commands/stages/test_predict.py",
        "runs/results/merged_labels.py": "commands/stages/test_stages_in_merged_classes.py",
        "runs/results/moved_scans.py": "runs/results/test_result_folder.py",
        "runs/results/repeated_settings.py": "runs/results/test_making_commands.py",
        "runs/summary/run_comparison.py": "commands/stages/test_compare.py",
        "runs/summary/run_pair.py": "commands/stages/test_compare.py",
        "report/run_change_tables.py": "commands/stages/test_compare.py",
        "runs/summary/comparison.py": "commands/stages/test_evaluate.py",
        "training/data/batch_source.py": "commands/stages/test_samples_of_device.py",
        "training/data/class_counts.py": "training/data/test_dataset.py",
        "training/data/reading_progress.py": "commands/stages/test_train.py",
        "training/preconditions.py": "commands/stages/test_train.py",
        "training/fit.py": "commands/stages/test_train.py",
        "training/run_folder.py": "commands/stages/test_train.py",
        "training/setup.py": "commands/stages/test_train_on_few_scans.py",
        "training/tuning/error.py": "commands/stages/test_tune_error.py",
        "training/tuning/int8.py": "commands/stages/test_tune_int8.py",
        "training/tuning/risk.py": "commands/stages/test_tune_risk.py",
        "training/tuning/scan_choice.py": "commands/stages/test_tune.py",
        "training/tuning/scans.py": "commands/stages/test_tune.py",
    },
    PART_OF_ONE_RESULT: {
        "api.py": "test_public.py",
        "core/api.py": "test_public.py",
        "core/checks/check_sample.py": "core/checks/test_scan_checks.py",
        "core/checks/scan_structure.py": "core/checks/test_structure_checks.py",
        "core/engines/dropout_passes.py": "core/uncertainty/test_monte_carlo.py",
        "core/fitting/ego_fit.py": "core/fitting/test_field_of_view.py",
        "core/fitting/scan_sample.py": "core/fitting/test_sensor_groups.py",
        "core/fitting/upright_scans.py": "core/fitting/test_mounting_fit.py",
        "core/fitting/view_fit.py": "core/fitting/test_sensor_groups.py",
        "core/fusion/window.py": "core/fusion/test_votes.py",
        "core/labelling.py": "core/test_labellers.py",
        "core/geometry/scan_traits.py": "runs/summary/test_scan_summary.py",
        "core/geometry/sensor_of_scan.py": "core/fitting/test_sensor_groups.py",
        "core/measures/accepted_labels.py": "core/measures/test_risk_control.py",
        "core/measures/calibration.py": "core/measures/test_uncertainty_evaluation.py",
        "core/measures/histograms.py": "core/measures/test_uncertainty_evaluation.py",
        "core/network/registry.py": "core/network/test_family.py",
        "core/network/segmentation.py": "core/network/test_family.py",
        "core/on_device/batch_results.py": "core/on_device/test_labeller.py",
        "core/on_device/host_points.py": "core/on_device/test_scan_batch.py",
        "core/on_device/intensity.py": "core/on_device/test_network_input.py",
        "core/on_device/pixel_sample.py": "core/on_device/test_no_intensity.py",
        "drive_labels.py": "commands/stages/test_fuse.py",
        "io/annotation_tools/tool.py": "io/annotation_tools/test_registry.py",
        "runs/results/provenance.py": "runs/results/test_manifest.py",
        "runs/scans/scan_file.py": "runs/scans/test_scan_search.py",
        "runs/summary/run_counts.py": "runs/summary/test_scan_summary.py",
        "runs/summary/run_summary.py": "runs/summary/test_scan_summary.py",
        "runs/summary/run_findings.py": "runs/summary/test_scan_summary.py",
        "runs/fit/mixed_sensors.py": "runs/summary/test_scan_summary.py",
        "runs/loop/cluster/calls.py": "runs/loop/cluster/test_driver.py",
        "runs/loop/cluster/crew.py": "runs/loop/cluster/test_driver.py",
        "runs/loop/cluster/losses.py": "runs/loop/cluster/test_driver.py",
        "runs/summary/scan_warnings.py": "runs/summary/test_scan_summary.py",
    },
    RECORD: {
        "runs/loop/cluster/members.py": "runs/loop/cluster/test_driver.py",
        "core/checks/finding.py": "runs/summary/test_scan_summary.py",
        "core/errors.py": "core/test_wording.py",
        "core/uncertainty/estimate_request.py": "core/test_estimators.py",
        "core/fusion/drive.py": "core/fusion/test_fuse_drive.py",
        "core/geometry/knn_parameters.py": "core/test_wording.py",
        "core/measures/filtered_points.py": "commands/stages/test_filter.py",
        "core/network/weights_names.py": "io/weights/test_weights.py",
        "core/on_device/device_labels.py": "core/on_device/test_labeller.py",
        "core/on_device/scan_for_device.py": "core/on_device/test_labeller.py",
        "runs/results/query.py": "commands/stages/test_report.py",
        "training/data/on_device/point_batch.py": "training/data/on_device/test_motion.py",
        "training/scoring/validated_scan.py": "training/scoring/test_device_validation.py",
        "runs/scans/scan_selection.py": "runs/scans/test_selection.py",
    },
    WHOLE_RUN_ON_CLUSTER: {
        "runs/loop/cluster/ray_cluster.py": "runs/loop/cluster/test_nodes.py",
        "runs/loop/cluster/work.py": "runs/loop/cluster/test_node_code.py",
    },
    GPU_OR_LIBRARY: {
        "core/engines/memory.py": "core/engines/test_torch_backend.py",
        "core/engines/conversion.py": "core/engines/test_graphs.py",
        "core/engines/openvino_backend.py": "core/engines/test_graphs.py",
        "core/engines/openvino_runtime.py": "core/engines/test_graphs.py",
        "io/user_caches.py": "core/test_caches.py",
        "training/failure_watch.py": "training/test_distributed.py",
        "training/fused_step.py": "training/test_learner.py",
    },
}
"""Modules, or folders of modules, that a test file of another name tests, by the reason."""
ROWS = {module: test for rows in ELSEWHERE.values() for module, test in rows.items()}


def test_every_module_has_a_test_file_of_its_name_or_a_row():
    missing = [
        module.as_posix()
        for module in without_mirror()
        if module.as_posix() not in ROWS
        and not any(f"{folder.as_posix()}/" in ROWS for folder in module.parents)
    ]
    assert missing == [], "python tools/mirrored_tests.py lists them"


def test_a_row_is_about_a_module_without_such_a_file():
    """A module that gets one loses its row."""
    for module, test in ROWS.items():
        assert (TESTS / test).is_file(), module
        path = PACKAGE / module
        if module.endswith("/"):
            folder = path.relative_to(PACKAGE)
            assert any(folder in lacking.parents for lacking in without_mirror()), module
        else:
            assert path.is_file(), module
            assert not (TESTS / mirror_of(path.relative_to(PACKAGE))).exists(), module


def files_of_test(path: Path) -> set[Path]:
    """Return a test file, and the files of fixtures and helpers that it imports."""
    folders = [TESTS, *(folder for folder in path.parents if folder.is_relative_to(TESTS))]
    fixtures = [folder / "conftest.py" for folder in folders]
    files = {path, *(file for file in fixtures if file.is_file())}
    words = {name.partition(".")[0] for name in imported_names(path)}
    helpers = {TESTS / f"helpers/{word}.py" for word in words}
    return files | {helper for helper in helpers if helper.is_file()}


def imported_names(path: Path) -> set[str]:
    """Return the names of the modules that a file imports."""
    nodes = nodes_of(tree_of(path))
    names = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return names | {
        alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names
    }


@cache
def reached(test: str) -> set[str]:
    """Return the modules that a test file and its helpers import, and those that these import."""
    imported = {name for file in files_of_test(TESTS / test) for name in imports_of(file)}
    return {*imported, *(name for module in imported for name in imports_of(PACKAGE / module))}


def reached_in(folder: str, modules: set[str]) -> set[str]:
    """Return some modules, and those of a folder that they reach through its other modules."""
    further = modules
    while further:
        imported = {name for module in further for name in imports_of(PACKAGE / module)}
        further = {name for name in imported if name.startswith(folder)} - modules
        modules = modules | further
    return modules


def test_the_test_file_of_a_row_reaches_the_module():
    """It imports the module, or one that does; further modules of the folder may stand between."""
    lacking = {path.as_posix() for path in without_mirror()} - ROWS.keys()
    for module, test in ROWS.items():
        folder = module.rpartition("/")[0]
        modules = reached_in(f"{folder}/", reached(test))
        expected = {module}
        if module.endswith("/"):
            expected = {name for name in lacking if name.startswith(module)}
        assert expected - modules == set(), module


def test_a_test_reaches_few_modules():
    """Else every row would be right."""
    assert "core/poses.py" in reached("core/test_poses.py")
    assert len(reached("core/test_poses.py")) < len(MODULES) / 10


def test_every_test_file_in_the_tree_is_where_its_module_is():
    """A test file with the name of a module lies at the place of that module."""
    wings = ("core", "io", "runs", "commands", "training", "synthesis", "report")
    modules = {path.stem: [] for path in PACKAGE.rglob("*.py")}
    for path in PACKAGE.rglob("*.py"):
        modules[path.stem].append(path.relative_to(PACKAGE).parent)
    misplaced = [
        path.relative_to(TESTS).as_posix()
        for wing in wings
        for path in (TESTS / wing).rglob("test_*.py")
        if (name := path.stem.removeprefix("test_")) in modules
        if path.relative_to(TESTS).parent not in modules[name]
    ]
    assert misplaced == []
