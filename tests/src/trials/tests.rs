use std::path::Path;

use kinegrad_golden::{Folder, compared};
use libtest_mimic::{Arguments, Conclusion, Trial};

use super::GoldenTest;

const FILE: &str = "family/file.safetensors";

fn test(body: fn(&Folder)) -> GoldenTest {
    GoldenTest::new("golden::family", "golden_test", &[FILE], body)
}

/// A folder with or without the file of [`test`].
fn folder(with_file: bool, complete: bool) -> (tempfile::TempDir, Folder) {
    let root = tempfile::tempdir().expect("a folder");
    if with_file {
        let path = root.path().join(FILE);
        std::fs::create_dir_all(path.parent().expect("a family")).expect("a folder");
        std::fs::write(path, []).expect("a file");
    }
    let folder = Folder::new(root.path(), complete);
    (root, folder)
}

/// The outcome of a trial and its output.
fn outcome(trial: Trial, arguments: &[&str]) -> (Conclusion, String) {
    let log = tempfile::NamedTempFile::new().expect("a file");
    let arguments = ["golden"].iter().chain(arguments);
    let mut arguments = Arguments::from_iter(arguments);
    arguments.logfile = Some(log.path().display().to_string());
    let conclusion = libtest_mimic::run(&arguments, vec![trial]);
    let printed = std::fs::read_to_string(log.path()).expect("a log");
    (conclusion, printed)
}

fn compare_one(folder: &Folder) {
    assert!(Path::exists(&folder.path(FILE)));
    compared(1);
}

#[test]
fn a_test_that_compares_passes_under_the_name_of_its_module() {
    let (_root, folder) = folder(true, false);
    let trial = test(compare_one).trial(&folder, true);
    assert_eq!(trial.name(), "family::golden_test");
    assert!(!trial.has_ignored_flag());
    let (conclusion, _) = outcome(trial, &[]);
    assert_eq!((conclusion.num_passed, conclusion.num_failed), (1, 0));
}

#[test]
fn a_test_that_compares_nothing_fails() {
    let (_root, folder) = folder(true, false);
    // Earlier counts on the same thread are excluded.
    compared(3);
    let (conclusion, printed) = outcome(test(|_| ()).trial(&folder, true), &["--test-threads=1"]);
    assert_eq!((conclusion.num_passed, conclusion.num_failed), (0, 1));
    assert!(printed.contains("compared nothing"), "{printed}");
}

#[test]
fn a_test_without_its_file_is_ignored_and_says_which() {
    let (_root, folder) = folder(false, false);
    let trial = test(compare_one).trial(&folder, true);
    let reason = format!("no {FILE}");
    assert_eq!(
        (trial.kind(), trial.has_ignored_flag()),
        (reason.as_str(), true)
    );
    let (conclusion, printed) = outcome(trial, &[]);
    assert_eq!((conclusion.num_passed, conclusion.num_ignored), (0, 1));
    assert!(printed.contains(&reason), "{printed}");
    let (conclusion, printed) = outcome(test(compare_one).trial(&folder, true), &["--ignored"]);
    assert_eq!((conclusion.num_failed, conclusion.num_ignored), (1, 0));
    assert!(printed.contains(&reason), "{printed}");
}

#[test]
fn a_test_without_its_file_fails_in_a_folder_that_must_be_complete() {
    let (root, folder) = folder(false, true);
    let (conclusion, printed) = outcome(test(compare_one).trial(&folder, true), &[]);
    assert_eq!((conclusion.num_failed, conclusion.num_ignored), (1, 0));
    let place = root.path().display().to_string();
    assert!(
        printed.contains(FILE) && printed.contains(&place),
        "{printed}"
    );
}

#[test]
fn a_test_that_panics_fails() {
    let (_root, folder) = folder(true, false);
    let trial = test(|_| panic!("on purpose")).trial(&folder, true);
    let (conclusion, printed) = outcome(trial, &[]);
    assert_eq!((conclusion.num_passed, conclusion.num_failed), (0, 1));
    assert!(printed.contains("on purpose"), "{printed}");
}
